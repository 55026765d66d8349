"""`capture2vr download`: an asset from a gateway in the format of another program; it is made there if need be."""

from __future__ import annotations

import hashlib
import time
from pathlib import Path, PurePosixPath

import httpx

from capture2vr.cli.errors import BadInput, parse_answer
from capture2vr.cli.key_names import check_key
from capture2vr.cli.progress import console
from capture2vr.cli.remote.http import client_of
from capture2vr.cli.remote.share_link import open_link, split_link
from capture2vr.order.download_formats import FORMATS
from capture2vr.process.atomic_write import atomic_write
from capture2vr.storage.bundle import hash_in_name

_TIMEOUT = httpx.Timeout(60.0)  # the gateway itself answers after 20 s
_WITHIN_S = 900.0  # a worker's own limit for a file is five minutes, and others may be before it
_CHUNK_BYTES = 1 << 20


def download_format(
    key: str, format_name: str, out: Path | None, gateway: str, *, version: int | None = None, share: str = ""
) -> Path:
    """Download an asset in a format; return the file.

    out      file or existing folder to write to; None: the key and the format's ending, in the current folder
    version  number of an earlier version, for its own tenant; the file's name then tells it. None: the current one
    share    a share link, which names the gateway; one of an asset also names the key, which may then be ""
    Raises BadInput where the asset cannot have the format, or the file is not whole; `out` is then unchanged.
    """
    gateway, token = split_link(share) if share else (gateway, "")
    if key or not token:
        check_key(key)
    try:
        with client_of(gateway, timeout=_TIMEOUT, follow_redirects=True) as client:
            query = {"format": format_name} | ({"version": str(version)} if version else {})
            if token:
                shared = open_link(client, token)
                query["tenant"] = shared.tenant
                key = key or (shared.name if shared.kind == "asset" else "")
            if not key:
                raise BadInput("the link shares a collection: name one of its assets")
            url = str(httpx.URL(f"/v1/assets/{key}/download", params=query))
            _wait_until_made(client, url, key, format_name)
            path = _path(out, key, format_name, version)
            _save(client, url, path)
    except (httpx.RequestError, httpx.InvalidURL) as error:
        raise BadInput(f"{gateway} cannot be reached: {error}") from error
    console.print(f"{path}: {path.stat().st_size:,} bytes", markup=False)
    return path


def _wait_until_made(client: httpx.Client, url: str, key: str, format_name: str) -> None:
    """Ask until the file has been made. Raises BadInput."""
    deadline = time.monotonic() + _WITHIN_S
    while (answer := client.get(url, follow_redirects=False)).status_code == 202:
        if time.monotonic() > deadline:
            raise BadInput(f"{key} was not made as {format_name} within {_WITHIN_S:.0f} s; try again later")
        time.sleep(float(answer.headers.get("Retry-After", 2)))
    if not answer.has_redirect_location:
        parse_answer(answer)
        raise BadInput(f"{answer.request.url} did not say where the file is: check --gateway")


def _path(out: Path | None, key: str, format_name: str, version: int | None) -> Path:
    """Return the file to write to. Raises BadInput where its folder is missing."""
    name = FORMATS[format_name].file_name(key, version) if format_name in FORMATS else f"{key}.{format_name}"
    path = Path(name) if out is None else out / name if out.is_dir() else out
    if not path.parent.is_dir():
        raise BadInput(f"{path.parent} is not a folder; create it, or choose another file with -o")
    return path


def _save(client: httpx.Client, url: str, path: Path) -> None:
    """Download the file whole, with the hash that its name has, or leave `path` as it is. Raises BadInput."""
    digest = hashlib.sha256()
    with client.stream("GET", url) as response, atomic_write(path) as part:
        if not response.is_success:
            raise BadInput(f"{response.request.url} answered {response.status_code}")
        with part.open("wb") as file:
            for block in response.iter_bytes(_CHUNK_BYTES):
                digest.update(block)
                file.write(block)
        if digest.hexdigest() != hash_in_name(PurePosixPath(response.url.path).name):
            raise BadInput(f"{path.name} did not arrive as it was made; try again")
