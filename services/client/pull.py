"""Download an asset as a VR client does, checking all hashes from the signed collection down."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import httpx

from capture2vr.client.answers import parse_answer, understood
from capture2vr.client.earlier_results import MANIFEST, files_of_pull, names_of_both
from capture2vr.client.names import check_collection, check_key
from capture2vr.client.objects import RemoteObjects, fetch, remote_parts
from capture2vr.client.seen_version import SeenVersion, user_folder
from capture2vr.client.share_link import SharedThing, open_link
from capture2vr.client.trusted_keys import load_verification_keys
from capture2vr.errors import BadInput, VerificationError
from capture2vr.storage.bundle import sha256_of
from capture2vr.storage.catalogue.collection import Row
from capture2vr.storage.catalogue.entry import DEFAULT_COLLECTION, valid_key
from capture2vr.storage.catalogue.faults import (
    CATALOGUE_OLDER,
    MANIFEST_CHANGED,
    MANIFEST_MISSING,
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
from capture2vr.storage.catalogue.root import read_index
from capture2vr.storage.catalogue.signing import PublicKey


@dataclass(frozen=True, slots=True)
class PulledFile:
    """A file that was downloaded.

    file    its name in the folder
    bytes   its size
    sha256  of its content, checked
    origin  "network", or "cache" where an earlier pull has downloaded it
    """

    file: str
    bytes: int
    sha256: str
    origin: str

    @classmethod
    def of(cls, asset_file: AssetFile, origin: str) -> PulledFile:
        """Convert a file of a manifest."""
        return cls(asset_file.file, asset_file.size, asset_file.sha256, origin)


@dataclass(frozen=True, slots=True)
class PulledAsset:
    """An asset that was downloaded into a folder; all hashes are correct.

    key, version, state  which asset and version; state: "preview" or "refined"
    folder               where its files are
    files                all of them, but for manifest.json
    manifest             content of manifest.json: levels of detail, quality, size, warnings
    signed               what lists it: the collection or the asset, and which version
    is_verified          whether a public key was given, and the signature and the version are correct
    """

    key: str
    version: int
    state: str
    folder: Path
    files: tuple[PulledFile, ...]
    manifest: Mapping[str, Any]
    signed: str
    is_verified: bool


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


def pull(
    client: httpx.Client,
    gateway: str,
    key: str,
    out: Path,
    *,
    collection: str = "",
    trusted: Sequence[Path] = (),
    cache: Path | None = None,
    token: str = "",
) -> PulledAsset:
    """Download the newest version of `key` into `out`, all of it or nothing.

    client      of the gateway; follows redirects
    collection  the one that lists the asset; "": the first that the gateway names
    trusted     files of public keys; none: those of the STORAGE_* variables
    token       of a share link; one of an asset also names the key, which may then be ""
    Raises BadInput, GatewayError when the asset is missing or cannot be downloaded, VerificationError when it is not
    what was signed; `out` is then unchanged.
    """
    if key or not token:
        check_key(key)
    if collection:
        check_collection(collection)
    source = _CollectionSource(client, gateway, collection, load_verification_keys(trusted))
    cache = cache or default_cache()
    try:
        if token:
            found = _find_shared(source, open_link(client, token), key)
        else:
            source = replace(source, collection=collection or _first_collection(client, key))
            found = retry_if_shard_missing(lambda: _find(source, key))
        manifest, asset_files = _manifest(found)
        origins = [fetch(found.objects, asset_file, cache) for asset_file in asset_files]
    except CatalogueFault as fault:
        raise VerificationError(f"{fault}; {out} was not changed", code=fault.code) from fault
    _install(out, {asset_file.file: cache / asset_file.sha256 for asset_file in asset_files}, manifest)
    files = tuple(map(PulledFile.of, asset_files, origins))
    return PulledAsset(
        found.row.key,
        found.row.version,
        found.row.state,
        out,
        files,
        json.loads(manifest),
        signed=found.signed,
        is_verified=bool(source.verification_keys),
    )


def default_cache() -> Path:
    """Return the cache folder: $XDG_CACHE_HOME/capture2vr, or ~/.cache/capture2vr. Raises OSError."""
    return user_folder("XDG_CACHE_HOME", ".cache")


def _first_collection(client: httpx.Client, key: str) -> str:
    """Ask the gateway for the first collection of an asset. Raises BadInput, also for one that is held back."""
    entry = parse_answer(client.get(f"/v1/assets/{key}"))
    if entry.get("held"):
        raise BadInput(f"asset {key} is held back: its grade says to shoot again; `capture2vr keep {key}` publishes it")
    with understood("entry of an asset"):
        name = str((entry.get("collections") or [DEFAULT_COLLECTION])[0])
    check_collection(name)
    return name


def _find(source: _CollectionSource, key: str) -> _FoundAsset:
    """Find the asset's row in the collection's newest root. Raises CatalogueFault, also for a root older than one
    seen before.
    """
    answer = source.client.get(f"/v1/collections/{source.collection}", params={**source.query, "form": "tree"})
    objects = RemoteObjects(source.client, str(parse_answer(answer)["base"]))
    last_seen = SeenVersion(source.gateway, "@".join(filter(None, (source.collection, source.tenant))))
    try:
        at_least = last_seen.version if source.verification_keys else 0
        index = read_index(answer.content, source.collection, source.verification_keys, at_least=at_least)
    except CatalogueFault as fault:
        raise _add_hint(fault, last_seen) from None
    if source.verification_keys:  # an unverified version must not be remembered: it may be any number
        last_seen.remember(index.version)
    found = find_row(index, key, remote_parts(objects, source.collection))
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
    with understood("entry of an asset"):
        manifest = entry["manifest"]
        row = Row(key, str(entry.get("label") or ""), (), version, str(entry["state"]), 0, str(manifest["sha256"]), "")
        base = str(manifest["url"]).removesuffix(row.manifest_name)
    return _FoundAsset(RemoteObjects(source.client, base), row, f"asset {key} version {version}")


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
    _spare_others(out, files)
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


def _spare_others(out: Path, files: Mapping[str, Path]) -> None:
    """Raises BadInput where a file or folder of somebody else has the name of one that is to be written."""
    if blocked := next((out / name for name in (*files, MANIFEST) if (out / name).is_dir()), None):
        raise BadInput(f"{blocked} is a folder, but a file must be written there; choose another folder with -o")
    ours = names_of_both(out)
    for name in (*files, MANIFEST):
        if name not in ours and (out / name).exists() and not _is_same(out / name, files.get(name)):
            raise BadInput(f"{out / name} is of no earlier pull, and would be replaced; choose another folder with -o")


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
