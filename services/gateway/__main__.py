"""`python -m capture2vr.gateway`: run one gateway, configured by the environment variables GATEWAY_* and STORAGE_*."""

from __future__ import annotations

import sys

from capture2vr.gateway.server import serve
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.process.private_files import hide_secrets, write_for_own_user
from capture2vr.process.strict_settings import SettingsError
from capture2vr.storage.settings import StorageSettings, open_keys, open_store


def start(*, everybody: bool = False) -> int:
    """Serve a gateway until SIGTERM, and return the exit status. Raises SettingsError that names a wrong setting.

    everybody  let everybody in without an access key, as GATEWAY_OPEN does
    """
    write_for_own_user()
    hide_secrets()
    try:
        settings = GatewaySettings(open=True) if everybody else GatewaySettings()
        storage = StorageSettings()
        store, keys = open_store(storage), open_keys(storage)
    except ValueError as error:
        raise SettingsError(str(error)) from error
    return serve(settings, store, keys)


def main() -> int:
    """Run the gateway. Exit status: 0 after a normal stop, 1 when it could not start, 2 when the settings are wrong."""
    try:
        return start()
    except SettingsError as error:
        sys.stderr.write(f"gateway: {error}\n")
        return 2


if __name__ == "__main__":
    sys.exit(main())
