"""Read the layout of NeRF's synthetic scenes, rendered by Blender: `transforms_train.json`, `_val` and `_test`.

As `transforms.json` of nerfstudio, with one file for each split, whose pictures are named without their suffix. What is
transparent in them is not the object.
"""

from __future__ import annotations

import posixpath
import re
from collections import ChainMap
from collections.abc import Callable, Container
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.capture.files import Folder
from capture2vr.edge.capture.frame_records import first_names, missing_warning
from capture2vr.edge.capture.nouns import Capture, Photo
from capture2vr.edge.capture.photos import SUFFIXES, pictures
from capture2vr.edge.capture.posed_photos import posed_capture, unlisted_warning
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.recordings.nerfstudio import listed_photos, read_frames
from capture2vr.sentences.sentence import say

_FILES = ("transforms_train.json", "transforms_val.json", "transforms_test.json")
_OTHER_PASSES = re.compile(r"_(depth|normal)_\d+\.")  # what Blender writes beside the pictures of the test split
_BY_BLENDER = "rotation"  # of every frame, in what NeRF's own script for Blender writes; Z is up there
_UP_Z = np.array([0.0, 0.0, 1.0])


def matches(folder: Folder) -> bool:
    """Return whether the folder has the file of any split."""
    return any(folder.has(file) for file in _FILES)


def read(folder: Folder) -> Capture:
    """Read the photos of all splits with their cameras; of pictures that are not there it is told.

    Raises CaptureError, naming the file, where no split has pictures.
    """
    files = list(filter(folder.has, _FILES))
    found = pictures(folder)
    known = set(map(_tail, found))
    splits = [_split(folder, file, known) for file in files]
    photos = ChainMap(*(split.photos for split in splits))  # a picture of two splits is one
    missing = [path for split in splits for path in split.missing]
    if not photos:
        reason = say("lists_images_but_capture", count=len(missing), name=first_names(missing[:1]))
        raise CaptureError("CAPTURE_COUNT_MISMATCH", reason, file=files[0], hints=(say("send_images"),))
    passes = filter(_OTHER_PASSES.search, found)
    warnings = (
        *missing_warning(missing, say("word_images")),
        *unlisted_warning(folder, {*photos, *passes}, ", ".join(files)),
    )
    tries = [photos[name] for name in folder.names if name in photos]
    up = _UP_Z if all(split.upright for split in splits) else None
    return posed_capture("blender", tries, up=up, warnings=warnings)


@dataclass(frozen=True, slots=True)
class _Split:
    """A split of a scene: functions that read its photos, by their names; paths of pictures that are not there; and
    whether Z is up."""

    photos: dict[str, Callable[[], Photo]]
    missing: list[str]
    upright: bool


def _split(folder: Folder, file: str, known: Container[str]) -> _Split:
    """Find a split's photos. known: the tails of all pictures

    Splits have pictures of the same names: where the folder of one is missing, that of another is not taken for it.
    """
    tree, frames = read_frames(folder, file)
    there = [frame for frame in frames if _tail(str(frame.get("file_path"))) in known]
    missing = [path for frame in frames if _tail(path := str(frame.get("file_path"))) not in known]
    upright = all(_BY_BLENDER in frame for frame in frames)
    if not there:
        return _Split({}, missing, upright)
    listed = listed_photos(folder, tree, there, file)
    return _Split(dict(zip(listed.names, listed.tries, strict=True)), missing + listed.missing, upright)


def _tail(path: str) -> str:
    """Return a picture's last folder and name without suffix, in lower case, however its path is written."""
    parts = [part for part in path.lower().replace("\\", "/").split("/") if part not in ("", ".")]
    stem, suffix = posixpath.splitext("/".join(parts[-2:]))
    return stem if suffix in SUFFIXES else stem + suffix
