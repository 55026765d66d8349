"""A job's process, as the worker sees it: started, followed, limited in memory, and killed when nobody wants it.

What a stranger sends is computed there alone, without this worker's secrets; what comes out of it is not trusted
either: messages are JSON and the wire's own, and the files of a bundle are looked at before they are published.
"""

from __future__ import annotations

import json
import logging
import math
import shutil
import signal
import stat
import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from google.protobuf.message import DecodeError

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.jobs.forked_talk import ForkedTalk, talking
from capture2vr.edge.jobs.job_task import BUNDLE, MANIFEST, JobTask, off_wire
from capture2vr.edge.jobs.reading_limits import reader_ended
from capture2vr.edge.worker.control_group import own_control_group
from capture2vr.edge.worker.failures import error_of, out_of_memory
from capture2vr.edge.worker.job_run import Report
from capture2vr.edge.worker.memory_watch import MemoryWatch
from capture2vr.process.fork_client import ForkServer
from capture2vr.sentences.documents import with_sentences
from capture2vr.sentences.sentence import say
from capture2vr.storage.bundle import Bundle, FilesOnDisk, State

_log = logging.getLogger(__name__)

_MODULE = "capture2vr.edge.jobs.job_work"  # whose `work` a job's process runs
_STATES: Mapping[str, State] = {"preview": "preview", "refined": "refined"}


@dataclass(frozen=True, slots=True)
class Saved:
    """The points are saved, for central.

    path  of their archive; reached: fraction of the job that is done; seconds: of the stages so far
    """

    path: Path
    reached: float
    seconds: dict[str, float]


@dataclass(frozen=True, slots=True)
class MadeBundle:
    """A bundle that is to be published. reached: fraction of the job that is done"""

    bundle: Bundle
    reached: float


@dataclass(frozen=True, slots=True)
class Kept:
    """The preview is the result. warning: why; seconds: of the stages"""

    warning: str
    seconds: dict[str, float]


@dataclass(frozen=True, slots=True)
class Done:
    """The end. seconds: beside those of the bundles"""

    seconds: dict[str, float]


Step = Saved | MadeBundle | Kept | Done
"""What a job's process has come to. Progress and anchor points are reported on the way."""


class JobProcesses:
    """Starts a process for each job, forked from a server that has loaded all that a job needs.

    watch  of their memory; most_seconds: that a job may compute, waits and publishing included
    """

    def __init__(
        self, server: ForkServer | None = None, watch: MemoryWatch | None = None, most_seconds: float = math.inf
    ) -> None:
        self._most_seconds = most_seconds
        self._server = server or ForkServer.of(_MODULE, threads=True)
        self._watch = watch or MemoryWatch()

    def start(self) -> None:
        """Load all that a job needs now, so that the first one need not wait for it."""
        self._server.start()

    def close(self) -> None:
        """Terminate the server and all jobs."""
        self._server.close()

    @contextmanager
    def running(self, task: JobTask, report: Report) -> Iterator[JobProcess]:
        """Run a job's process in the block, at whose end it is killed. What `report` raises ends the block, too."""
        most_seconds = min(self._most_seconds, task.most_seconds or math.inf)
        process = JobProcess(task, report, self._watch, most_seconds)
        try:
            with talking(self._server, task.as_order(), process.tick) as talk:
                process.talk = talk
                yield process
        finally:
            self._watch.forget(process.number)


