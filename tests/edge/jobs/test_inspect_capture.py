"""Inspections run in a child process: one that costs too much, crashes or is not wanted any more harms nobody else."""

from __future__ import annotations

import resource
import zipfile
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path

import cv2
import grpc
import numpy as np
import psutil
import pytest

from capture2vr.edge.arrays import no_tick
from capture2vr.edge.errors import Cancelled, CaptureError
from capture2vr.edge.jobs.inspect_capture import Inspector
from capture2vr.edge.jobs.reading_limits import limited_reading
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.process.fork_client import ForkServer
from tests.bench.load.attack_files import obj_of_materials, ply_of_one_face
from tests.edge.jobs.test_forward_job import process
from tests.support import captures
from tests.support.command_lines import children_running
from tests.support.patience import PATIENCE_S
from tests.support.workers.edge_client import Client, upload


def packed(folder: Path, **files: bytes) -> Path:
    archive = folder / "capture.zip"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_STORED) as entries:
        for name, content in files.items():
            entries.writestr(name.replace("__", "."), content)
    return archive


def scratch_in(folder: Path) -> Path:
    scratch = folder / "work"
    scratch.mkdir()
    return scratch


@pytest.fixture(scope="module")
def inspector() -> Iterator[Inspector]:
    with closing(Inspector()) as made:
        yield made


def test_a_capture_is_described_by_the_child(inspector: Inspector, tmp_path: Path) -> None:
    xyz, rgb, normals = captures.sphere()
    archive = packed(tmp_path, a__ply=captures.ply_bytes(xyz, rgb, normals))
    found = inspector.inspect(archive, scratch_in(tmp_path), None, no_tick)
    assert (found.kind, found.format, found.points) == ("points", "ply", len(xyz))


def test_a_face_of_two_million_corners_costs_no_more_than_its_triangles(inspector: Inspector, tmp_path: Path) -> None:
    inspector.start()
    (server,) = children_running("capture2vr.edge.jobs.inspection_work")
    before = server.cpu_times()
    archive = packed(tmp_path, a__ply=ply_of_one_face(2_000_000))
    found = inspector.inspect(archive, scratch_in(tmp_path), None, no_tick)
    used = server.cpu_times()
    assert not found.HasField("failure"), found.failure
    assert used.children_user + used.children_system - before.children_user - before.children_system < 10


@pytest.mark.parametrize(
    ("name", "content", "code"),
    [
        ("a__ply", lambda: ply_of_one_face(5_100_000), "CAPTURE_TOO_LARGE"),
        ("a__obj", lambda: obj_of_materials(8_000), "CAPTURE_TOO_LARGE"),
        ("a__xyz", lambda: b"1 2 3\n" + b"0.1 " * 400_000, "CAPTURE_UNREADABLE"),
    ],
)
def test_what_would_cost_much_is_refused_before(
    inspector: Inspector, tmp_path: Path, name: str, content: Callable[[], bytes], code: str
) -> None:
    failure = inspector.inspect(packed(tmp_path, **{name: content()}), scratch_in(tmp_path), None, no_tick).failure
    assert (failure.code, failure.file) == (code, name.replace("__", "."))
    assert failure.hints


def photo_archive(folder: Path) -> Path:
    """A blue rectangle before a light wall."""
    picture = np.full((240, 320, 3), 215, np.uint8)
    picture[60:180, 100:220] = 30, 60, 170
    return packed(folder, a__png=cv2.imencode(".png", picture)[1].tobytes())


@pytest.mark.slow
def test_the_models_of_the_worker_are_those_of_an_inspection(tmp_path: Path) -> None:
    """The outline that the capture page shows is then the one that the job cuts along."""
    with closing(Inspector(models=ModelFolder(tmp_path / "gone"))) as inspector:
        found = inspector.inspect(photo_archive(tmp_path), scratch_in(tmp_path), None, no_tick)
    assert found.outline
    assert "without a learned model: the folder of learned models cannot be read" in found.warnings[-1]


@pytest.mark.slow
async def test_the_setting_names_the_models_of_a_worker(tmp_path: Path) -> None:
    with process(tmp_path, EDGE_MODELS=tmp_path / "gone") as started:
        async with grpc.aio.insecure_channel(started.address) as channel:
            sent = upload(photo_archive(tmp_path).read_bytes())
            found = await Client(channel).stub.Inspect(sent, wait_for_ready=True, timeout=PATIENCE_S)
    assert "without a learned model" in found.warnings[-1]


