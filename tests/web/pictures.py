"""Looking at a screenshot: how much of it shows something, and where."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image
from playwright.sync_api import Page


def stage(page: Page) -> bytes:
    """The viewer's canvas without the words and buttons that lie over it."""
    return page.locator("#stage").screenshot(style="header, footer { visibility: hidden }")


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
