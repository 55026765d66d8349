"""An object store in a local folder, the default. Several processes (gateway, workers) may share one root.

Layout: `<root>/<object name>` is the object itself, so any file server can serve it. `.meta/<object name>` holds its
etag and content type (JSON), `.tmp/` files that are being written, `.locks/` the lock files of conditional puts.
"""

from __future__ import annotations

import fcntl
import hashlib
import io
import json
import os
import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from zlib import crc32

from capture2vr.process.atomic_write import atomic_write, sync
from capture2vr.storage.bundle import content_type as type_by_name
from capture2vr.storage.store import IMMUTABLE, NO_CACHE, ConditionFailed, Head, check_name

_COPY_BYTES = 1 << 20  # per read while copying: fast enough for a disk, small for 32 uploads at once
_LOCKS = 64  # lock files; two names with the same lock file wait a few ms for each other
_ABANDONED_S = 24 * 3600.0  # a temporary file older than a day belongs to a process that died


@dataclass(frozen=True, slots=True)
class _Meta:
    """Content of the metadata file. inode, size and mtime_ns tell whether it belongs to the present object file."""

    etag: str
    content_type: str
    cache_control: str
    inode: int
    size: int
    mtime_ns: int

    def describes(self, stat: os.stat_result) -> bool:
        return (self.inode, self.size, self.mtime_ns) == (stat.st_ino, stat.st_size, stat.st_mtime_ns)


class LocalStore:
    """Objects under `root`, served by the gateway below `base_url`."""

    def __init__(self, root: Path, base_url: str = "/v1/files") -> None:
        self.root = Path(root).resolve()
        self._base_url = base_url.rstrip("/")
        for folder in (".meta", ".tmp", ".locks"):
            (self.root / folder).mkdir(parents=True, exist_ok=True)
        self._remove_abandoned()

    def put(
        self,
        name: str,
        data: bytes | Path,
        *,
        content_type: str,
        cache_control: str = IMMUTABLE,
        if_match: str | None = None,
        if_absent: bool = False,
        link: bool = False,
    ) -> Head:
        path = self.path(name)
        temporary = self._temporary_path()
        try:
            linked = link and isinstance(data, Path) and _link(data, temporary)
            etag = _hash_and_sync(temporary) if linked else _write_and_sync(temporary, data)
            stat = temporary.stat()
            meta = _Meta(etag, content_type, cache_control, stat.st_ino, stat.st_size, stat.st_mtime_ns)
            with self._lock(name):
                self._check(name, if_match, if_absent)
                # A crash between the two renames leaves new metadata beside the old bytes. `_Meta.describes` notices,
                # and head() computes the etag anew. The other order would give new bytes an old content type.
                self._write_meta(name, meta)
                _make_folder(path.parent)
                temporary.replace(path)
                sync(path.parent)
        finally:
            temporary.unlink(missing_ok=True)
        return _head(name, stat, meta)

    def get(self, name: str, *, start: int = 0, length: int | None = None) -> bytes:
        with self._open(name) as file:
            file.seek(start)
            return file.read() if length is None else file.read(length)

    def fetch(self, name: str, path: Path) -> None:
        with self._open(name) as source:
            try:
                with path.open("wb") as target:
                    shutil.copyfileobj(source, target, _COPY_BYTES)
            except BaseException:
                path.unlink(missing_ok=True)
                raise

    def head(self, name: str) -> Head:
        with self._open(name) as file:
            stat = os.fstat(file.fileno())
            meta = self._read_meta(name)
            if meta is None or not meta.describes(stat):
                meta = self._rebuild_meta(name, file, stat, meta)
        return _head(name, stat, meta)

    def list(self, prefix: str, *, after: str = "", limit: int = 1000) -> list[Head]:
        heads: list[Head] = []
        for name in self._names(prefix, after):
            try:
                head = self.head(name)
            except FileNotFoundError:
                continue  # deleted since the folder was read
            heads.append(Head(head.name, head.size, head.etag, "", "", head.modified))
            if len(heads) == limit:
                break
        return heads

    def delete(self, name: str) -> None:
        path = self.path(name)
        with self._lock(name):
            path.unlink(missing_ok=True)
            self._meta_path(name).unlink(missing_ok=True)

    def url(self, name: str) -> str:
        return f"{self._base_url}/{check_name(name)}"

    def path(self, name: str) -> Path:
        """Return the path of an object's file, which may not exist. Raises ValueError for an invalid name."""
        return self.root / check_name(name)

    def _meta_path(self, name: str) -> Path:
        return self.root / ".meta" / name

    def _open(self, name: str) -> io.BufferedReader:
        try:
            return self.path(name).open("rb")
        except (IsADirectoryError, NotADirectoryError, FileNotFoundError):
            raise FileNotFoundError(name) from None

    def _check(self, name: str, if_match: str | None, if_absent: bool) -> None:
        if if_match is None and not if_absent:
            return
        try:
            present: str | None = self.head(name).etag
        except FileNotFoundError:
            present = None
        if if_absent and present is not None:
            raise ConditionFailed(f"{name} exists")
        if if_match is not None and present != if_match:
            raise ConditionFailed(f"{name} has changed")

    @contextmanager
    def _lock(self, name: str) -> Iterator[None]:
        """Hold the lock of an object name, across threads and processes; a process that dies loses its lock."""
        with (self.root / ".locks" / f"{crc32(name.encode()) % _LOCKS:02d}").open("ab") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield

    def _temporary_path(self) -> Path:
        """Return a new path for a file to be written; `_remove_abandoned` deletes those that a crash left."""
        return self.root / ".tmp" / uuid.uuid4().hex

    def _read_meta(self, name: str) -> _Meta | None:
        try:
            return _Meta(**json.loads(self._meta_path(name).read_bytes()))
        except (FileNotFoundError, NotADirectoryError, ValueError, TypeError):
            return None  # missing or damaged: head() makes it anew from the object

    def _write_meta(self, name: str, meta: _Meta) -> None:
        path = self._meta_path(name)
        fields = {field: getattr(meta, field) for field in meta.__slots__}
        _make_folder(path.parent)
        with atomic_write(path, temporary=self._temporary_path()) as temporary:
            temporary.write_text(json.dumps(fields))

    def _rebuild_meta(self, name: str, file: io.BufferedReader, stat: os.stat_result, old: _Meta | None) -> _Meta:
        """Make metadata for an object that has none that fits: after a crash between two renames, or a restored backup.

        Written without the lock: if a put happens meanwhile, the next head() finds a mismatch and repeats this.
        """
        etag = hashlib.file_digest(file, "sha256").hexdigest()
        kind = (old.content_type, old.cache_control) if old else (type_by_name(name), NO_CACHE)
        meta = _Meta(etag, *kind, stat.st_ino, stat.st_size, stat.st_mtime_ns)
        with suppress(OSError):  # the folder may be read-only
            self._write_meta(name, meta)
        return meta

    def _names(self, prefix: str, after: str) -> Iterator[str]:
        """Yield the names of objects that begin with `prefix` and sort behind `after`, in order.

        Only folders that have such names are read, one when it is come to: a page of a store of millions costs as much
        as one of a few.
        """
        top = prefix.rpartition("/")[0]
        try:
            start = self.path(top) if top else self.root
        except ValueError:
            return  # no object has such a name
        yield from _names_in(start, f"{top}/" if top else "", prefix, after)

    def _remove_abandoned(self) -> None:
        for file in (self.root / ".tmp").iterdir():
            try:
                if time.time() - file.stat().st_mtime > _ABANDONED_S:
                    file.unlink()
            except FileNotFoundError:
                continue  # another process was faster


