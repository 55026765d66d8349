"""Settings of a worker, for commands that reconstruct as it does."""

from __future__ import annotations

from capture2vr.edge.engine.nouns import Needs
from capture2vr.edge.worker.memory_budget import machine_bytes, machine_cores
from capture2vr.edge.worker.settings import EdgeSettings
from capture2vr.errors import BadInput


def edge_settings() -> EdgeSettings:
    """Return the settings of the EDGE_* variables. Raises BadInput for a wrong one."""
    try:
        return EdgeSettings()
    except ValueError as error:
        raise BadInput(str(error)) from error


def machine_room() -> Needs:
    """Return what local tasks of a command may take together: all cores, and a share of the memory."""
    return Needs(machine_cores(), 1, machine_bytes())
