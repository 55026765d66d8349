"""Inspect an uploaded capture: read it without reconstructing it, in a child process with limits.

Captures are hostile until they have been read: a file of a few kilobytes can cost a reader minutes and gigabytes, and
damaged bytes can end a process in native code. So the child may use seconds and memory in proportion to what was sent.
"""

from __future__ import annotations

import json
import logging
import signal
import sys
from dataclasses import astuple
from itertools import chain
from pathlib import Path

from services.edge.api import edge_pb2 as pb
from services.edge.arrays import Tick
from services.edge.capture.detect import read_capture
from services.edge.capture.nouns import Capture
from services.edge.capture_to_points import require_single_photo
from services.edge.child_process import ChildError, run_child
from services.edge.errors import CaptureError
from services.edge.single_photo.cutout import cut_out
from services.photo_box import PhotoBox
from services.storage.archives import ArchiveError, unpack

ANSWER = "inspection.pb"
"""File that the child writes: a serialised `Inspection`."""

_WITHIN_S = 120.0  # of the clock, on a machine that does other work too
# Numbers of signals by which a child ends that used up its processor time or memory; the kernel sends the second one.
_USED_UP = (-signal.SIGXCPU, -signal.SIGKILL)

_log = logging.getLogger(__name__)


def inspect_in_child(archive: Path, scratch: Path, box: PhotoBox | None, tick: Tick) -> pb.Inspection:
    """Inspect an archive in a child process, which is killed when `tick` raises.

    Raises CAPTURE_TOO_LARGE where reading it costs more than the limits, CAPTURE_UNREADABLE where the reader crashes.
    Faults of the capture are in the answer, as its `failure`.
    """
    corners = json.dumps(astuple(box) if box else ())
    module, paths = "services.edge.jobs.inspection_child", (str(archive.resolve()), str(scratch.resolve()))
    command = [sys.executable, "-m", module, *paths, corners]
    log = scratch / "log"
    try:
        run_child(command, "the inspection", log, tick, most_seconds=_WITHIN_S)
    except ChildError as error:
        if error.too_slow or error.status in _USED_UP:
            raise too_costly("more time") from None
        if error.status is not None and error.status < 0:
            name = signal.Signals(-error.status).name
            raise CaptureError("CAPTURE_UNREADABLE", f"cannot be read: its reader crashed ({name})") from None
        _log.error("an inspection failed: %s", log.read_text(errors="replace"))
        raise
    return pb.Inspection.FromString((scratch / ANSWER).read_bytes())


def too_costly(what: str) -> CaptureError:
    """Return a CAPTURE_TOO_LARGE error for a capture that needs more of something than its size explains."""
    return CaptureError("CAPTURE_TOO_LARGE", f"needs {what} to be read than a capture of its size may take")


def unpack_capture(archive: Path, scratch: Path) -> Path:
    """Unpack an archive into a folder in `scratch`, and return the folder. Raises CaptureError."""
    folder = scratch / "capture"
    try:
        unpack(archive, folder)
    except ArchiveError as error:
        raise CaptureError(error.code, error.message, file=error.file, hints=error.hints) from None
    return folder


def inspect(folder: Path, box: PhotoBox | None) -> pb.Inspection:
    """Read a capture's folder: its kind, format and size, and the outline of the thing in a single photo.

    box  rectangle of the thing in the photo; None: it is looked for

    Raises EdgeError when the capture cannot be used.
    """
    capture = read_capture(folder)
    require_single_photo(capture, box)
    cut = cut_out(capture.photos[0], box) if capture.kind == "image" else None
    return pb.Inspection(
        kind=capture.kind,
        format=capture.format,
        frames=_frames(capture),
        points=len(capture.cloud.xyz) if capture.cloud else 0,
        warnings=(*capture.warnings, *(cut.warnings if cut else ())),
        outline=[pb.Polygon(xy=chain.from_iterable(line)) for line in (cut.outline() if cut else ())],
    )


def _frames(capture: Capture) -> int:
    return len(capture.frames) or len(capture.photos)
