"""Read the public keys that verify downloads: from files, or from the STORAGE_* variables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from capture2vr.errors import BadInput
from capture2vr.storage.catalogue.signing import Keys, PublicKey, read_public_key
from capture2vr.storage.settings import StorageSettings, open_keys


def load_verification_keys(trusted: Sequence[Path]) -> tuple[PublicKey, ...]:
    """Read the public keys in these files; without files, those of the STORAGE_* variables. Raises BadInput."""
    if not trusted:
        return storage_keys(storage_settings()).verification_keys
    try:
        return tuple(read_public_key(path) for path in trusted)
    except ValueError as error:
        raise BadInput(f"--trusted: {error}") from error


def storage_keys(settings: StorageSettings) -> Keys:
    """Open the keys that the settings name. Raises BadInput."""
    try:
        return open_keys(settings)
    except ValueError as error:
        raise BadInput(str(error)) from error


def storage_settings() -> StorageSettings:
    """Read the STORAGE_* variables. Raises BadInput."""
    try:
        return StorageSettings()
    except ValueError as error:
        raise BadInput(str(error)) from error
