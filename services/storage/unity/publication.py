"""The files of a collection's Unity catalogues: their object names, contents, and the order in which to write them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from capture2vr.storage.store import check_name
from capture2vr.storage.unity.binary_writer import binary_catalogue
from capture2vr.storage.unity.json_writer import json_catalogue
from capture2vr.storage.unity.listing import Listing
from capture2vr.storage.unity.locations import build_listing
from capture2vr.storage.unity.nouns import Catalogue

_WRITERS: dict[int, Callable[[Listing], bytes]] = {
    0: json_catalogue,
    1: partial(binary_catalogue, version=1),
    2: partial(binary_catalogue, version=2),
    3: partial(binary_catalogue, version=3),
}


@dataclass(frozen=True, slots=True)
class CatalogueNames:
    """Object names of one catalogue and of its hash file. form: 0 for JSON, else the version of the binary form"""

    form: int
    catalogue: str
    hash: str


def catalogue_names(collection: str) -> tuple[CatalogueNames, ...]:
    """Return the names of a collection's four catalogues. Raises ValueError for an invalid collection name.

    Each has a stem of its own, because Unity replaces the extension by `.hash`: with a common hash file, a change of
    one form would make clients of the others download an unchanged catalogue again.
    """
    stems = {form: f"collections/{collection}/unity/catalog" + (f"_v{form}" if form else "") for form in _WRITERS}
    return tuple(
        CatalogueNames(form, check_name(stem + (".bin" if form else ".json")), f"{stem}.hash")
        for form, stem in stems.items()
    )


def catalogue_hash(data: bytes) -> bytes:
    """Return the content of a catalogue's `.hash` file; Unity downloads the catalogue again when it has changed."""
    return hashlib.sha256(data).hexdigest()[:32].encode()


def catalogue_files(catalogue: Catalogue, collection: str) -> list[tuple[str, bytes]]:
    """Return object names and contents in the order in which to write them, after the GLB files that they refer to.

    Each catalogue comes before its hash: a client that sees a new hash finds the new catalogue. After a crash between
    the two, clients keep the old catalogue, and the next run completes the work. Raises ValueError for assets that
    Unity would misread.
    """
    listing = build_listing(catalogue)
    files: list[tuple[str, bytes]] = []
    for names in catalogue_names(collection):
        data = _WRITERS[names.form](listing)
        files += (names.catalogue, data), (names.hash, catalogue_hash(data))
    return files
