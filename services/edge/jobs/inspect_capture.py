"""Inspect an uploaded capture: read it without reconstructing it, in a process with limits.

Captures are hostile until they have been read: a file of a few kilobytes can cost a reader minutes and gigabytes, and
damaged bytes can end a process in native code. So its seconds and memory are limited, in proportion to what was sent.
"""

from __future__ import annotations

import json
import math
import os
import signal
import socket
import time
from itertools import chain
from pathlib import Path
from typing import Any

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.arrays import Tick, no_tick
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.marking.isolate_marked import with_marked_photo
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.single_photo.cutout import cut_out
from capture2vr.order.photo_box import PhotoBox
from capture2vr.process.archives import ArchiveError, unpack
from capture2vr.process.fork_client import Forked, ForkServer
from capture2vr.sentences.documents import codes_as_json
from capture2vr.sentences.sentence import say

ANSWER = "inspection.pb"
"""File that the process writes: a serialised `Inspection`."""

_POLL_S = 0.1  # between two ticks: the longest time that an inspection goes on that nobody waits for
_WITHIN_S = 120.0  # of the clock, on a machine that does other work too
# Numbers of signals by which a process ends that used up its processor time or memory; the kernel sends the second one.
_USED_UP = (-signal.SIGXCPU, -signal.SIGKILL)


class Inspector:
    """Inspects archives, each in a process of its own, without this worker's settings and secrets."""

    def __init__(self, server: ForkServer | None = None) -> None:
        self._server = server or ForkServer.of("capture2vr.edge.jobs.inspection_work")

    def start(self) -> None:
        """Load all that an inspection needs now, so that the first one need not wait for it."""
        self._server.start()

    def close(self) -> None:
        """Terminate the fork server and its inspections."""
        self._server.close()

    def inspect(self, archive: Path, scratch: Path, box: PhotoBox | None, tick: Tick) -> pb.Inspection:
        """Inspect an archive in a process that is killed when `tick` raises.

        Raises CAPTURE_TOO_LARGE where reading it costs more than the limits, CAPTURE_UNREADABLE where the reader
        crashes. Faults of the capture are in the answer, as its `failure`.
        """
        order = {"archive": str(archive.resolve()), "scratch": str(scratch.resolve()), "box": box and box.as_json}
        said = _talk(self._server.fork(), order, tick)
        if "failed" in said:
            raise RuntimeError(f"an inspection failed: {said['failed']}")
        status = said.get("ended", -signal.SIGKILL)
        if status in _USED_UP:
            raise too_costly(say("more_time"))
        if status:
            name = signal.Signals(-status).name if status < 0 else f"status {status}"
            raise CaptureError("CAPTURE_UNREADABLE", say("cannot_be_read_reader_crashed", name=name))
        return pb.Inspection.FromString((scratch / ANSWER).read_bytes())


def _talk(forked: Forked, order: dict[str, Any], tick: Tick) -> dict[str, Any]:
    """Send the order; return what the process says until it has ended. Raises what `tick` raises, having killed it.

    A process that takes longer than `_WITHIN_S` is killed too.
    """
    said, deadline = b"", time.monotonic() + _WITHIN_S
    with forked.channel as channel:
        channel.sendall(json.dumps(order).encode() + b"\n")
        channel.settimeout(_POLL_S)
        try:
            said = _read_to_end(channel, deadline, tick)
        finally:
            os.close(forked.leash)
            channel.settimeout(None)
            said += _read_to_end(channel, math.inf, no_tick)  # its folder may be removed once it has ended
    return {name: value for line in said.splitlines() for name, value in json.loads(line).items()}


def _read_to_end(channel: socket.socket, deadline: float, tick: Tick) -> bytes:
    """Read until the other end closes, or until the deadline of the monotonic clock."""
    said = b""
    while time.monotonic() < deadline:
        try:
            block = channel.recv(1 << 16)
        except TimeoutError:
            tick(0.5)  # how far it is nobody knows
            continue
        except ConnectionError:  # killed before it had read its order
            break
        if not block:
            break
        said += block
    return said


def too_costly(what: str) -> CaptureError:
    """Return a CAPTURE_TOO_LARGE error for a capture that needs more of something than its size explains."""
    return CaptureError("CAPTURE_TOO_LARGE", say("needs_to_be_read_than", what=what))


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
    with_marked_photo(capture, box)
    cut = cut_out(capture.photos[0], box) if capture.kind == "image" else None
    warnings = (*capture.warnings, *(cut.warnings if cut else ()))
    return pb.Inspection(
        kind=capture.kind,
        format=capture.format,
        frames=_frames(capture),
        points=capture.whole.count if capture.whole else len(capture.cloud.xyz) if capture.cloud else 0,
        warnings=warnings,
        i18n=codes_as_json(warnings=warnings),
        outline=[pb.Polygon(xy=chain.from_iterable(line)) for line in (cut.outline() if cut else ())],
    )


def _frames(capture: Capture) -> int:
    return len(capture.frames) or len(capture.photos)
