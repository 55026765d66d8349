"""A job's process: what it does ends with it, and harms neither its neighbours nor the worker."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
import zipfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil
import pytest

from capture2vr.edge.errors import Cancelled, EdgeError
from capture2vr.edge.jobs.job_process import JobProcess, JobProcesses, MadeBundle
from capture2vr.edge.jobs.job_task import JobTask
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.worker.memory_watch import MemoryWatch
from capture2vr.process.fork_client import ForkServer
from tests.support import captures
from tests.support.patience import PATIENCE_S
from tests.support.workers.job_tasks import task_in

SCRIPTED = """
import os, socket, subprocess, sys, time
from pathlib import Path
from capture2vr.edge.jobs.job_task import JobTask
from capture2vr.process import fork_server
def work(order, talk):
    task = JobTask.of(order)
    talk.send({"process": os.getpid()})
    DOES
fork_server.serve(socket.socket(fileno=int(sys.argv[1])), work)
"""
CANCEL_S = 2.0

WORKER = """
import sys
from pathlib import Path
import capture2vr.edge.__main__
from capture2vr.edge.jobs.job_process import JobProcesses, MadeBundle
from tests.support.workers.job_tasks import task_in
states = []
task = task_in(Path(sys.argv[2]), archive=Path(sys.argv[1]))
with JobProcesses().running(task, lambda update: None) as process:
    for step in process.steps():
        if isinstance(step, MadeBundle):
            states.append(step.bundle.state)
            process.drop_bundle()
            process.go_on()
