"""`python -m services.gateway`: one gateway, configured by GATEWAY_* and STORAGE_* variables."""

from __future__ import annotations

import sys

from services.gateway.app import serve
from services.gateway.settings import GatewaySettings
from services.storage.settings import StorageSettings, open_keys, open_store


def main() -> int:
    """The exit status: 0 when told to stop, 1 when it could not start, 2 when the settings are wrong."""
    try:
        settings, storage = GatewaySettings(), StorageSettings()
        store, keys = open_store(storage), open_keys(storage)
    except ValueError as error:
        sys.stderr.write(f"gateway: {error}\n")
        return 2
    return serve(settings, store, keys)


if __name__ == "__main__":
    sys.exit(main())
