"""Download objects below a URL, and cache files by their hash; only complete, verified files get into the cache."""

from __future__ import annotations

import hashlib
import time
import uuid
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import httpx

from capture2vr.errors import GatewayError
from capture2vr.process.atomic_write import atomic_write
from capture2vr.storage.bundle import sha256_of
from capture2vr.storage.catalogue.collection import Shard, read_shard
from capture2vr.storage.catalogue.faults import FILE_CHANGED, FILE_MISSING, SHARD_CHANGED, SHARD_MISSING, CatalogueFault
from capture2vr.storage.catalogue.reader import DOCUMENT_BYTES, AssetFile, TreeParts
from capture2vr.storage.catalogue.tree import read_node

_CHUNK_BYTES = 1 << 20
_PART = ".part-"  # prefix of temporary files in the cache
_ABANDONED_S = 3600.0  # since the last byte; a download in progress never pauses so long: httpx times out after 30 s


@dataclass(frozen=True, slots=True)
class RemoteObjects:
    """Downloads objects from `base` + name. base: a URL that ends with a slash"""

    client: httpx.Client
    base: str

    def read(self, name: str, limit: int, *, absent: str, changed: str) -> bytes:
        """Download an object of at most `limit` bytes into memory. Raises as `blocks` does."""
        return b"".join(self.blocks(name, limit, absent=absent, changed=changed))

    def blocks(self, name: str, limit: int, *, absent: str, changed: str) -> Iterator[bytes]:
        """Download an object and yield its bytes in blocks.

        absent, changed  codes of the CatalogueFault for a missing object, and for one that is too long or incomplete
        Raises GatewayError for other HTTP errors, httpx.RequestError where the server cannot be reached.
        """
        size = 0
        with self.client.stream("GET", self.base + name) as response:
            address, status = response.request.url, response.status_code
            if status in (403, 404):  # S3 answers 403 for a missing object if listing is not allowed
                raise CatalogueFault(absent, name, f"it is missing: {address} answered {status}")
            if not response.is_success:
                raise GatewayError(f"{address} answered {status}", status=status)
            try:
                for block in response.iter_bytes(_CHUNK_BYTES):
                    size += len(block)
                    if size > limit:  # a hostile server may send for ever
                        raise CatalogueFault(changed, name, f"it has more than {limit:,} bytes")
                    yield block
            except (httpx.RemoteProtocolError, httpx.DecodingError) as error:
                raise CatalogueFault(changed, name, f"the download broke off after {size:,} bytes: {error}") from None


def remote_parts(objects: RemoteObjects, collection: str) -> TreeParts:
    """Return how the parts of a collection are downloaded, each no longer than what lists it says."""

    def read(part: Shard) -> bytes:
        return objects.read(part.name, min(part.bytes, DOCUMENT_BYTES), absent=SHARD_MISSING, changed=SHARD_CHANGED)

    return TreeParts(
        rows=lambda shard: read_shard(read(shard), shard),
        nodes=lambda depth, node: read_node(read(node), node, collection, depth),
    )


def fetch(objects: RemoteObjects, asset_file: AssetFile, cache: Path) -> str:
    """Download a file into the cache, under its hash, unless it is there already; returns "cache" or "network".

    A cached file with a wrong hash is downloaded again. Raises CatalogueFault FILE_*, and as `RemoteObjects.blocks`.
    """
    cached = cache / asset_file.sha256
    if cached.is_file() and sha256_of(cached) == asset_file.sha256:
        return "cache"
    cache.mkdir(parents=True, exist_ok=True)
    _remove_abandoned(cache)
    with atomic_write(cached, temporary=cache / f"{_PART}{uuid.uuid4().hex}", durable=False) as part:
        digest, size = hashlib.sha256(), 0
        with part.open("wb") as file:
            for block in objects.blocks(asset_file.name, asset_file.size, absent=FILE_MISSING, changed=FILE_CHANGED):
                digest.update(block)
                size += len(block)
                file.write(block)
        if size < asset_file.size:
            raise CatalogueFault(
                FILE_CHANGED, asset_file.name, f"it ends after {size:,} of its {asset_file.size:,} bytes"
            )
        if digest.hexdigest() != asset_file.sha256:
            raise CatalogueFault(
                FILE_CHANGED, asset_file.name, f"its {size:,} bytes do not have the hash that the manifest lists"
            )
    return "network"


def _remove_abandoned(cache: Path) -> None:
    """Delete temporary files of commands that were killed."""
    for part in cache.glob(f"{_PART}*"):
        with suppress(OSError):  # the command that writes it has just renamed or deleted it
            if time.time() - part.stat().st_mtime > _ABANDONED_S:
                part.unlink()
