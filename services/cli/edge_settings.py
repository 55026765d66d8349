"""Settings of a worker, for commands that reconstruct as it does."""

from __future__ import annotations

from services.cli.errors import BadInput
from services.edge.worker.settings import EdgeSettings


def edge_settings() -> EdgeSettings:
    """Return the settings of the EDGE_* variables. Raises BadInput for a wrong one."""
    try:
        return EdgeSettings()
    except ValueError as error:
        raise BadInput(str(error)) from error
