"""The inspection of one capture, in a process of its own with limits: what fork_server.py runs for the worker."""

from __future__ import annotations

import os
import resource
import tempfile
from itertools import chain
from pathlib import Path
from typing import Any

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.jobs.inspect_capture import ANSWER
from capture2vr.edge.jobs.reading_limits import limited_reading
from capture2vr.edge.jobs.unpack_capture import unpack_capture
from capture2vr.edge.marking.isolate_marked import with_marked_photo
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.single_photo.cutout import cut_out
from capture2vr.edge.worker.failures import failure_of
from capture2vr.order.photo_box import PhotoBox
from capture2vr.process.fork_server import Talk
from capture2vr.sentences.documents import codes_as_json


def work(order: dict[str, Any], _: Talk) -> None:
    """Inspect an archive within limits that follow from its unpacked size, and write the answer to the scratch folder.

    order  archive and scratch: paths; box: of the object in a photo, as in JSON, or nothing; models: their folder and
           the device that runs them, or nothing
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    box = PhotoBox.of(order["box"]) if order["box"] else None
    models = ModelFolder(Path(order["models"][0]), order["models"][1]) if order["models"] else None
    scratch = Path(order["scratch"])
    # Decoders write gigabytes, and a process that is killed removes nothing: the worker removes this folder.
    tempfile.tempdir = os.environ["TMPDIR"] = str(scratch)
    try:
        folder = unpack_capture(Path(order["archive"]), scratch)
        with limited_reading(folder):
            answer = inspect(folder, box, models)
    except EdgeError as error:
        answer = pb.Inspection(failure=failure_of(error, job="of an inspection", scratch=scratch))
    (scratch / ANSWER).write_bytes(answer.SerializeToString())


def inspect(folder: Path, box: PhotoBox | None, models: ModelFolder | None = None) -> pb.Inspection:
    """Read a capture's folder: its kind, format and size, and the outline of the thing in a single photo.

    box     rectangle of the thing in the photo; None: it is looked for
    models  learned models that may find it

    Raises EdgeError when the capture cannot be used.
    """
    capture = read_capture(folder)
    with_marked_photo(capture, box)
    cut = cut_out(capture.photos[0], box, models=models) if capture.kind == "image" else None
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
