"""Download an asset from a gateway in the format of another program; it is made there if need be."""

from __future__ import annotations

import hashlib
import time
from pathlib import Path, PurePosixPath

import httpx

from capture2vr.client.answers import parse_answer
from capture2vr.client.names import check_key
from capture2vr.client.share_link import open_link
from capture2vr.errors import BadInput, GatewayError
from capture2vr.order.download_formats import FORMATS
from capture2vr.process.atomic_write import atomic_write
from capture2vr.storage.bundle import hash_in_name

FORMAT_TIMEOUT = httpx.Timeout(60.0)
"""The gateway itself answers after 20 s."""
_WITHIN_S = 900.0  # a worker's own limit for a file is five minutes, and others may be before it
_CHUNK_BYTES = 1 << 20


def download(
    client: httpx.Client, key: str, format_name: str, out: Path | None, *, version: int | None = None, token: str = ""
) -> Path:
    """Download an asset in a format; return the file.

    client   of the gateway; follows redirects
    out      file or existing folder to write to; None: the key and the format's ending, in the current folder
    version  number of an earlier version, for its own tenant; the file's name then tells it. None: the current one
    token    of a share link; one of an asset also names the key, which may then be ""
    Raises BadInput, GatewayError where the asset cannot have the format, or the file is not whole; `out` is then
    unchanged.
    """
    if key or not token:
        check_key(key)
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
    return path


def _wait_until_made(client: httpx.Client, url: str, key: str, format_name: str) -> None:
    """Ask until the file has been made. Raises BadInput."""
    deadline = time.monotonic() + _WITHIN_S
    while (answer := client.get(url, follow_redirects=False)).status_code == 202:
        if time.monotonic() > deadline:
            raise GatewayError(
                f"{key} was not made as {format_name} within {_WITHIN_S:.0f} s; try again later", retryable=True
            )
        time.sleep(float(answer.headers.get("Retry-After", 2)))
    if not answer.has_redirect_location:
        parse_answer(answer)
        raise GatewayError(f"{answer.request.url} did not say where the file is: check the gateway's URL")


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
            raise GatewayError(f"{response.request.url} answered {response.status_code}", status=response.status_code)
        with part.open("wb") as file:
            for block in response.iter_bytes(_CHUNK_BYTES):
                digest.update(block)
                file.write(block)
        if digest.hexdigest() != hash_in_name(PurePosixPath(response.url.path).name):
            raise GatewayError(f"{path.name} did not arrive as it was made; try again", retryable=True)
