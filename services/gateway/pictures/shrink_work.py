"""Decode a photo of a capture, turn it upright and shrink it, in a process with limits: what fork_server.py runs.

Messages: `{"jpeg": true}` once the small picture is written, `{"unreadable": REASON}`, or `{"full": true}` for a disk
without space.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from PIL import Image, UnidentifiedImageError

from capture2vr.gateway.database.full_disk import is_disk_full
from capture2vr.gateway.uploads.image_checks import MAX_PIXELS, load_pillow
from capture2vr.gateway.uploads.process_limits import limit_process
from capture2vr.process.fork_server import Talk
from capture2vr.sentences.sentence import say

LONGEST_PX = 1024
"""Longer side of what is sent: enough to draw a line within a pixel of a phone's screen; 140 to 400 KB."""
_QUALITY = 82
# Of processor time, and of memory. 12 megapixels take 0.2 s and 60 MB as a JPEG, 0.5 s and 100 MB as HEIC; 48 of HEIC
# 1.6 s and 360 MB.
_SECONDS = 30.0
_MOST_DATA_BYTES = 768 << 20
_ORIENTATION = 0x0112
# EXIF orientation -> how Pillow turns it; mirrored pictures stay mirrored, as they do when they are reconstructed.
_TURNS = {
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.ROTATE_180,
    5: Image.Transpose.ROTATE_270,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.ROTATE_90,
    8: Image.Transpose.ROTATE_90,
}
_TURNED_BY_TAG = ("JPEG", "PNG", "WEBP")  # decoders of HEIF and TIFF turn them by themselves

load_pillow()


def work(order: dict[str, Any], talk: Talk) -> None:
    """Write the small, upright JPEG of the photo at `source` to `target`."""
    limit_process(_SECONDS, _MOST_DATA_BYTES)
    try:
        picture = shrink(Path(order["source"]))
    except UnidentifiedImageError:  # its text names our file
        talk.send({"unreadable": say("not_image_can_be_read")})
    except MemoryError:
        talk.send({"unreadable": say("decoding_takes_too_much_memory")})
    except Exception as error:  # noqa: BLE001 - Pillow's plugins raise anything on damaged files
        talk.send({"unreadable": say("image_damaged", error=error)})
    else:
        _write(picture, order["target"], talk)


def _write(picture: Image.Image, target: str, talk: Talk) -> None:
    try:
        picture.save(target, "JPEG", quality=_QUALITY)
    except OSError as error:
        if not is_disk_full(error):
            raise
        talk.send({"full": True})
    else:
        talk.send({"jpeg": True})


def shrink(path: Path) -> Image.Image:
    """Return the upright photo, at most `LONGEST_PX` long. Raises what Pillow does: anything, for a damaged one."""
    with load_pillow().open(path, formats=(*_TURNED_BY_TAG, "TIFF", "HEIF")) as image:
        if image.width * image.height > MAX_PIXELS:
            raise ValueError(say("has_more_than_megapixels", most=MAX_PIXELS // 1000000))
        if image.format == "JPEG":
            image.draft("RGB", (2 * LONGEST_PX, 2 * LONGEST_PX))
        turn = _TURNS.get(_orientation(image)) if image.format in _TURNED_BY_TAG else None
        image.thumbnail((LONGEST_PX, LONGEST_PX))
        upright: Image.Image = _eight_bits(image).convert("RGB")
    return upright if turn is None else upright.transpose(turn)


def _orientation(image: Image.Image) -> int:
    """Return the EXIF orientation; 1 where EXIF is missing or damaged, as it is taken to be for the reconstruction."""
    try:
        return int(image.getexif().get(_ORIENTATION, 1))
    except Exception:  # noqa: BLE001 - damaged tags raise anything at all; the picture is usable without them
        return 1


def _eight_bits(image: Image.Image) -> Image.Image:
    """Return a grey image of 16 bits as one of 8: Pillow's own conversion makes all but the darkest parts white."""
    if not image.mode.startswith("I;16"):
        return image
    return image.convert("I").point(lambda value: value * (1 / 256)).convert("L")
