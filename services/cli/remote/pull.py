"""`capture2vr pull`: download an asset as a VR client would, checking all hashes from the signed collection down."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import httpx
from rich.table import Table

from capture2vr.cli.errors import BadInput, parse_answer
from capture2vr.cli.key_names import check_collection, check_key
from capture2vr.cli.local.earlier_results import MANIFEST, files_of_pull, names_of_both
from capture2vr.cli.progress import console, warn
from capture2vr.cli.remote.catalogue_work import load_verification_keys
from capture2vr.cli.remote.download import RemoteObjects, fetch
from capture2vr.cli.remote.http import client_of
from capture2vr.cli.remote.seen_version import SeenVersion, user_folder
from capture2vr.cli.remote.share_link import SharedThing, open_link, split_link
from capture2vr.storage.bundle import sha256_of
from capture2vr.storage.catalogue.collection import Row, Shard, read_index, read_shard
from capture2vr.storage.catalogue.entry import DEFAULT_COLLECTION, valid_key
from capture2vr.storage.catalogue.faults import (
    CATALOGUE_OLDER,
    MANIFEST_CHANGED,
    MANIFEST_MISSING,
    SHARD_CHANGED,
    SHARD_MISSING,
    CatalogueFault,
)
from capture2vr.storage.catalogue.proof import check_proof
from capture2vr.storage.catalogue.reader import (
    DOCUMENT_BYTES,
    AssetFile,
    find_row,
    parse_manifest,
    retry_if_shard_missing,
)
from capture2vr.storage.catalogue.signing import PublicKey


@dataclass(frozen=True, slots=True)
class _CollectionSource:
    """A collection at a gateway, and the public keys that verify it."""

    client: httpx.Client
    gateway: str
    collection: str
    verification_keys: tuple[PublicKey, ...]
    tenant: str = ""

    @property
    def query(self) -> dict[str, str]:
        """The query parameter `tenant` of requests; none for the caller's own collection."""
        return {"tenant": self.tenant} if self.tenant else {}


@dataclass(frozen=True, slots=True)
class _FoundAsset:
    """An asset's row, a client for its objects, and what was signed: the collection or the asset, and which version."""

    objects: RemoteObjects
    row: Row
    signed: str


def pull_asset(
    key: str,
    out: Path,
    gateway: str,
    *,
    collection: str = "",
    trusted: Sequence[Path] = (),
    cache: Path | None = None,
    share: str = "",
) -> dict[str, Any]:
    """Download the newest version of `key` into `out`, all of it or nothing, and return its manifest.

    collection  the one that lists the asset; "": the first that the gateway names
    trusted     files of public keys; none: those of the STORAGE_* variables
    share       a share link, which names the gateway; one of an asset also names the key, which may then be ""
    Raises BadInput when the asset is missing, cannot be downloaded, or is not what was signed; `out` is then unchanged.
    """
    gateway, token = split_link(share) if share else (gateway, "")
    if key or not token:
        check_key(key)
    if collection:
        check_collection(collection)
    verification_keys, cache = load_verification_keys(trusted), cache or default_cache()
    try:
        with client_of(gateway, follow_redirects=True) as client:
            source = _CollectionSource(client, gateway, collection, verification_keys)
            if token:
                found = _find_shared(source, open_link(client, token), key)
            else:
                source = replace(source, collection=collection or _first_collection(client, key))
                found = retry_if_shard_missing(lambda: _find(source, key))
            manifest, asset_files = _manifest(found)
            origins = [fetch(found.objects, asset_file, cache) for asset_file in asset_files]
    except (httpx.RequestError, httpx.InvalidURL) as error:
        raise BadInput(f"{gateway} cannot be reached: {error}") from error
    except CatalogueFault as fault:
        raise BadInput(f"{fault}; {out} was not changed") from fault
    _install(out, {asset_file.file: cache / asset_file.sha256 for asset_file in asset_files}, manifest)
    _print_result(source, found, asset_files, origins)
    document: dict[str, Any] = json.loads(manifest)
    return document


def default_cache() -> Path:
    """Return the cache folder: $XDG_CACHE_HOME/capture2vr, or ~/.cache/capture2vr. Raises OSError."""
    return user_folder("XDG_CACHE_HOME", ".cache")


def _first_collection(client: httpx.Client, key: str) -> str:
    """Ask the gateway for the collections of an asset, and return the first. Raises BadInput."""
    names = parse_answer(client.get(f"/v1/assets/{key}")).get("collections") or [DEFAULT_COLLECTION]
    name = str(names[0])
    check_collection(name)
    return name


def _find(source: _CollectionSource, key: str) -> _FoundAsset:
    """Find the asset's row in the collection's newest index. Raises CatalogueFault, also for an index older than one
    seen before.
    """
    answer = source.client.get(f"/v1/collections/{source.collection}", params=source.query)
    objects = RemoteObjects(source.client, str(parse_answer(answer)["base"]))
    last_seen = SeenVersion(source.gateway, "@".join(filter(None, (source.collection, source.tenant))))
    try:
        at_least = last_seen.version if source.verification_keys else 0
        index = read_index(answer.content, source.collection, source.verification_keys, at_least=at_least)
    except CatalogueFault as fault:
        raise _add_hint(fault, last_seen) from None
    if source.verification_keys:  # an unverified version must not be remembered: it may be any number
        last_seen.remember(index.version)
    found = find_row(index, key, lambda shard: _rows(objects, shard))
    if found is None:
        raise BadInput(f"there is no asset {key} in collection {source.collection}; `capture2vr ls` lists its assets")
    if found[1].removed:
        raise BadInput(f"asset {key} was removed; `capture2vr restore {key}` brings it back")
    return _FoundAsset(objects, found[1], f"collection {index.collection} version {index.version}")


