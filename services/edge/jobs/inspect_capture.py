"""Inspect an uploaded capture: read it without reconstructing it, in a process with limits.

Damaged bytes can end a process in native code, so it is not this one; it has none of the worker's settings and secrets.
"""

from __future__ import annotations

import signal
from pathlib import Path

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.arrays import Tick
from capture2vr.edge.jobs.forked_talk import talking
from capture2vr.edge.jobs.reading_limits import reader_ended
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.order.photo_box import PhotoBox
from capture2vr.process.fork_client import ForkServer

ANSWER = "inspection.pb"
"""File that the process writes: a serialised `Inspection`."""


class Inspector:
    """Inspects archives, each in a process of its own, without this worker's settings and secrets.

    models  learned models that may cut the object out of one photo, as they do in a job
    """

    def __init__(self, server: ForkServer | None = None, models: ModelFolder | None = None) -> None:
        self._server = server or ForkServer.of("capture2vr.edge.jobs.inspection_work")
        self._models = models

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
        order = {
            "archive": str(archive.resolve()),
            "scratch": str(scratch.resolve()),
            "box": box and box.as_json,
            "models": self._models and [str(self._models.folder), self._models.device],
        }
        with talking(self._server, order, tick) as talk:
            said = dict(talk.messages())
        if "failed" in said:
            raise RuntimeError(f"an inspection failed: {said['failed']}")
        if status := said.get("ended", -signal.SIGKILL):
            raise reader_ended(status)
        answer = pb.Inspection.FromString((scratch / ANSWER).read_bytes())
        answer.processor_s = said["processor_s"]
        return answer
