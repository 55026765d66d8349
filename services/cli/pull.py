"""`capture2vr pull`: fetch an asset by key as a VR client would, every hash checked, cached by content."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import httpx
from rich.table import Table

from services.cli.errors import NO_KEY, BadInput, answer_of
from services.cli.http import client_of
from services.cli.progress import console
from services.storage.catalogue import valid_key

_CHUNK_BYTES = 1 << 20


def pull_asset(key: str, out: Path, gateway: str, *, cache: Path | None) -> dict[str, Any]:
    """Download the newest version of `key` into `out`; the answer is its catalogue entry.

    Raises BadInput when the asset is absent, unreachable or tampered with.
    """
    if not valid_key(key):
        raise BadInput(NO_KEY.format(key))
    cache = cache or default_cache()
    try:
        with client_of(gateway, follow_redirects=True) as client:
            entry: dict[str, Any] = answer_of(client.get(f"/v1/assets/{key}"))
            out.mkdir(parents=True, exist_ok=True)
            rows = [(item, _fetch(client, item, out, cache)) for item in entry["files"]]
    except (httpx.TransportError, httpx.InvalidURL) as error:
        raise BadInput(f"{gateway} cannot be reached: {error}") from error
    console.print(_table(key, entry, rows))
    return entry


def default_cache() -> Path:
    """$XDG_CACHE_HOME/capture2vr, or ~/.cache/capture2vr."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "capture2vr"


def _fetch(client: httpx.Client, item: dict[str, Any], out: Path, cache: Path) -> str:
    """Put one file into `out`, through the cache; a cached file whose bytes have rotted is fetched again."""
    cached = cache / item["sha256"]
    source = "cache"
    if not cached.is_file() or _sha256(cached) != item["sha256"]:
        _download(client, item, cached)
        source = "network"
    shutil.copyfile(cached, out / Path(item["file"]).name)
    return source


def _download(client: httpx.Client, item: dict[str, Any], cached: Path) -> None:
    cached.parent.mkdir(parents=True, exist_ok=True)
    digest = hashlib.sha256()
    with tempfile.NamedTemporaryFile(dir=cached.parent, delete=False) as part:
        path = Path(part.name)
        try:
            with client.stream("GET", item["url"]) as response:
                if not response.is_success:
                    raise BadInput(f"{item['file']}: {response.request.url} answered {response.status_code}")
                for chunk in response.iter_bytes(_CHUNK_BYTES):
                    digest.update(chunk)
                    part.write(chunk)
            if digest.hexdigest() != item["sha256"]:
                raise BadInput(
                    f"{item['file']}: what was received does not have the hash of the catalogue; nothing kept"
                )
            part.flush()
            path.replace(cached)
        except BaseException:
            path.unlink(missing_ok=True)
            raise


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _table(key: str, entry: dict[str, Any], rows: list[tuple[dict[str, Any], str]]) -> Table:
    table = Table(title=f"{key} version {entry['version']} ({entry['state']})")
    for column in ("file", "bytes", "sha256", "from"):
        table.add_column(column, justify="right" if column == "bytes" else "left", overflow="fold")
    for item, source in rows:
        table.add_row(item["file"], f"{item['bytes']:,}", item["sha256"], source)
    return table
