"""Settings and store of a gateway on this machine, for commands that work on its database."""

from __future__ import annotations

import os
from pathlib import Path

from capture2vr.errors import BadInput
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.storage.settings import StorageSettings, open_store
from capture2vr.storage.store import Store

_PLACES = ("GATEWAY_DATA_DIR", "GATEWAY_DATABASE_URL")
_STORES = ("STORAGE_ROOT", "STORAGE_KIND")
_CONTENTS = ("gateway", "store", "gateway.db", "snapshots")  # of a data folder of `up`, or of a gateway alone


def check_data(data: Path) -> None:
    """Check that there is a gateway to work on: its data folder, or variables that name its database or its store.

    Raises BadInput.
    """
    if any(os.environ.get(name) for name in (*_PLACES, *_STORES)):
        return
    if not data.is_dir():
        raise BadInput(f"{data} does not exist: name the data folder of the gateway with --data")
    if not any((data / name).exists() for name in _CONTENTS):
        raise BadInput(f"{data}: there is no database or store of a gateway in it: name its data folder with --data")


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
    """Return the store that the STORAGE_* variables name, else the one of `up` in the data folder, else a gateway's.

    Variables that name no place, such as STORAGE_COLLECTION or STORAGE_SIGNING_KEY, change none. Raises BadInput.
    """
    try:
        settings = StorageSettings()
        has_place = settings.kind != "local" or "root" in settings.model_fields_set
        return open_store(settings if has_place or _is_gateway_alone(data) else StorageSettings(root=data / "store"))
    except ValueError as error:
        raise BadInput(str(error)) from error


def _is_gateway_alone(data: Path) -> bool:
    """Return whether a gateway was run without `up`: it has its store elsewhere than in the data folder."""
    if (data / "gateway.db").exists():
        return True
    return any(os.environ.get(name) for name in _PLACES) and not (data / "store").exists()