def _find_shared(source: _CollectionSource, shared: SharedThing, key: str) -> _FoundAsset:
    """Find what a share link opened: its asset, or the one with this key in its collection. Raises BadInput."""
    source = replace(source, tenant=shared.tenant)
    if shared.kind == "collection":
        check_collection(shared.name)
        source = replace(source, collection=shared.name)
        if not key:
            raise BadInput(f"the link shares the collection {shared.name}: name one of its assets")
        return retry_if_shard_missing(lambda: _find(source, key))
    if shared.kind == "scene":
        if not valid_key(key):
            raise BadInput("the link shares a scene: name one of its assets")
        return _find_entry(source, key)
    if key not in ("", shared.name) or not valid_key(shared.name):
        raise BadInput(f"the link shares the asset {shared.name}, not {key}")
    return _find_entry(source, shared.name)


def _find_entry(source: _CollectionSource, key: str) -> _FoundAsset:
    """Find an asset by its entry alone, whose version is signed by itself. Raises CatalogueFault."""
    entry = parse_answer(source.client.get(f"/v1/assets/{key}", params=source.query))
    last_seen = SeenVersion(source.gateway, f"asset {key}@{source.tenant}")
    at_least = last_seen.version if source.verification_keys else 0
    version = check_proof(key, entry, source.verification_keys, at_least=at_least)
    if source.verification_keys:
        last_seen.remember(version)
    manifest = entry["manifest"]
    row = Row(key, str(entry.get("label") or ""), (), version, str(entry["state"]), 0, str(manifest["sha256"]), "")
    base = str(manifest["url"]).removesuffix(row.manifest_name)
    return _FoundAsset(RemoteObjects(source.client, base), row, f"asset {key} version {version}")


def _rows(objects: RemoteObjects, shard: Shard) -> tuple[Row, ...]:
    limit = min(shard.bytes, DOCUMENT_BYTES)
    return read_shard(objects.read(shard.name, limit, absent=SHARD_MISSING, changed=SHARD_CHANGED), shard)


def _manifest(found: _FoundAsset) -> tuple[bytes, list[AssetFile]]:
    """Download the asset's manifest, and return it and the files that it lists. Raises CatalogueFault."""
    name = found.row.manifest_name
    data = found.objects.read(name, DOCUMENT_BYTES, absent=MANIFEST_MISSING, changed=MANIFEST_CHANGED)
    return data, parse_manifest(data, found.row.manifest_name)


def _install(out: Path, files: dict[str, Path], manifest: bytes) -> None:
    """Copy all files to a staging folder first, so that a full disk changes nothing; then move them into `out`.

    Deletes files of an earlier pull that are not part of this one, unless the user has changed them. Raises BadInput
    where a file or folder of somebody else has the name of one.
    """
    out.mkdir(parents=True, exist_ok=True)
    if blocked := next((out / name for name in (*files, MANIFEST) if (out / name).is_dir()), None):
        raise BadInput(f"{blocked} is a folder, but a file must be written there; choose another folder with -o")
    ours = names_of_both(out)
    for name in (*files, MANIFEST):
        if name not in ours and (out / name).exists() and not _is_same(out / name, files.get(name)):
            raise BadInput(f"{out / name} is of no earlier pull, and would be replaced; choose another folder with -o")
    outdated = [path for path in files_of_pull(out) if path.name not in files]
    staging = out / ".pulling"
    shutil.rmtree(staging, ignore_errors=True)  # left by a command that was killed
    staging.mkdir()
    try:
        for name, cached in files.items():
            shutil.copyfile(cached, staging / name)
        (staging / MANIFEST).write_bytes(manifest)
        for name in (*files, MANIFEST):
            (staging / name).replace(out / name)
        for path in outdated:
            path.unlink()
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _is_same(path: Path, cached: Path | None) -> bool:
    """Whether a file has the content of one in the cache already, as after a pull that was killed at its end."""
    return cached is not None and sha256_of(path) == cached.name


def _add_hint(fault: CatalogueFault, last_seen: SeenVersion) -> CatalogueFault:
    """Add a hint to the fault of an index older than one seen before: what to do if that was intended."""
    if fault.code != CATALOGUE_OLDER:
        return fault
    hint = (
        f"{fault.hint}; if it was restored on purpose: run `capture2vr catalogue rebuild` on the server, or delete "
        f"{last_seen.path} here"
    )
    return CatalogueFault(fault.code, fault.name, f"the catalogue is older: {fault.message}", hint=hint)


def _print_result(
    source: _CollectionSource, found: _FoundAsset, asset_files: Sequence[AssetFile], origins: Sequence[str]
) -> None:
    row = found.row
    table = Table(title=f"{row.key} version {row.version} ({row.state})")
    for column in ("file", "bytes", "sha256", "from"):
        table.add_column(column, justify="right" if column == "bytes" else "left", overflow="fold")
    for asset_file, origin in zip(asset_files, origins, strict=True):
        table.add_row(asset_file.file, f"{asset_file.size:,}", asset_file.sha256, origin)
    console.print(table)
    if source.verification_keys:
        console.print(f"{found.signed}: signature, version, sizes and hashes are correct")
    else:
        warn(
            f"{found.signed}: sizes and hashes are correct; signature and "
            "version were not checked: give a public key with --trusted or STORAGE_TRUSTED_KEYS"
        )
