"""The folder of backups: what is in it, the manifest of each backup, checks, and removal of old ones.

    objects/<2 hex digits>/<sha256>      contents of objects, which all backups in the folder share
    backups/<time>/backup.json           what the backup has, with the sha256 of each part and of itself
    backups/<time>/database.zip          rows of the database
    backups/<time>/objects.json.gz       inventory of the store
    backups/<time>/keys.sealed           keys, encrypted; where they were asked for

A backup has its name only when it is whole: until then it is called .part-<time>, and the next one removes that.
"""

from __future__ import annotations

import fcntl
import gzip
import hashlib
import json
import shutil
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from capture2vr.cli.progress import warn
from capture2vr.errors import BadInput
from capture2vr.gateway.database.full_disk import is_disk_full
from capture2vr.process.atomic_write import sync
from capture2vr.storage.bundle import sha256_of
from capture2vr.storage.object_backup import PART, StoredObject, content_path

DATABASE, INVENTORY, KEYS = "database.zip", "objects.json.gz", "keys.sealed"
"""Files of a backup."""

NAME_TIME = "%Y%m%dT%H%M%S.%fZ"
"""How the name of a backup has its time in UTC."""

_MOST_DAYS = 365_000
_MANIFEST = "backup.json"
_FORMAT = 2  # 1: secrets in the database were never encrypted


@dataclass(frozen=True, slots=True)
class Manifest:
    """What a backup has.

    made     time in UTC, ISO 8601; version: of capture2vr; schema: of the database
    objects  their number; bytes: of all of them; copied: whether their contents are in the folder
    parts    sha256 of each file of the backup
    sealed   a text that the passphrase has encrypted, as it has the secrets in the database's rows; "": it has not
    """

    made: str
    version: str
    schema: str
    rows: int
    objects: int
    bytes: int
    copied: bool
    parts: dict[str, str]
    sealed: str = ""

    @property
    def made_at(self) -> float:
        """When it was made, in seconds since the epoch."""
        return datetime.fromisoformat(self.made).timestamp()


@dataclass(frozen=True, slots=True)
class BackupRetention:
    """Which backups stay: the newest so many, and those of the last so many days. Both 0: all.

    The newest one stays always.
    """

    newest: int = 0
    days: float = 0.0

    def kept(self, names: Sequence[str], now: datetime) -> list[str]:
        """Return those of the names of backups, the newest first, that stay."""
        if not self.newest and not self.days:
            return list(names)
        since = f"{now - timedelta(days=min(self.days, _MOST_DAYS)):{NAME_TIME}}"
        most = max(1, self.newest)
        return [name for place, name in enumerate(names) if place < most or (self.days and name >= since)]


@dataclass(frozen=True, slots=True)
class Backup:
    """A whole backup in the folder."""

    folder: Path
    manifest: Manifest

    @property
    def has_keys(self) -> bool:
        return KEYS in self.manifest.parts

    @property
    def contents(self) -> Path:
        """Folder of the objects' contents."""
        return self.folder.parents[1] / "objects"

    def inventory(self) -> list[StoredObject]:
        """Read the inventory of the store. Raises BadInput where it is damaged."""
        path = self.folder / INVENTORY
        try:
            with gzip.open(path, "rt", encoding="utf-8") as file:
                return [StoredObject(**json.loads(line)) for line in file]
        except (OSError, EOFError, zlib.error, ValueError, TypeError) as error:
            raise BadInput(f"{path} is damaged ({error}): take another backup, with --at") from None

    def faults(self) -> Iterator[str]:
        """Yield the files that are missing or are not what they were, each with the reason. Raises OSError."""
        damaged = False
        for name, sha256 in self.manifest.parts.items():
            if fault := _fault(self.folder / name, sha256):
                damaged = True
                yield fault
        if not damaged and self.manifest.copied:
            for sha256 in sorted({each.sha256 for each in self.inventory()}):
                if fault := _fault(content_path(self.contents, sha256), sha256):
                    yield fault


def backups_in(folder: Path) -> list[str]:
    """Return the names of the whole backups in a folder, the newest first."""
    return sorted((path.name for path in (folder / "backups").glob("2*")), reverse=True)


def open_backup(folder: Path, name: str) -> Backup:
    """Return a backup, the newest for "". Raises BadInput where there is none, or its manifest is damaged."""
    found = backups_in(folder)
    if not found:
        raise BadInput(f"{folder} has no backup: name the folder that `capture2vr backup create` was given")
    if name and name not in found:
        raise BadInput(f"{folder} has no backup {name}; it has {', '.join(found)}")
    path = folder / "backups" / (name or found[0])
    return Backup(path, _read_manifest(path / _MANIFEST))


