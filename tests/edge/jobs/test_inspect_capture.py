"""Inspections run in a child process: one that costs too much, crashes or is not wanted any more harms nobody else."""

from __future__ import annotations

import resource
import zipfile
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path

import psutil
import pytest

from capture2vr.edge.arrays import no_tick
from capture2vr.edge.errors import Cancelled, CaptureError
from capture2vr.edge.jobs.inspect_capture import Inspector
from capture2vr.edge.jobs.reading_limits import limited_reading
from capture2vr.process.fork_client import ForkServer
from tests.bench.load.attack_files import obj_of_materials, ply_of_one_face
from tests.support import captures
from tests.support.command_lines import children_running


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


SCRIPTED = """
import os, socket, sys
from capture2vr.edge.jobs import inspection_work, reading_limits
from capture2vr.process import fork_server
def inspect(folder, box):
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