class JobProcess:
    """A job's process that runs."""

    talk: ForkedTalk

    def __init__(self, task: JobTask, report: Report, watch: MemoryWatch, most_seconds: float) -> None:
        self._task, self._report, self._watch = task, report, watch
        self._most_seconds, self._began = most_seconds, time.monotonic()
        self._kills = own_control_group().oom_kills
        self._last = pb.Progress()  # no news yet
        self.number = 0

    def tick(self, _: float) -> None:
        """Report again, which raises when the job is cancelled. Raises OUT_OF_MEMORY and JOB_TOO_LONG."""
        self._report(self._last)
        if self._watch.is_too_large(self.number):
            raise out_of_memory()
        if time.monotonic() - self._began > self._most_seconds:
            message, hints = say("job_took_longer", seconds=self._most_seconds), (say("choose_coarser_preset"),)
            raise EdgeError("JOB_TOO_LONG", message, hints=hints)

    def go_on(self, **answer: Any) -> None:
        """Let the process go on behind `Saved` or `MadeBundle`."""
        self.talk.send(answer)

    def saved(self) -> Saved:
        """Follow the process until the points are saved. Raises as `steps`."""
        with closing(self.steps()) as steps:
            for step in steps:
                if isinstance(step, Saved):
                    return step
        raise _lost()

    def steps(self) -> Generator[Step]:
        """Report what the process tells, and yield what it comes to, `Done` last.

        Raises EdgeError where the job fails or its process dies, and what `report` raises.
        """
        for name, said in self.talk.messages():
            try:
                step = self._read(name, said)
            except (AttributeError, KeyError, TypeError, ValueError, DecodeError, OSError) as error:
                raise RuntimeError(f"a job's process said what none says: {name}") from error
            if isinstance(step, BaseException):
                raise step
            if step:
                yield step
            if isinstance(step, Done):
                return
        raise _lost()

    def _read(self, name: str, said: Any) -> Step | BaseException | None:
        """Read a message: a step, the error with which the job ends, or None for what is reported here."""
        match name:
            case "progress":
                self._last = pb.Progress.FromString(off_wire(said))
                self._report(self._last)
            case "anchors":
                self._report(pb.AnchorPoints.FromString(off_wire(said)))
            case "saved":
                path = _inside(Path(said["path"]), self._task.checkpoint.parent)
                return Saved(path, float(said["reached"]), _seconds(said["seconds"]))
            case "bundle":
                return MadeBundle(self._bundle(said), float(said["reached"]))
            case "kept":
                return Kept(_text(said["warning"]), _seconds(said["seconds"]))
            case "finished":
                return Done(_seconds(said))
            case "failure":
                return error_of(pb.Failure.FromString(off_wire(said)))
            case "process":
                self.number = int(said)
            case "failed":
                return RuntimeError(f"a job's process failed: {said}")
            case "ended":
                return self._ended(int(said))
        return None

    def _ended(self, status: int) -> BaseException:
        """The error of a process that has ended before its job had."""
        _log.warning("job %s: its process ended with status %d", self._task.job, status)
        if status == -signal.SIGKILL:
            return out_of_memory() if own_control_group().oom_kills > self._kills else _lost()
        return reader_ended(status) if self._last.stage <= pb.VALIDATING else _lost()

    def _bundle(self, said: Mapping[str, Any]) -> Bundle:
        """The bundle that the process has handed over."""
        folder = self._task.scratch / BUNDLE
        files = {name: _inside(folder / "files" / name, folder) for name in said["files"]}
        manifest = with_sentences(json.loads(_inside(folder / MANIFEST, folder).read_bytes()))
        return Bundle(_STATES[said["state"]], FilesOnDisk({}, files), manifest, last=said["last"] is True)

    def drop_bundle(self) -> None:
        """Remove the bundle's files once they are published."""
        shutil.rmtree(self._task.scratch / BUNDLE, ignore_errors=True)


def _inside(path: Path, folder: Path) -> Path:
    """Return the path of a file that is in a folder of the job, and no link to another. Raises ValueError, OSError."""
    real = path.resolve(strict=True)
    if real != folder.resolve() / path.relative_to(folder) or not stat.S_ISREG(real.stat().st_mode):
        raise ValueError(f"{path} is no file of the job")
    return real


def _seconds(said: Mapping[str, Any]) -> dict[str, float]:
    return {str(stage): float(seconds) for stage, seconds in said.items()}


def _lost() -> EdgeError:
    return EdgeError(
        "JOB_PROCESS_LOST", say("job_process_lost"), hints=(say("send_job_again_another_worker"),), retryable=True
    )


def _text(said: Any) -> str:
    if not isinstance(said, str):
        raise TypeError(f"{type(said).__name__} is no text")
    return said
