"""Copy the objects of a store into a folder, and back into an empty store.

In the folder each content is a file named by its sha256, so that a second copy writes only what is new. The inventory,
a list of `StoredObject`, says which object has which content.
"""

from __future__ import annotations

import hashlib
import itertools
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from capture2vr.process.atomic_write import atomic_write
from capture2vr.storage.bundle import hash_in_name, sha256_of
from capture2vr.storage.store import Head, Store, check_name, list_all
from capture2vr.storage.tenant_store import tenant_of

_AT_ONCE = 8  # objects: a store far away answers each only after some time
# What is rewritten in place refers to objects that were written before it. Read first, it refers to nothing that is
# missing from the copy: publishing writes files, entry, alias and collection in this order, and scenes name assets.
_CHANGING = ("scenes/", "collections/", "alias/", "catalog/")
_LEFT_OUT = "uploads/"  # parts of unfinished uploads, which are gone in an hour
_BATCH = 1_000  # objects, as many as a store lists at once
PART = ".part-"
"""What the name of a file that is being written begins with; a crash leaves it."""
_READ_BYTES = 16 << 20  # per request
_SHA256_LENGTH = 64  # hex digits: the etag of a local store is the sha256

_In = TypeVar("_In")
_Out = TypeVar("_Out")


@dataclass(frozen=True, slots=True)
class StoredObject:
    """An object in the inventory. sha256, content_type and cache_control are "" where its content was not copied."""

    name: str
    size: int
    etag: str
    sha256: str = ""
    content_type: str = ""
    cache_control: str = ""

    @property
    def changes(self) -> bool:
        """Return whether the object is mutable, like a catalogue, rather than named by its hash."""
        return _changes(self.name)


@dataclass(frozen=True, slots=True)
class Comparison:
    """A store compared with an inventory: names of objects that are missing, or are not what they were.

    newer  catalogues, which are rewritten in the course of things
    """

    missing: tuple[str, ...]
    changed: tuple[str, ...]
    newer: tuple[str, ...]


def list_objects(store: Store) -> Iterator[StoredObject]:
    """Yield the inventory of a store, without the contents. Raises OSError."""
    for head in list_all(store, ""):
        if _is_ours(head.name):
            yield StoredObject(head.name, head.size, head.etag)


def copy_objects(store: Store, folder: Path, known: Mapping[str, StoredObject]) -> Iterator[StoredObject]:
    """Copy the contents of all objects into the folder, and yield the inventory. Raises OSError.

    known  inventory by name of an earlier copy in the same folder: what it has is not read again
    """
    heads = [head for head in list_all(store, "") if _is_ours(head.name) and _changes(head.name)]
    copy = partial(_copy_object, store, folder, known)
    yield from _side_by_side(copy, sorted(heads, key=_reading_order))
    # Listed only now: files of a version that was published since the first list.
    yield from _side_by_side(copy, _files(store))


def content_path(folder: Path, sha256: str) -> Path:
    """Return the file of a content in the folder of a copy."""
    return folder / sha256[:2] / sha256


def unexpected_objects(store: Store, inventory: Iterable[StoredObject]) -> list[str]:
    """Return the names of objects that the store has and a copy with this inventory has not, or otherwise.

    What an interrupted `restore_objects` has written is as in the inventory.
    """
    wanted = {each.name: each for each in inventory}
    found = [head for head in list_all(store, "") if _is_ours(head.name)]
    return [head.name for head in found if head.name not in wanted or not _is_same(store, head, wanted[head.name])]


def restore_objects(store: Store, folder: Path, inventory: Iterable[StoredObject]) -> int:
    """Write all objects of a copy that the store has not; return how many. Raises OSError."""
    present = {head.name for head in list_all(store, "")}
    missing = [each for each in inventory if each.name not in present]
    return sum(1 for _ in _side_by_side(partial(_restore_object, store, folder), missing))


def compare(store: Store, inventory: Iterable[StoredObject]) -> Comparison:
    """Compare a store with an inventory by sizes and etags; by sizes alone where the etags are of two kinds."""
    present = {head.name: head for head in list_all(store, "")}
    missing: list[str] = []
    changed: list[str] = []
    newer: list[str] = []
    for each in inventory:
        head = present.get(each.name)
        if head is None:
            missing.append(each.name)
        elif head.size != each.size or not _may_be_same(head.etag, each):
            (newer if each.changes else changed).append(each.name)
    return Comparison(tuple(missing), tuple(changed), tuple(newer))


