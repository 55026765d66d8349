"""Objects below a URL, and the cache of those that are named by their hash: whole and right, or not at all."""

from __future__ import annotations

import hashlib
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import httpx

from services.cli.errors import BadInput
from services.storage.faults import FILE_CHANGED, FILE_MISSING, CatalogueFault
from services.storage.reading import Piece

_CHUNK_BYTES = 1 << 20
_PART = ".part-"
_ABANDONED_S = 3600.0  # without a byte; httpx gives a silent server up after half a minute


@dataclass(frozen=True, slots=True)
class Objects:
    """What `base`, with a slash at its end, and an object's name make an address."""

    client: httpx.Client
    base: str

    def whole(self, name: str, limit: int, *, absent: str, changed: str) -> bytes:
        """An object of at most `limit` bytes. Raises as `blocks`."""
        return b"".join(self.blocks(name, limit, absent=absent, changed=changed))

    def blocks(self, name: str, limit: int, *, absent: str, changed: str) -> Iterator[bytes]:
        """The bytes of an object.

        absent, changed  codes of the CatalogueFault for one that is not there, and for one that is longer or breaks off
        Raises BadInput for a server at fault, httpx.RequestError for one that is out of reach.
        """
        size = 0
        with self.client.stream("GET", self.base + name) as response:
            address, status = response.request.url, response.status_code
            if status in (403, 404):  # a bucket that may not be listed says 403 of what is not there
                raise CatalogueFault(absent, name, f"it is not there: {address} answered {status}")
            if not response.is_success:
                raise BadInput(f"{address} answered {status}")
            try:
                for block in response.iter_bytes(_CHUNK_BYTES):
                    size += len(block)
                    if size > limit:  # whoever sends it may never end
                        raise CatalogueFault(changed, name, f"it has more than {limit:,} bytes")
                    yield block
            except (httpx.RemoteProtocolError, httpx.DecodingError) as error:
                raise CatalogueFault(changed, name, f"it broke off after {size:,} bytes: {error}") from None


def fetch(objects: Objects, piece: Piece, cache: Path) -> str:
    """See that a file is in the cache, under its hash; "cache" or "network" says where it came from.

    One whose bytes have rotted is fetched again. Raises CatalogueFault FILE_*, and as `Objects.blocks`.
    """
    cached = cache / piece.sha256
    if cached.is_file() and sha256_of(cached) == piece.sha256:
        return "cache"
    cache.mkdir(parents=True, exist_ok=True)
    _sweep(cache)
    descriptor, part = tempfile.mkstemp(dir=cache, prefix=_PART)
    try:
        with os.fdopen(descriptor, "wb") as file:
            digest, size = hashlib.sha256(), 0
            for block in objects.blocks(piece.name, piece.size, absent=FILE_MISSING, changed=FILE_CHANGED):
                digest.update(block)
                size += len(block)
                file.write(block)
        if size < piece.size:
            raise CatalogueFault(FILE_CHANGED, piece.name, f"it ends after {size:,} of its {piece.size:,} bytes")
        if digest.hexdigest() != piece.sha256:
            raise CatalogueFault(FILE_CHANGED, piece.name, f"its {size:,} bytes do not have the hash of the manifest")
        Path(part).replace(cached)
    except BaseException:
        Path(part).unlink(missing_ok=True)
        raise
    return "network"


def sha256_of(path: Path) -> str:
    """The hash of a file, hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _sweep(cache: Path) -> None:
    """Remove what commands that were killed have left half-written."""
    for part in cache.glob(f"{_PART}*"):
        with suppress(OSError):  # its own command has just renamed or removed it
            if time.time() - part.stat().st_mtime > _ABANDONED_S:
                part.unlink()
