"""The computing of one job, in a process of its own: what fork_server.py runs for the worker.

Messages, as job_process.py reads them: `process`, `progress`, `anchors`, `saved`, `bundle`, `kept`, and at the end
`finished` or `failure`. Behind `saved` and each `bundle` the process waits until the worker says to go on.
"""

from __future__ import annotations

import importlib
import json
import logging
import os
import resource
import shutil
import tempfile
import time
from collections.abc import Generator
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.asset.manifest import anchors_m, asset_frame
from capture2vr.edge.capture_to_points import PREVIEW_SHARE, PreparedPoints, prepare, preview_share
from capture2vr.edge.engine.address import engine_for_parts
from capture2vr.edge.generated.to_points import generator_of
from capture2vr.edge.job_resources import JobResources
from capture2vr.edge.jobs.job_task import BUNDLE, MANIFEST, JobTask, on_wire
from capture2vr.edge.jobs.points_archive import read_prepared
from capture2vr.edge.jobs.points_cache import has_points, load_points, save_points
from capture2vr.edge.jobs.reading_limits import limited_reading
from capture2vr.edge.jobs.unpack_capture import unpack_capture
from capture2vr.edge.pipeline import PreviewKept, bundles
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.progress import Bar, Progress
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.worker.coded_messages import coded_progress
from capture2vr.edge.worker.failures import failure_of
from capture2vr.process.fork_server import Talk
from capture2vr.process.logs import configure, log_fields
from capture2vr.sentences.documents import with_codes
from capture2vr.sentences.sentence import say
from capture2vr.storage.bundle import Bundle, FilesOnDisk

T = TypeVar("T")

# What a job imports when it first needs it, loaded here for all of them: that took each 0.15 s.
for _name in ("PIL.Image", "PIL.WebPImagePlugin", "embreex.mesh_construction", "laspy", "meshopt"):
    with suppress(ImportError):  # of what not every platform has a wheel for
        importlib.import_module(_name)


