"""Check the names that the user gives to assets and collections, and ids of a gateway."""

from __future__ import annotations

import re

from capture2vr.errors import BadInput
from capture2vr.storage.catalogue.entry import valid_key

_ID = re.compile(r"[A-Za-z0-9_-]{1,100}", re.ASCII)


def check_key(key: str) -> None:
    """Raises BadInput for an invalid asset key."""
    _check("asset key", key)


def check_collection(name: str) -> None:
    """Raises BadInput for an invalid collection name."""
    _check("collection", name)


def check_id(text: str) -> str:
    """Return the id of a job or a capture. Raises BadInput for a text that is none."""
    if not _ID.fullmatch(text):
        raise BadInput(f"{text!r} is not the id of a job or a capture")
    return text


def _check(kind: str, name: str) -> None:
    if not valid_key(name):
        how = "use 1 to 100 of A-Z a-z 0-9 . _ - and begin with a letter or digit"
        raise BadInput(f"'{name}' is not a valid {kind}: {how}")
