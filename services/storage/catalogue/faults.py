"""Errors found when a catalogue or the files that it lists are read and verified, each with a code."""

from __future__ import annotations

ENTRY_DAMAGED = "ENTRY_DAMAGED"
SIGNATURE_MISSING = "SIGNATURE_MISSING"
SIGNATURE_WRONG = "SIGNATURE_WRONG"
KEY_UNKNOWN = "KEY_UNKNOWN"
CATALOGUE_MISSING = "CATALOGUE_MISSING"
CATALOGUE_TRUNCATED = "CATALOGUE_TRUNCATED"
CATALOGUE_OTHER = "CATALOGUE_OTHER"
CATALOGUE_OLDER = "CATALOGUE_OLDER"
SHARD_MISSING = "SHARD_MISSING"
SHARD_CHANGED = "SHARD_CHANGED"
MANIFEST_MISSING = "MANIFEST_MISSING"
MANIFEST_CHANGED = "MANIFEST_CHANGED"
FILE_MISSING = "FILE_MISSING"
FILE_CHANGED = "FILE_CHANGED"
SIGNING_KEY_MISSING = "SIGNING_KEY_MISSING"
SCENE_DAMAGED = "SCENE_DAMAGED"


class CatalogueFault(OSError):  # noqa: N818 - a fault of what was read, not of this program
    """An object on the store is missing, damaged, or not the one that was signed.

    An OSError, because for the caller the store has failed. code: one of this file's constants; name: of the object
    """

    def __init__(self, code: str, name: str, message: str, *, hint: str = "") -> None:
        super().__init__(f"{name}: {message}" + (f" ({hint})" if hint else ""))
        self.code = code
        self.name = name
        self.message = message
        self.hint = hint
