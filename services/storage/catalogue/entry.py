"""Catalogue entries: one small mutable JSON document per asset key that lists the asset's current files."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from capture2vr.order.asset_names import AssetNames
from capture2vr.sentences.sentence import say
from capture2vr.storage.bundle import Json
from capture2vr.storage.catalogue.asset_notes import Note, notes_of
from capture2vr.storage.catalogue.faults import ENTRY_DAMAGED, CatalogueFault
from capture2vr.storage.catalogue.visibility import Visibility, parse_visibility
from capture2vr.storage.store import Head, Store

_KEY = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
_FIELDS = {
    "version": int,
    "state": str,
    "updated": str,
    "label": str | None,
    "manifest": dict,
    "preview": dict | None,
    "lods": list,
    "files": list,
    "versions": list,
}
"""Fields of an entry, and what they hold."""
_PREFIX, _SUFFIX = "catalog/", ".json"

DEFAULT_COLLECTION = "default"

GENERATED = "generated"
"""Origin in the manifest of what a generator made up, and the label of its assets in lists."""


@dataclass(frozen=True, slots=True)
class Entry:
    """The catalogue document of an asset key, and the etag it was read with."""

    key: str
    etag: str
    document: Mapping[str, Json]

    @property
    def version(self) -> int:
        return int(self.document["version"])

    @property
    def state(self) -> str:
        return str(self.document["state"])

    @property
    def manifest(self) -> str:
        """Object name of the current version's manifest."""
        return str(self.document["manifest"]["name"])

    @property
    def versions(self) -> list[dict[str, Any]]:
        return list(self.document["versions"])

    @property
    def removed(self) -> bool:
        """Whether the asset was removed (hidden). Its files stay, so that it can be restored."""
        return bool(self.document.get("removed"))

    @property
    def grade(self) -> str:
        """Level of the current version's grade; "" where nothing could tell, as of point clouds and older entries."""
        return str(self.document.get("grade") or "")

    @property
    def record(self) -> dict[str, Any]:
        """What the list of versions has of the current one, which is not the newest where that is held back."""
        return next((each for each in self.versions if each["version"] == self.version), {})

    @property
    def held(self) -> bool:
        """Whether the current version is held back, so that no list has the asset; one without any other is."""
        return bool(self.record.get("held"))

    @property
    def visibility(self) -> Visibility | None:
        """The asset's own visibility; None: that of its collections."""
        return parse_visibility(self.document.get("visibility"))

    @property
    def names(self) -> AssetNames:
        """What people call the asset."""
        return AssetNames.of(self.document)

    @property
    def tags(self) -> tuple[str, ...]:
        """The labels that lists and Unity's catalogues have: those that people gave, and of what a generator made up
        that it is generated, which nobody takes away."""
        given = self.names.labels
        if self.document.get("origin") != GENERATED:
            return given
        return (*(label for label in given if label.casefold() != GENERATED), GENERATED)

    @property
    def notes(self) -> tuple[Note, ...]:
        """What people have pinned to the asset."""
        return notes_of(self.document)

    @property
    def collections(self) -> list[str]:
        """Collections that list the asset; the default one for entries written before collections existed."""
        return list(self.document.get("collections", (DEFAULT_COLLECTION,)))


def valid_key(key: str) -> bool:
    """Return whether this is a valid asset key: 1 to 100 letters, digits and ._- that begin with a letter or digit."""
    return _KEY.fullmatch(key) is not None


def check_key(key: str) -> str:
    """Return the key unchanged. Raises ValueError for one that `valid_key` refuses."""
    if not valid_key(key):
        raise ValueError(
            f"{key!r} is not a valid asset key: use 1 to 100 of A-Z a-z 0-9 . _ - and begin with a letter or digit"
        )
    return key


def check_collection(name: str) -> str:
    """Return the name unchanged. Raises ValueError for an invalid collection name: the rules are those of keys."""
    if not valid_key(name):
        raise ValueError(
            f"{name!r} is not a valid collection name: use 1 to 100 of A-Z a-z 0-9 . _ - "
            "and begin with a letter or digit"
        )
    return name


def entry_name(key: str) -> str:
    """Return the object name of a key's catalogue entry."""
    return f"{_PREFIX}{check_key(key)}{_SUFFIX}"


def alias_name(key: str) -> str:
    """Return the object name of a key's alias `{"version", "manifest"}`, which always names the current version."""
    return f"alias/{check_key(key)}/latest.json"


def read_entry(store: Store, key: str) -> Entry:
    """Read the catalogue entry of a key.

    Raises FileNotFoundError when nothing was published under it, CatalogueFault for an entry that is damaged.
    """
    name = entry_name(key)
    # The etag is read before the content: if somebody writes in between, the etag is the older one and a conditional
    # put with it is refused. The other order would overwrite what was never read.
    etag = store.head(name).etag
    return Entry(key, etag, _parse(name, store.get(name)))


def _parse(name: str, data: bytes) -> dict[str, Json]:
    try:
        document = json.loads(data)
    except ValueError:
        document = None
    if isinstance(document, dict) and all(isinstance(document.get(each), kind) for each, kind in _FIELDS.items()):
        files = [document["manifest"], *document["lods"], *document["files"]]
        if all(isinstance(file, dict) and isinstance(file.get("name"), str) for file in files):
            return document
    hint = "restore this object from a backup; the asset's files are still below assets/"
    raise CatalogueFault(ENTRY_DAMAGED, name, say("asset_catalogue_entry_damaged"), hint=hint)


def list_keys(store: Store, *, after: str = "", limit: int = 100) -> list[str]:
    """List at most `limit` asset keys that sort behind `after`, in the order of their object names."""
    heads = store.list(_PREFIX, after=entry_name(after) if after else "", limit=limit)
    return [_key_of(head) for head in heads]


def _key_of(head: Head) -> str:
    return head.name.removeprefix(_PREFIX).removesuffix(_SUFFIX)
