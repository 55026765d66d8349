"""Settings of a gateway on this machine, for commands that work on its database."""

from __future__ import annotations

import os
from pathlib import Path

from services.gateway.settings import GatewaySettings

_PLACES = ("GATEWAY_DATA_DIR", "GATEWAY_DATABASE_URL")


def local_settings(data: Path) -> GatewaySettings:
    """Return the settings that name the database: the environment's, else for the data folder of `up` or a gateway."""
    if any(os.environ.get(name) for name in _PLACES):
        return GatewaySettings()
    lone = data / "gateway.db"
    folder = data if lone.exists() else data / "gateway"
    folder.mkdir(parents=True, exist_ok=True)
    return GatewaySettings(data_dir=folder)