def _names_in(folder: Path, named: str, prefix: str, after: str) -> Iterator[str]:
    """Yield the names below a folder, whose own name is `named`, as `LocalStore._names` does."""
    for name in _listed(folder, named):
        if not name.endswith("/"):
            if name.startswith(prefix) and name > after:
                yield name
        elif (name.startswith(prefix) or prefix.startswith(name)) and (name > after or after.startswith(name)):
            yield from _names_in(folder / name[len(named) :], name, prefix, after)


def _listed(folder: Path, named: str) -> list[str]:
    """Return what lies in a folder, by the names of objects in their order; a folder's name ends with a slash."""
    try:
        with os.scandir(folder) as entries:
            # A folder's slash is sorted with its name: "a-b" stands before "a/b", and "a0" behind it.
            return sorted(
                f"{named}{entry.name}{'/' if entry.is_dir(follow_symlinks=False) else ''}"
                for entry in entries
                if entry.name[0] != "."
            )
    except (FileNotFoundError, NotADirectoryError):
        return []


def _head(name: str, stat: os.stat_result, meta: _Meta) -> Head:
    modified = datetime.fromtimestamp(stat.st_mtime, UTC)
    return Head(name, stat.st_size, meta.etag, meta.content_type, meta.cache_control, modified)


def _link(source: Path, target: Path) -> bool:
    """Make `target` a hard link to a file; False where the disk has none, or it is another disk."""
    try:
        target.hardlink_to(source)
    except FileNotFoundError:
        raise
    except OSError:
        return False
    return True


def _hash_and_sync(path: Path) -> str:
    """Fsync a file, and return the sha256 of its bytes in hex."""
    with path.open("rb") as file:
        os.fsync(file.fileno())
        return hashlib.file_digest(file, "sha256").hexdigest()


def _write_and_sync(path: Path, data: bytes | Path) -> str:
    """Write a file, fsync it, and return the sha256 of its bytes in hex."""
    digest = hashlib.sha256()
    with path.open("xb") as target, _open_data(data) as source:
        while block := source.read(_COPY_BYTES):
            digest.update(block)
            target.write(block)
        target.flush()
        os.fsync(target.fileno())
    return digest.hexdigest()


def _open_data(data: bytes | Path) -> io.BufferedIOBase:
    return data.open("rb") if isinstance(data, Path) else io.BytesIO(data)


def _make_folder(folder: Path) -> None:
    """Create a folder and its parents so that they survive a power cut: each new one is synced into its parent."""
    if folder.is_dir():
        return
    _make_folder(folder.parent)
    folder.mkdir(exist_ok=True)
    sync(folder.parent)
