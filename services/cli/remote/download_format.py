"""`capture2vr download`: an asset from a gateway in the format of another program; it is made there if need be."""

from __future__ import annotations

from pathlib import Path

from capture2vr.cli.progress import console
from capture2vr.client.download import FORMAT_TIMEOUT, download
from capture2vr.client.http import open_gateway
from capture2vr.client.share_link import split_link


def download_format(
    key: str, format_name: str, out: Path | None, gateway: str, *, version: int | None = None, share: str = ""
) -> Path:
    """Download an asset in a format; return the file.

    share  a share link, which names the gateway; one of an asset also names the key, which may then be ""
    Other arguments and errors as of `download`.
    """
    gateway, token = split_link(share) if share else (gateway, "")
    with open_gateway(gateway, timeout=FORMAT_TIMEOUT, follow_redirects=True) as client:
        path = download(client, key, format_name, out, version=version, token=token)
    console.print(f"{path}: {path.stat().st_size:,} bytes", markup=False)
    return path
