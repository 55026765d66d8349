"""`capture2vr pull`: fetch an asset as a VR client would, hash by hash from its signed collection down to the files."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
from rich.table import Table

from services.cli.assets import check_collection
from services.cli.collections import believed_keys
from services.cli.errors import NO_KEY, BadInput, answer_of
from services.cli.http import client_of
from services.cli.objects import Objects, fetch, sha256_of
from services.cli.progress import console, warn
from services.cli.seen import Seen
from services.storage.catalogue import DEFAULT_COLLECTION, valid_key
from services.storage.collection import Index, Row, Shard, read_index, read_shard
from services.storage.faults import (
    CATALOGUE_OLDER,
    MANIFEST_CHANGED,
    MANIFEST_MISSING,
    SHARD_CHANGED,
    SHARD_MISSING,
    CatalogueFault,
)
from services.storage.reading import DOCUMENT_BYTES, Piece, again_if_moved, pieces_of, row_in
from services.storage.signing import Public

_MANIFEST = "manifest.json"


@dataclass(frozen=True, slots=True)
class _Site:
    """A gateway, and what is believed of it."""

    client: httpx.Client
    gateway: str
    collection: str
    believed: tuple[Public, ...]


@dataclass(frozen=True, slots=True)
class _Found:
    """An asset in its collection, and the objects of that."""

    objects: Objects
    index: Index
    row: Row


def pull_asset(
    key: str,
    out: Path,
    gateway: str,
    *,
    collection: str = "",
    trusted: Sequence[Path] = (),
    cache: Path | None = None,
) -> dict[str, Any]:
    """Download the newest version of `key` into `out`, all of it or nothing; the answer is its manifest.

    collection  where to look; "": where the gateway says that the asset is
    trusted     files of public keys; none: those of the STORAGE_* variables
    Raises BadInput when the asset is absent, unreachable or not what was signed; `out` is then as it was.
    """
    if not valid_key(key):
        raise BadInput(NO_KEY.format(key))
    if collection:
        check_collection(collection)
    believed, cache = believed_keys(trusted), cache or default_cache()
    try:
        with client_of(gateway, follow_redirects=True) as client:
            site = _Site(client, gateway, collection or _home_of(client, key), believed)
            found = again_if_moved(lambda: _find(site, key))
            manifest, pieces = _manifest(found)
            sources = [fetch(found.objects, piece, cache) for piece in pieces]
    except (httpx.RequestError, httpx.InvalidURL) as error:
        raise BadInput(f"{gateway} cannot be reached: {error}") from error
    except CatalogueFault as fault:
        raise BadInput(f"{fault}; {out} is as it was") from fault
    _place(out, {piece.file: cache / piece.sha256 for piece in pieces}, manifest)
    _show(site, found, pieces, sources)
    document: dict[str, Any] = json.loads(manifest)
    return document


def default_cache() -> Path:
    """$XDG_CACHE_HOME/capture2vr, or ~/.cache/capture2vr."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "capture2vr"


def _home_of(client: httpx.Client, key: str) -> str:
    """The first collection that the gateway names for an asset. Raises BadInput."""
    named = answer_of(client.get(f"/v1/assets/{key}")).get("collections") or [DEFAULT_COLLECTION]
    name = str(named[0])
    check_collection(name)
    return name


def _find(site: _Site, key: str) -> _Found:
    """The asset's row in the newest catalogue, which is older than none that was seen. Raises CatalogueFault."""
    answer = site.client.get(f"/v1/collections/{site.collection}")
    objects = Objects(site.client, str(answer_of(answer)["base"]))
    seen = Seen(site.gateway, site.collection)
    try:
        at_least = seen.version if site.believed else 0
        index = read_index(answer.content, site.collection, site.believed, at_least=at_least)
    except CatalogueFault as fault:
        raise _with_way_out(fault, seen) from None
    if site.believed:  # what nobody signed must not count as seen: any number can stand in it
        seen.remember(index.version)
    found = row_in(index, key, lambda shard: _rows(objects, shard))
    if found is None:
        raise BadInput(f"there is no asset {key} in collection {site.collection}; `ls` lists those that there are")
    if found[1].removed:
        raise BadInput(f"asset {key} was removed; `restore {key}` brings it back")
    return _Found(objects, index, found[1])


