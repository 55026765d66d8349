"""From the last byte of a phone's photos to the preview and the refined asset on the store, through gateway and worker.

The rendered photos are the walk-around of `photos.py`; enlarged to 12 megapixels they weigh what a phone's do.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
from PIL import Image

from services.cli.progress import StageBar
from services.cli.push import follow, upload
from services.cli.up import running
from tests.conftest import data_folder
from tests.edge.walkaround import render_walkaround

_SIZE, _PHONE = (1280, 960), (4000, 3000)
_VIEWS = 25


def _fruit(folder: Path) -> Path:
    return data_folder() / "photos_fruit" / "images"


def _rendered(folder: Path) -> Path:
    render_walkaround(folder, views=_VIEWS, size=_SIZE)
    return folder


def _enlarged(folder: Path) -> Path:
    for photo in render_walkaround(folder, views=_VIEWS, size=_SIZE).photos:
        with Image.open(photo) as picture:
            exif = picture.getexif().tobytes()
            picture.resize(_PHONE, Image.Resampling.BICUBIC).save(photo, quality=92, exif=exif)
    return folder


CASES: dict[str, Callable[[Path], Path]] = {
    "fruit, 20 photos of 600 x 400": _fruit,
    f"rendered shell, {_VIEWS} of {_SIZE[0]} x {_SIZE[1]}": _rendered,
    f"rendered shell, {_VIEWS} of {_PHONE[0]} x {_PHONE[1]}": _enlarged,
}


def main(arguments: list[str]) -> None:
    """Print the table; a word among the arguments chooses the cases that have it."""
    print("| capture | MB | upload s | preview after s | end after s | state |\n|---|---|---|---|---|---|")
    for case in [case for case in CASES if all(word in case for word in arguments)]:
        with tempfile.TemporaryDirectory() as folder:
            photos = Path(folder) / "photos"
            photos.mkdir()
            source = CASES[case](photos)
            size = sum(each.stat().st_size for each in source.iterdir()) / 1e6
            with running("127.0.0.1", 0, Path(folder) / "data") as stack:
                print(f"| {case} | {size:.1f} | {' | '.join(_journey(stack.url, source))} |", flush=True)


def _journey(url: str, source: Path) -> Iterator[str]:
    with httpx.Client(base_url=url, timeout=600, trust_env=False) as client, StageBar() as bar:
        began = time.perf_counter()
        capture = upload(client, source, bar)
        uploaded = time.perf_counter()
        yield f"{uploaded - began:.1f}"
        request = {"capture": capture["capture"], "asset_key": "bench"}
        job = client.post("/v1/jobs", json=request).raise_for_status().json()
        preview = ""
        for state in follow(client, job["id"]):
            if not preview and state.get("asset"):
                preview = f"{time.perf_counter() - uploaded:.1f}"
            job = state
        yield preview
        yield f"{time.perf_counter() - uploaded:.1f}"
        yield job["state"]
