"""Settings and store of a gateway on this machine, for commands that work on its database."""

from __future__ import annotations

import os
from pathlib import Path

from services.cli.errors import BadInput
from services.gateway.settings import GatewaySettings
from services.storage.settings import StorageSettings, open_store
from services.storage.store import Store

_PLACES = ("GATEWAY_DATA_DIR", "GATEWAY_DATABASE_URL")


def local_settings(data: Path) -> GatewaySettings:
    """Return the settings that name the database: the environment's, else for the data folder of `up` or a gateway.

    Raises BadInput for a wrong setting.
    """
    try:
        if any(os.environ.get(name) for name in _PLACES):
            return GatewaySettings()
        folder = data if (data / "gateway.db").exists() else data / "gateway"
        folder.mkdir(parents=True, exist_ok=True)
        return GatewaySettings(data_dir=folder)
    except ValueError as error:
        raise BadInput(str(error)) from error


def local_store(data: Path) -> Store:
    """Return the store of the STORAGE_* variables, or the one in the data folder of `up`. Raises BadInput."""
    named = any(name.startswith("STORAGE_") for name in os.environ)
    try:
        return open_store(StorageSettings() if named else StorageSettings(root=data / "store"))
    except ValueError as error:
        raise BadInput(str(error)) from error
