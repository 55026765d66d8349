"""From the last byte of a phone's photos to the preview and the refined asset on the store, through gateway and worker.

The rendered photos are the walk-around of `photos.py`; enlarged to 12 megapixels they weigh what a phone's do. One case
goes a person's way: files chosen on the capture page in Chromium, the preview on that page, the asset in the viewer.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import httpx
from PIL import Image
from pillow_heif import register_heif_opener
from playwright.sync_api import Page, sync_playwright

from capture2vr.cli.progress import StageBar
from capture2vr.cli.remote.push import follow, upload
from capture2vr.cli.up import run_stack
from tests.bench.data_files import data_file
from tests.support.chromium import launch
from tests.support.photos.walkaround import render_walkaround
from tests.support.screenshots import drawn, stage
from tests.web.conftest import PHONE

_SIZE, _PHONE = (1280, 960), (4000, 3000)
_VIEWS = 25
_BY_PAGE = "on the capture page"
_PATIENCE_MS = 600_000  # of a whole job
_LEAST_DRAWN = 0.02  # of the viewer's canvas; less is not the thing


def _fruit(folder: Path) -> Path:
    return data_file("photos_fruit/images")


def _rendered(folder: Path) -> Path:
    render_walkaround(folder, views=_VIEWS, size=_SIZE)
    return folder


def _enlarged(folder: Path, suffix: str = ".jpg", quality: int = 92) -> Path:
    register_heif_opener()
    for photo in render_walkaround(folder, views=_VIEWS, size=_SIZE).photos:
        with Image.open(photo) as picture:
            exif = picture.getexif().tobytes()
            large = picture.resize(_PHONE, Image.Resampling.BICUBIC)
        photo.unlink()
        large.save(photo.with_suffix(suffix), quality=quality, exif=exif)
    return folder


CASES: dict[str, Callable[[Path], Path]] = {
    "fruit, 20 photos of 600 x 400": _fruit,
    f"fruit, 20 photos, {_BY_PAGE}": _fruit,
    f"rendered shell, {_VIEWS} of {_SIZE[0]} x {_SIZE[1]}": _rendered,
    f"rendered shell, {_VIEWS} of {_PHONE[0]} x {_PHONE[1]}": _enlarged,
    f"rendered shell, {_VIEWS} of {_PHONE[0]} x {_PHONE[1]}, HEIC": partial(_enlarged, suffix=".heic", quality=70),
}


def main(arguments: list[str]) -> None:
    """Print the table; a word among the arguments chooses the cases that have it, a folder gets the page's pictures."""
    folders = [Path(each) for each in arguments if Path(each).is_dir()]
    words = [word for word in arguments if not Path(word).is_dir()]
    print("| capture | MB | upload s | preview after s | end after s | state |\n|---|---|---|---|---|---|")
    for case in [case for case in CASES if all(word in case for word in words)]:
        with tempfile.TemporaryDirectory() as scratch:
            photos = Path(scratch) / "photos"
            photos.mkdir()
            source = CASES[case](photos)
            size = sum(each.stat().st_size for each in source.iterdir()) / 1e6
            with run_stack("127.0.0.1", 0, Path(scratch) / "data") as stack:
                kept = (folders or [photos])[0]
                told = _by_page(stack.url, source, kept) if _BY_PAGE in case else _by_http(stack.url, source)
                print(f"| {case} | {size:.1f} | {' | '.join(told)} |", flush=True)


def _by_http(url: str, source: Path) -> Iterator[str]:
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


def _by_page(url: str, source: Path, kept: Path) -> Iterator[str]:
    """The same as a person sees it, with pictures of the page and of the viewer into the folder `kept`."""
    with sync_playwright() as playwright:
        chromium = launch(playwright)
        page = chromium.new_page(viewport=PHONE, has_touch=True)
        page.set_default_timeout(_PATIENCE_MS)
        page.goto(url)
        page.locator("#files").set_input_files(sorted(source.iterdir()))
        page.locator("#name").fill("bench")
        began = time.perf_counter()
        page.get_by_role("button", name="Send").click()
        page.locator("body[data-state=working]").wait_for()
        uploaded = time.perf_counter()
        yield f"{uploaded - began:.1f}"
        page.locator("body[data-preview]").wait_for()
        yield f"{time.perf_counter() - uploaded:.1f}"
        page.screenshot(path=kept / "preview.png", full_page=True)
        page.locator("body[data-state=done]").wait_for()
        yield f"{time.perf_counter() - uploaded:.1f}"
        page.screenshot(path=kept / "done.png", full_page=True)
        yield f"{page.locator('#used summary').inner_text()}; {_in_the_viewer(page, kept)}"
        chromium.close()


def _in_the_viewer(page: Page, kept: Path) -> str:
    page.get_by_role("link", name="View", exact=True).click()
    page.locator("body[data-loaded]").wait_for()
    page.wait_for_timeout(3000)  # finer levels come
    picture = stage(page)
    (kept / "viewer.png").write_bytes(picture)
    shown = drawn(picture)
    return f"in the viewer, {shown:.0%} of its picture" if shown > _LEAST_DRAWN else "NOT in the viewer"
