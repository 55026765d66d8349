"""Reading QR codes off a screenshot, as a phone's camera does."""

from __future__ import annotations

import cv2
import numpy as np
from playwright.sync_api import Locator


def picture_of(image: Locator) -> bytes:
    """The screenshot of an image, as PNG, once the page has it: an image is visible before it has come."""
    image.evaluate("each => each.decode()")
    return image.screenshot()


def text_of(png: bytes) -> str:
    """The text of the code on a picture. Raises AssertionError where there is none."""
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    margin = cv2.copyMakeBorder(picture, 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=(255, 255, 255))
    # Cells that are no whole pixels wide are read at one size and not at another; a phone comes nearer.
    for scale in (1, 2, 3):
        enlarged = cv2.resize(margin, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        text, _, _ = cv2.QRCodeDetectorAruco().detectAndDecode(enlarged)  # the other one misses 2 codes in 100
        if text:
            return text
    raise AssertionError("there is no QR code to be read")