def read_or_warn(folder: Path, name: str) -> tuple[Manifest, list[StoredObject]] | None:
    """Return the manifest and the inventory of a backup; None, with a warning, where it is damaged."""
    try:
        backup = open_backup(folder, name)
        return backup.manifest, backup.inventory()
    except (BadInput, OSError):
        warn(f"the earlier backup {folder / 'backups' / name} is damaged: `capture2vr backup verify` says how")
        return None


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Lock the backup folder against a second backup; create it if it is missing. Raises BadInput, OSError."""
    for each in (folder, folder / "objects", folder / "backups"):
        each.mkdir(mode=0o700, parents=True, exist_ok=True)
    with (folder / "lock").open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BadInput(f"{folder}: another backup is being written to it; wait until it has ended") from None
        _remove_unfinished(folder)
        yield


@contextmanager
def new_backup(folder: Path, name: str) -> Iterator[Path]:
    """Yield the folder of a new backup, which has its name once `write_manifest` was called and the block has ended."""
    part, path = folder / "backups" / f"{PART}{name}", folder / "backups" / name
    part.mkdir(mode=0o700)
    try:
        yield part
        for file in part.iterdir():
            sync(file)
        sync(part)
    except BaseException as error:
        shutil.rmtree(part, ignore_errors=True)
        if isinstance(error, OSError) and is_disk_full(error):
            _remove_unused(folder)
        raise
    part.rename(path)
    sync(path.parent)


def write_inventory(path: Path, objects: Iterable[StoredObject]) -> list[StoredObject]:
    """Write the inventory of a store, and return it. Raises OSError."""
    found = sorted(objects, key=lambda each: each.name)
    with gzip.open(path, "wt", encoding="utf-8") as file:
        file.writelines(json.dumps(asdict(each)) + "\n" for each in found)
    return found


def write_manifest(folder: Path, **values: Any) -> Manifest:
    """Write the manifest of a backup whose other files are there. values: of Manifest, but for its parts"""
    parts = {path.name: sha256_of(path) for path in sorted(folder.iterdir())}
    manifest = Manifest(parts=parts, **values)
    document = {"format": _FORMAT, **asdict(manifest)}
    (folder / _MANIFEST).write_text(json.dumps({**document, "sha256": _digest(document)}, indent=1) + "\n")
    for path in folder.iterdir():
        path.chmod(0o600)  # the database has secrets of webhooks, and everybody's things
    return manifest


def remove_old(folder: Path, keep: BackupRetention, now: datetime) -> int:
    """Remove the backups that are not kept, and the contents that no other one has; return how many backups went.

    None goes while one of those that are kept is damaged: which contents it has is not known then.
    """
    found = backups_in(folder)
    kept = keep.kept(found, now)
    old = [name for name in found if name not in kept]
    if not old:
        return 0
    wanted = _contents_of(folder, kept)
    if wanted is None:
        warn("no older backup is removed before the damaged one's folder is")
        return 0
    for name in old:
        shutil.rmtree(folder / "backups" / name)
    _remove_contents(folder, wanted)
    return len(old)


def _contents_of(folder: Path, names: Sequence[str]) -> set[str] | None:
    """Return the contents that these backups have; None where one is damaged."""
    found = [read_or_warn(folder, name) for name in names]
    if None in found:
        return None
    return {each.sha256 for backup in found if backup for each in backup[1]}


def _remove_contents(folder: Path, wanted: set[str]) -> None:
    for path in (folder / "objects").glob("??/*"):
        if path.name not in wanted:
            path.unlink()


def _remove_unused(folder: Path) -> None:
    """Give a full disk back what a backup has copied that did not come to its end."""
    _remove_unfinished(folder)
    wanted = _contents_of(folder, backups_in(folder))
    if wanted is not None:
        _remove_contents(folder, wanted)


def _remove_unfinished(folder: Path) -> None:
    for path in (folder / "backups").glob(f"{PART}*"):
        shutil.rmtree(path)
    for path in (folder / "objects").glob(f"{PART}*"):
        path.unlink()


def _fault(path: Path, sha256: str) -> str:
    """Return what is wrong with a file; "" where it is what it was."""
    try:
        return "" if sha256_of(path) == sha256 else f"{path} was changed: its hash is another one"
    except FileNotFoundError:
        return f"{path} is missing"


def _read_manifest(path: Path) -> Manifest:
    try:
        document = json.loads(path.read_bytes())
        sha256 = document.pop("sha256")
        version = document.pop("format")
        if version > _FORMAT:
            raise BadInput(f"{path}: of a newer version of capture2vr: install that version, and restore with it")
        if sha256 != _digest({"format": version, **document}):
            raise ValueError("its hash is another one")
        return Manifest(**document)
    except (ValueError, TypeError, KeyError, AttributeError, FileNotFoundError) as error:
        raise BadInput(f"{path} is damaged ({error}): take another backup, with --at") from None


def _digest(document: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def listed(names: Sequence[str], most: int = 5) -> str:
    """Return names for a sentence: the first few, and how many more there are."""
    more = f" and {len(names) - most:,} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
