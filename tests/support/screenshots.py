"""Looking at a screenshot: how much of it shows something, and where."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image
from playwright.sync_api import Page

_STAGE_ALONE = """
header, footer, #poster { visibility: hidden }
main { background: none !important }
#stage { opacity: 1 !important }
"""


def stage(page: Page) -> bytes:
    """The viewer's canvas alone: without the words and buttons over it, the poster, and the backdrop behind it."""
    return page.locator("#stage").screenshot(style=_STAGE_ALONE)


def await_frames(page: Page) -> None:
    """Until the page has drawn what it was told before: some frames, however long they take."""
    page.evaluate(
        """async () => {
            for (let frame = 0; frame < 3; frame++) await new Promise((done) => requestAnimationFrame(done));
        }"""
    )


def drawn(png: bytes) -> float:
    """Share of the picture that differs from its upper left corner."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
    return float((np.abs(pixels - pixels[0, 0]).max(axis=2) > 12).mean())


def difference(first: bytes, second: bytes) -> float:
    """Share of pixels that changed between two pictures of one size."""
    one, two = (np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int) for png in (first, second))
    return float((np.abs(one - two).max(axis=2) > 12).mean())


def expect_picture(page: Page, selector: str) -> None:
    """The <img> has loaded and is a picture. (The page's security policy forbids to wait by a string of code.)"""
    decoded = page.locator(selector).evaluate("image => image.decode().then(() => image.naturalWidth)")
    assert decoded > 0


def halves(png: bytes) -> tuple[bytes, bytes]:
    """What the left eye sees and what the right one."""
    whole = Image.open(io.BytesIO(png))
    middle = whole.width // 2
    return _png(whole.crop((0, 0, middle, whole.height))), _png(whole.crop((middle, 0, whole.width, whole.height)))


def places_of(png: bytes, channel: int) -> tuple[float, float, float]:
    """Share of the picture where a colour channel (0 red, 1 green, 2 blue) outshines the others, and its span across.

    (share, from, to): from and to as shares of the width, in which 99 % of those pixels lie; nan without any.
    """
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
    others = np.delete(pixels, channel, axis=2).max(axis=2)
    clear = (pixels[..., channel] > 60) & (pixels[..., channel] > 1.5 * others)
    across = np.nonzero(clear)[1] / pixels.shape[1]
    first, last = np.quantile(across, (0.005, 0.995)) if len(across) else (np.nan, np.nan)
    return float(clear.mean()), float(first), float(last)


def _png(picture: Image.Image) -> bytes:
    buffer = io.BytesIO()
    picture.save(buffer, "PNG")
    return buffer.getvalue()