def _is_ours(name: str) -> bool:
    """Whether it is an object that belongs into a backup; a bucket may have objects of others."""
    try:
        return not tenant_of(check_name(name))[1].startswith(_LEFT_OUT)
    except ValueError:
        return False


def _changes(name: str) -> bool:
    return tenant_of(name)[1].startswith(_CHANGING) and hash_in_name(name) is None


def _reading_order(head: Head) -> int:
    return next(rank for rank, prefix in enumerate(_CHANGING) if tenant_of(head.name)[1].startswith(prefix))


def _files(store: Store) -> Iterator[Head]:
    for head in list_all(store, ""):
        if _is_ours(head.name) and not _changes(head.name):
            yield head


def _side_by_side(work: Callable[[_In], _Out | None], items: Iterable[_In]) -> Iterator[_Out]:
    """Yield the results of work that are not None, in order; of a long list only some items are read ahead."""
    left = iter(items)
    with ThreadPoolExecutor(_AT_ONCE, "objects") as threads:
        while some := list(itertools.islice(left, _BATCH)):
            yield from (result for result in threads.map(work, some) if result is not None)


def _copy_object(store: Store, folder: Path, known: Mapping[str, StoredObject], head: Head) -> StoredObject | None:
    """Copy an object; None where it was deleted since it was listed."""
    before = known.get(head.name)
    is_known = before is not None and (before.size, before.etag) == (head.size, head.etag) and before.sha256
    if before is not None and is_known and _is_there(content_path(folder, before.sha256), head.size):
        return before
    part = folder / f"{PART}{uuid.uuid4().hex}"
    try:
        store.fetch(head.name, part)
        full = store.head(head.name)
    except FileNotFoundError:
        part.unlink(missing_ok=True)
        return None
    size, sha256 = part.stat().st_size, _move_to_place(part, folder)
    return StoredObject(head.name, size, head.etag, sha256, full.content_type, full.cache_control)


def _move_to_place(part: Path, folder: Path) -> str:
    """Give a new content its name in the folder, on the disk for good; return its sha256."""
    sha256 = sha256_of(part)
    path = content_path(folder, sha256)
    if _is_there(path, part.stat().st_size):
        part.unlink()
    else:
        path.parent.mkdir(mode=0o700, exist_ok=True)
        with atomic_write(path, temporary=part):
            part.chmod(0o600)
    return sha256


def _is_there(path: Path, size: int) -> bool:
    """Whether a content has its file, of its size: one that was cut off is written again. Its hash is for `verify`."""
    try:
        return path.stat().st_size == size
    except FileNotFoundError:
        return False


def _restore_object(store: Store, folder: Path, wanted: StoredObject) -> Head:
    path = content_path(folder, wanted.sha256)
    return store.put(wanted.name, path, content_type=wanted.content_type, cache_control=wanted.cache_control)


def _is_same(store: Store, head: Head, wanted: StoredObject) -> bool:
    """Whether an object has the content that the inventory says; it is read where its etag does not tell."""
    if head.size != wanted.size:
        return False
    return head.etag == wanted.sha256 or _sha256_on_store(store, head) == wanted.sha256


def _sha256_on_store(store: Store, head: Head) -> str:
    digest = hashlib.sha256()
    for start in range(0, head.size, _READ_BYTES):
        digest.update(store.get(head.name, start=start, length=_READ_BYTES))
    return digest.hexdigest()


def _may_be_same(etag: str, wanted: StoredObject) -> bool:
    """Compare an object's etag with the inventory; return False where that proves a change.

    Etags are compared where both are of one kind: sha256 of a local store, md5 of S3. One of S3 with a "-" depends on
    the sizes of the parts in which the object was uploaded.
    """
    then = wanted.sha256 if len(etag) == _SHA256_LENGTH and wanted.sha256 else wanted.etag
    return etag == then or len(etag) != len(then) or "-" in etag
