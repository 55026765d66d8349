"""Check the names that the user gives to assets and collections."""

from __future__ import annotations

from capture2vr.errors import BadInput
from capture2vr.storage.catalogue.entry import valid_key


def check_key(key: str) -> None:
    """Raises BadInput for an invalid asset key."""
    _check("asset key", key)


def check_collection(name: str) -> None:
    """Raises BadInput for an invalid collection name."""
    _check("collection", name)


def _check(kind: str, name: str) -> None:
    if not valid_key(name):
        how = "use 1 to 100 of A-Z a-z 0-9 . _ - and begin with a letter or digit"
        raise BadInput(f"'{name}' is not a valid {kind}: {how}")