def work(order: dict[str, Any], talk: Talk) -> None:
    """Do a job's computing, and tell how it goes and how it ends."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    task = JobTask.of(order)
    configure(logging.getLevelName(task.log_level))
    # A process that is killed removes nothing: the worker removes this folder.
    tempfile.tempdir = os.environ["TMPDIR"] = str(task.scratch)
    talk.send({"process": os.getpid()})
    try:
        with log_fields(job=task.job, tenant=task.tenant):
            seconds = _Job(task, talk).run()
    except BrokenPipeError:
        raise
    except BaseException as error:  # noqa: BLE001 - whatever ends the job, the worker must be told
        talk.send({"failure": on_wire(failure_of(error, job=task.job, scratch=task.scratch))})
    else:
        talk.send({"finished": seconds})


class _Job:
    """A job that runs."""

    def __init__(self, task: JobTask, talk: Talk) -> None:
        self._task, self._talk = task, talk
        self._bar = Bar(self._tell)

    def run(self) -> dict[str, float]:
        """Run the job to its end; return the seconds that reading the archive took."""
        task = self._task
        prepared, seconds = None, 0.0
        if task.saves and has_points(task.checkpoint):
            self._send_progress(coded_progress(say("reading", what=say("word_points")), stage=pb.POINT_CLOUD))
            prepared = load_points(task.checkpoint, task.scratch / "kept")
        if prepared is None:
            prepared, seconds = self._prepared()
        if task.saves:
            prepared = self._saved(prepared, seconds)
        self._fit(prepared)
        return {"VALIDATING": seconds}

    def _saved(self, prepared: PreparedPoints, seconds: float) -> PreparedPoints:
        """Save the points for central, and wait whether they are to be fitted here all the same, and why."""
        if not self._task.whole:
            prepared = replace(prepared, points=replace(prepared.points, whole=None))
        path = save_points(prepared, self._task.checkpoint)
        facts = {"path": str(path), "reached": self._bar.reached}
        self._talk.send({"saved": {**facts, "seconds": {"VALIDATING": seconds}}})
        warning = self._talk.receive()["warning"]
        return replace(prepared, points=replace(prepared.points, warnings=(*prepared.points.warnings, warning)))

    def _prepared(self) -> tuple[PreparedPoints, float]:
        """Make or read the points of the archive; also return the seconds that reading it took."""
        task = self._task
        what = say("word_points" if task.prepared else "word_capture")
        reading = coded_progress(say("reading", what=what), stage=pb.VALIDATING)
        self._send_progress(reading)
        began = time.perf_counter()
        if task.prepared:
            return read_prepared(task.archive, task.scratch / "prepared"), time.perf_counter() - began
        folder = unpack_capture(task.archive, task.scratch)
        with limited_reading(folder):
            capture = read_capture(
                folder, reading=task.options.reading, tick=lambda fraction: self._send_progress(reading)
            )
        seconds = time.perf_counter() - began
        machine = task.machine
        steps = prepare(
            capture,
            self._bar,
            task.options,
            refines=task.trains,
            device=machine.device,
            models=machine.models,
            generator=generator_of(task.preset, machine.generator) if task.preset else None,
        )
        prepared = self._run_to_end(steps)
        self._talk.send({"anchors": on_wire(_anchor_points(prepared.points))})
        return prepared, seconds

    def _fit(self, prepared: PreparedPoints) -> None:
        """Fit the field, and hand the bundles over."""
        task, bar = self._task, self._bar
        assert task.preset is not None, "a preset that only central has is not fitted here"
        engine = engine_for_parts(*task.machine.engine) if task.machine.engine else None
        steps = bundles(
            prepared,
            task.preset,
            bar,
            task.options,
            JobResources(task.machine.device, task.checkpoint, task.machine.encode, engine),
            share=preview_share(prepared.source.kind) if bar.reached else PREVIEW_SHARE,
            refuse=task.refusal,
        )
        with closing(steps):
            for step in steps:
                match step:
                    case Progress():
                        self._tell(step)
                    case Bundle():
                        self._hand_over(step)
                    case PreviewKept():
                        self._talk.send({"kept": {"warning": step.warning, "seconds": dict(step.seconds)}})

    def _hand_over(self, bundle: Bundle) -> None:
        """Write a bundle into the scratch folder, tell of it, and wait until it is published."""
        folder = self._task.scratch / BUNDLE
        on_disk = bundle.files.paths if isinstance(bundle.files, FilesOnDisk) else {}
        for name in bundle.files:
            path = folder / "files" / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if name in on_disk:
                _link(on_disk[name], path)
            else:
                path.write_bytes(bundle.files[name])
        (folder / MANIFEST).write_text(json.dumps(with_codes(bundle.manifest)), encoding="utf-8")
        facts = {"files": list(bundle.files), "state": bundle.state, "last": bundle.last}
        self._talk.send({"bundle": {**facts, "reached": self._bar.reached}})
        self._talk.receive()

    def _run_to_end(self, steps: Generator[Progress, None, T]) -> T:
        """Run a generator to its end: tell the progress that it yields, return what it returns."""
        with closing(steps):
            while True:
                try:
                    self._tell(next(steps))
                except StopIteration as ended:
                    result: T = ended.value
                    return result

    def _tell(self, progress: Progress) -> None:
        self._send_progress(
            coded_progress(progress.message, stage=progress.stage, fraction=progress.fraction, losses=progress.losses)
        )

    def _send_progress(self, progress: pb.Progress) -> None:
        self._talk.send({"progress": on_wire(progress)})


def _link(source: Path, target: Path) -> None:
    """Give a file another name, or copy it where the file system does not let us."""
    with suppress(OSError):
        os.link(source, target)
        return
    shutil.copyfile(source, target)


def _anchor_points(points: Points) -> pb.AnchorPoints:
    """The points that are shown before there is a mesh, in the asset frame of the points alone."""
    xyz, rgb = anchors_m(points, asset_frame(points.xyz, points))
    return pb.AnchorPoints(xyz_m=xyz.ravel(), rgb=rgb.tobytes())