print(states)
maps = Path("/proc/self/maps").read_text()
decoders = ("cv2", "PIL", "pillow_heif", "av", "scipy", "trimesh", "laspy", "skimage", "pycolmap", "pye57", "torch")
print([each for each in decoders if each in sys.modules or f"/{each}/" in maps])
"""


def processes(does: str, most_bytes: int = 1 << 50, most_seconds: float = PATIENCE_S) -> JobProcesses:
    """Processes that do something else than a job."""
    return JobProcesses(ForkServer("-c", SCRIPTED.replace("DOES", does)), MemoryWatch(most_bytes), most_seconds)


def ignore(_: Any) -> None:
    pass


def ends_with(does: str, folder: Path, most_bytes: int = 1 << 50) -> BaseException:
    """The error with which a job ends whose process does that."""
    with (
        closing(processes(does, most_bytes)) as started,
        started.running(task_in(folder), ignore) as process,
        pytest.raises((EdgeError, RuntimeError)) as ended,
    ):
        list(process.steps())
    return ended.value


@contextmanager
def running(started: JobProcesses, task: JobTask, report: Any = ignore) -> Iterator[JobProcess]:
    """A job whose process has told its number."""
    with started.running(task, report) as process:
        _, process.number = next(process.talk.messages())
        yield process


@pytest.mark.parametrize(
    ("does", "code", "retryable"),
    [
        ("os.kill(os.getpid(), 9)", "JOB_PROCESS_LOST", True),
        ("os._exit(0)", "CAPTURE_UNREADABLE", False),
        ("os.abort()", "CAPTURE_UNREADABLE", False),
    ],
)
def test_a_process_that_dies_ends_its_job_with_a_code(tmp_path: Path, does: str, code: str, retryable: bool) -> None:
    error = ends_with(does, tmp_path)
    assert isinstance(error, EdgeError)
    assert (error.code, error.retryable) == (code, retryable)


def test_a_fault_of_ours_is_told_with_its_traceback(tmp_path: Path) -> None:
    assert "KeyError: 'MPO'" in str(ends_with("raise KeyError('MPO')", tmp_path))


@pytest.mark.parametrize(
    "said",
    [
        '{"progress": "no base64!"}',
        '{"bundle": {"files": ["../../secret"], "state": "preview", "last": True, "reached": 1.0}}',
        '{"bundle": {"files": ["lod0.glb"], "state": "preview", "last": True, "reached": 1.0}}',
        '{"bundle": {"files": [], "state": "held", "last": True, "reached": 1.0}}',
        '{"saved": {"path": "/etc/passwd", "reached": 1.0, "seconds": {}}}',
        '{"finished": {"VALIDATING": "long"}}',
    ],
)
def test_a_process_that_says_what_none_says_is_not_believed(tmp_path: Path, said: str) -> None:
    """As one that a capture has taken over: it links to files of the worker, names others, and sends no messages."""
    secret = tmp_path / "secret"
    secret.write_text("key")
    does = (
        "made = task.scratch / 'bundle' / 'files'; made.mkdir(parents=True); "
        f"(made / 'lod0.glb').symlink_to({str(secret)!r}); (made.parent / 'manifest.json').write_text('{{}}'); "
        f"talk.send({said}); time.sleep(600)"
    )
    assert "said what none says" in str(ends_with(does, tmp_path))


def test_a_bundle_waits_until_it_is_published(tmp_path: Path) -> None:
    does = (
        "made = task.scratch / 'bundle' / 'files'; made.mkdir(parents=True); (made / 'lod0.glb').write_bytes(b'glTF'); "
        "(made.parent / 'manifest.json').write_text('{\"lods\": []}'); "
        "talk.send({'bundle': {'files': ['lod0.glb'], 'state': 'preview', 'last': True, 'reached': 0.5}}); "
        "talk.send({'finished': {'FITTING': float(talk.receive()['seconds'])}})"
    )
    with closing(processes(does)) as started, started.running(task_in(tmp_path), ignore) as process:
        steps = process.steps()
        made = next(steps)
        assert isinstance(made, MadeBundle)
        assert (dict(made.bundle.files), made.bundle.manifest) == ({"lod0.glb": b"glTF"}, {"lods": []})
        process.drop_bundle()
        process.go_on(seconds=7)
        assert [step.seconds for step in steps] == [{"FITTING": 7.0}]
        assert list((tmp_path / "job_1").iterdir()) == []


@pytest.mark.slow
def test_the_models_of_the_worker_reach_its_jobs(tmp_path: Path) -> None:
    picture = np.full((240, 320, 3), 215, np.uint8)
    picture[60:180, 100:220] = 30, 60, 170
    archive = tmp_path / "photo.zip"
    with zipfile.ZipFile(archive, "w") as entries:
        entries.writestr("one.png", cv2.imencode(".png", picture)[1].tobytes())
    task = task_in(tmp_path, archive=archive)
    task = replace(task, machine=replace(task.machine, models=ModelFolder(tmp_path / "gone")))
    with closing(JobProcesses()) as started, started.running(task, ignore) as process:
        made = next(step for step in process.steps() if isinstance(step, MadeBundle))
        assert any("without a learned model" in warning for warning in made.bundle.manifest["warnings"])


def test_a_cancelled_job_leaves_no_process_that_computes(tmp_path: Path) -> None:
    """Nor one that it has started, in a session of its own."""
    endless = "while True: pass"
    does = f"subprocess.Popen([sys.executable, '-c', {endless!r}], start_new_session=True); time.sleep(0.2); {endless}"
    does = does.replace("; while", "\n    while")
    cancelled = threading.Event()

    def report(_: Any) -> None:
        if cancelled.is_set():
            raise Cancelled

    before = set(psutil.Process().children())
    with closing(processes(does)) as started:
        with running(started, task_in(tmp_path), report) as process:
            (server,) = set(psutil.Process().children()) - before
            until = time.monotonic() + PATIENCE_S
            while len(server.children(recursive=True)) < 2 and time.monotonic() < until:
                time.sleep(0.05)
            assert len(server.children(recursive=True)) == 2
            cancelled.set()
            began = time.monotonic()
            with pytest.raises(Cancelled):
                list(process.steps())
        assert time.monotonic() - began < CANCEL_S
        assert server.children(recursive=True) == []


def test_a_job_ends_with_the_server_that_holds_its_leash_and_the_next_one_has_another(tmp_path: Path) -> None:
    before = set(psutil.Process().children())
    with closing(processes("time.sleep(600)")) as started:
        with running(started, task_in(tmp_path)) as process:
            (server,) = set(psutil.Process().children()) - before
            computing = psutil.Process(process.number)
            server.kill()
            with pytest.raises(EdgeError, match="ended before"):
                list(process.steps())
            computing.wait(PATIENCE_S)
        with running(started, task_in(tmp_path, "job_2")) as process:
            assert psutil.pid_exists(process.number)


@pytest.mark.parametrize("does", ["time.sleep(600)", "while True: talk.send({'anchors': ''})"])
def test_a_job_that_takes_too_long_ends_whether_it_talks_or_not(tmp_path: Path, does: str) -> None:
    with (
        closing(processes(does, most_seconds=0.5)) as started,
        started.running(task_in(tmp_path), ignore) as process,
        pytest.raises(EdgeError, match="more than") as ended,
    ):
        list(process.steps())
    assert ended.value.code == "JOB_TOO_LONG"


def test_a_job_may_have_less_time_than_its_worker_gives(tmp_path: Path) -> None:
    task = replace(task_in(tmp_path), most_seconds=0.5)
    with (
        closing(processes("time.sleep(600)")) as started,
        started.running(task, ignore) as process,
        pytest.raises(EdgeError) as ended,
    ):
        list(process.steps())
    assert ended.value.code == "JOB_TOO_LONG"


def test_of_two_jobs_the_one_that_takes_the_memory_ends(tmp_path: Path) -> None:
    does = "kept = bytearray((700 if task.job == 'job_large' else 1) << 20); time.sleep(600)"
    with (
        closing(processes(does, most_bytes=600 << 20)) as started,
        running(started, task_in(tmp_path, "job_small")) as small,
    ):
        with running(started, task_in(tmp_path, "job_large")) as large, pytest.raises(EdgeError) as ended:
            list(large.steps())
        assert ended.value.code == "OUT_OF_MEMORY"
        small.tick(0.0)
        assert psutil.pid_exists(small.number)


@pytest.mark.slow
def test_the_worker_itself_maps_no_decoder(tmp_path: Path) -> None:
    """A process like the worker runs a job of a cloud: what reads it is in the job's process alone."""
    archive = tmp_path / "capture.zip"
    xyz, rgb, normals = captures.sphere()
    with zipfile.ZipFile(archive, "w") as packed:
        packed.writestr("scan.ply", captures.ply_bytes(xyz, rgb, normals))
    done = subprocess.run(
        [sys.executable, "-c", WORKER, str(archive), str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == ["['preview']", "[]"]