def _rows(objects: Objects, shard: Shard) -> tuple[Row, ...]:
    limit = min(shard.bytes, DOCUMENT_BYTES)
    return read_shard(objects.whole(shard.name, limit, absent=SHARD_MISSING, changed=SHARD_CHANGED), shard)


def _manifest(found: _Found) -> tuple[bytes, list[Piece]]:
    """The manifest that the row means, and the files in it. Raises CatalogueFault."""
    name = found.row.manifest_name
    data = found.objects.whole(name, DOCUMENT_BYTES, absent=MANIFEST_MISSING, changed=MANIFEST_CHANGED)
    return data, pieces_of(data, found.row)


def _place(out: Path, files: dict[str, Path], manifest: bytes) -> None:
    """Put everything beside its place first, so that a full disk changes nothing; then all of it into its place.

    What an earlier pull put there and this one does not goes, unless somebody has changed it since.
    """
    out.mkdir(parents=True, exist_ok=True)
    if blocked := next((out / name for name in (*files, _MANIFEST) if (out / name).is_dir()), None):
        raise BadInput(f"{blocked} is a folder where a file is to come; name another folder with -o")
    outdated = [path for path in _pulled_before(out) if path.name not in files]
    beside = out / ".pulling"
    shutil.rmtree(beside, ignore_errors=True)  # what a killed one left
    beside.mkdir()
    try:
        for name, cached in files.items():
            shutil.copyfile(cached, beside / name)
        (beside / _MANIFEST).write_bytes(manifest)
        for name in (*files, _MANIFEST):
            (beside / name).replace(out / name)
        for path in outdated:
            path.unlink()
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def _pulled_before(out: Path) -> list[Path]:
    """The files that the manifest of an earlier pull lists, as far as they are still those."""
    try:
        told = json.loads((out / _MANIFEST).read_bytes())["files"]
        files = {out / Path(str(each["file"])).name: str(each["sha256"]) for each in told}
    except (OSError, ValueError, KeyError, TypeError):  # somebody else's, or none
        return []
    return [path for path, sha256 in files.items() if path.is_file() and sha256_of(path) == sha256]


def _with_way_out(fault: CatalogueFault, seen: Seen) -> CatalogueFault:
    """The fault; where a catalogue is older than one seen before, with what to do if that was meant."""
    if fault.code != CATALOGUE_OLDER:
        return fault
    hint = f"{fault.hint}; was it put back on purpose, `catalogue rebuild` there, or delete {seen.path} here"
    return CatalogueFault(fault.code, fault.name, f"the catalogue went back: {fault.message}", hint=hint)


def _show(site: _Site, found: _Found, pieces: Sequence[Piece], sources: Sequence[str]) -> None:
    row, index = found.row, found.index
    table = Table(title=f"{row.key} version {row.version} ({row.state})")
    for column in ("file", "bytes", "sha256", "from"):
        table.add_column(column, justify="right" if column == "bytes" else "left", overflow="fold")
    for piece, source in zip(pieces, sources, strict=True):
        table.add_row(piece.file, f"{piece.size:,}", piece.sha256, source)
    console.print(table)
    if site.believed:
        console.print(f"collection {index.collection} version {index.version}: signature, age, sizes and hashes hold")
    else:
        warn(
            f"collection {index.collection} version {index.version}: sizes and hashes hold; who signed it, and whether "
            "it is an older one, was not checked: name a public key with --trusted or STORAGE_TRUSTED_KEYS"
        )
