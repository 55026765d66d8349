"""Which files a collection's catalogues are, and in which order they go out."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from services.storage.store import check_name
from services.storage.unity.binary_writer import binary_catalogue
from services.storage.unity.json_writer import json_catalogue
from services.storage.unity.listing import Listing
from services.storage.unity.nouns import Catalogue
from services.storage.unity.plan import locations

_WRITERS: dict[int, Callable[[Listing], bytes]] = {
    0: json_catalogue,
    1: partial(binary_catalogue, version=1),
    2: partial(binary_catalogue, version=2),
    3: partial(binary_catalogue, version=3),
}


@dataclass(frozen=True, slots=True)
class Names:
    """Object names of one catalogue and of its hash; form is 0 for JSON, else the binary version."""

    form: int
    catalogue: str
    hash: str


def file_names(collection: str) -> tuple[Names, ...]:
    """The four catalogues of a collection. Raises ValueError for a collection that no object can be named after.

    Unity replaces a catalogue's extension by `.hash`, so each has a stem of its own: with a common hash, a change of
    one form would make clients of the others load a catalogue again that did not change.
    """
    stems = {form: f"collections/{collection}/unity/catalog" + (f"_v{form}" if form else "") for form in _WRITERS}
    return tuple(
        Names(form, check_name(stem + (".bin" if form else ".json")), f"{stem}.hash") for form, stem in stems.items()
    )


def catalogue_hash(data: bytes) -> bytes:
    """What goes into a catalogue's `.hash`: Unity compares it with the one it has and loads anew when it differs."""
    return hashlib.sha256(data).hexdigest()[:32].encode()


def publication(catalogue: Catalogue, collection: str) -> list[tuple[str, bytes]]:
    """Object names and contents in the order in which they must be put, after the GLB files that they refer to.

    Each catalogue goes before its hash: a client that sees a new hash finds the new catalogue. If the writer dies
    between the two, clients keep what they have, and the next run completes the work. Raises ValueError for assets
    that Unity would misread.
    """
    listing = locations(catalogue)
    files: list[tuple[str, bytes]] = []
    for names in file_names(collection):
        data = _WRITERS[names.form](listing)
        files += (names.catalogue, data), (names.hash, catalogue_hash(data))
    return files