SCRIPTED = """
import os, socket, sys
from capture2vr.edge.jobs import inspection_work, reading_limits
from capture2vr.process import fork_server
def inspect(folder, box, models):
    {costly}
inspection_work.inspect = inspect
reading_limits._LEAST_BYTES, reading_limits._LEAST_SECONDS = 1 << 29, 2
fork_server.serve(socket.socket(fileno=int(sys.argv[1])), inspection_work.work)
"""


def scripted(costly: str) -> Inspector:
    return Inspector(ForkServer("-c", SCRIPTED.format(costly=costly)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("costly", "code", "says"),
    [
        ("bytearray(1 << 32)", "CAPTURE_TOO_LARGE", "more memory"),
        ("while True: pass", "CAPTURE_TOO_LARGE", "more time"),
        ("os.abort()", "CAPTURE_UNREADABLE", "SIGABRT"),
    ],
)
def test_what_costs_too_much_or_crashes_is_told(tmp_path: Path, costly: str, code: str, says: str) -> None:
    with closing(scripted(costly)) as inspector:
        try:
            failure = inspector.inspect(packed(tmp_path, a__ply=b"ply"), scratch_in(tmp_path), None, no_tick).failure
            told = (failure.code, failure.message)
        except CaptureError as error:
            told = (error.code, error.message)
    assert told[0] == code
    assert says in told[1]


@pytest.mark.slow
def test_an_inspection_that_nobody_waits_for_is_killed(tmp_path: Path) -> None:
    def leave(_: float) -> None:
        raise Cancelled

    before = {each.pid for each in psutil.Process().children(recursive=True)}
    with closing(scripted("import time; time.sleep(600)")) as inspector:
        with pytest.raises(Cancelled):
            inspector.inspect(packed(tmp_path, a__ply=b"ply"), scratch_in(tmp_path), None, leave)
        (server,) = (each for each in psutil.Process().children() if each.pid not in before)
        assert server.children() == []


@pytest.mark.slow
@pytest.mark.parametrize("end", ["os.abort()", "pass"])
def test_temporary_files_lie_in_the_inspections_own_folder(tmp_path: Path, end: str) -> None:
    """Even of one that is killed: who inspects removes that folder."""
    write = "import tempfile, subprocess; tempfile.mkdtemp(prefix='own-')"
    child = "subprocess.run([sys.executable, '-c', 'import tempfile; tempfile.mkdtemp(prefix=\"childs-\")'])"
    scratch = scratch_in(tmp_path)
    with closing(scripted(f"{write}; {child}; {end}")) as inspector, suppress(CaptureError, RuntimeError):
        inspector.inspect(packed(tmp_path, a__ply=b"ply"), scratch, None, no_tick)
    assert {path.name.partition("-")[0] for path in scratch.glob("*-*")} == {"own", "childs"}


@pytest.mark.slow
def test_a_fault_of_ours_is_an_error_with_its_traceback(tmp_path: Path) -> None:
    with closing(scripted("raise KeyError('MPO')")) as inspector, pytest.raises(RuntimeError, match="KeyError: 'MPO'"):
        inspector.inspect(packed(tmp_path, a__ply=b"ply"), scratch_in(tmp_path), None, no_tick)


def test_limits_grow_with_the_capture_and_end_with_the_reading(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limits: dict[int, int] = {}
    monkeypatch.setattr(resource, "setrlimit", lambda kind, pair: limits.update({kind: pair[0]}))
    used = resource.getrusage(resource.RUSAGE_SELF)
    seconds = int(used.ru_utime + used.ru_stime) + 1
    before = {kind: resource.getrlimit(kind)[0] for kind in (resource.RLIMIT_DATA, resource.RLIMIT_CPU)}
    seen = []
    for size in (0, 10**8, 10**9):
        with (tmp_path / "scan.ply").open("wb") as file:
            file.truncate(size)
        with limited_reading(tmp_path):
            seen.append((limits[resource.RLIMIT_DATA], limits[resource.RLIMIT_CPU] - seconds))
        assert limits == before
    assert seen == sorted(seen)
    assert seen[0] == (1 << 30, pytest.approx(20, abs=2))
    assert seen[-1] == (6 << 30, pytest.approx(120, abs=2))
