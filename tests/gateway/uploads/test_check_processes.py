"""Each upload is checked in a process of its own: what it costs is limited, and nothing of it is left."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import psutil
import pytest

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.uploads.check_and_pack import CheckOrder
from capture2vr.gateway.uploads.check_processes import CheckProcesses
from capture2vr.process.fork_client import ForkServer
from tests.support.patience import PATIENCE_S

CLOUD = b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n"

# The server, with a check that does something else, and limits that are reached soon.
SCRIPTED = """
import errno, os, signal, socket, sys, time
from capture2vr.process import fork_server
from capture2vr.gateway.uploads import check_work, process_limits
def check_and_pack(order, begin):
    begin("a.ply")
    {does}
check_work.check_and_pack = check_and_pack
check_work._LEAST_SECONDS = 0.0
check_work._MOST_DATA_BYTES = 200 << 20
process_limits._SLOWED, process_limits._DISK_SECONDS = 0.0, {seconds}
fork_server.serve(socket.socket(fileno=int(sys.argv[1])), check_work.work)
"""


def order(folder: Path, **files: bytes) -> CheckOrder:
    (folder / "in").mkdir(parents=True)
    for name, content in files.items():
        (folder / "in" / name.replace("__", ".")).write_bytes(content)
    return CheckOrder(str(folder), [name.replace("__", ".") for name in files], True, 100, 1 << 30)


class Below(CheckProcesses):
    """The checks of a test, and the processes that they have started."""

    def __init__(self, server: ForkServer | None = None) -> None:
        super().__init__(server)
        self._others = set(self._servers())

    def server(self) -> psutil.Process | None:
        """The server, where it runs."""
        return next(iter(set(self._servers()) - self._others), None)

    def running(self) -> list[psutil.Process]:
        """The checks that run now."""
        server = self.server()
        return server.children() if server else []

    async def until_running(self, count: int) -> None:
        async with asyncio.timeout(PATIENCE_S):
            while len(self.running()) != count:
                await asyncio.sleep(0.01)

    @staticmethod
    def _servers() -> list[psutil.Process]:
        return psutil.Process().children()


@pytest.fixture
def checks() -> Iterator[Below]:
    made = Below()
    yield made
    made.close()
    assert made.server() is None


async def test_a_capture_is_packed_by_another_process(checks: Below, tmp_path: Path) -> None:
    packed = await checks.check(order(tmp_path, a__ply=CLOUD))
    assert packed.archive.stat().st_size > len(CLOUD)
    assert [(each.file, each.verdict) for each in packed.verdicts] == [("a.ply", "ok")]
    await checks.until_running(0)


def scripted(does: str, *, seconds: float = 60.0) -> ForkServer:
    return ForkServer("-c", SCRIPTED.format(does=does, seconds=seconds))


@pytest.mark.parametrize(
    ("does", "status", "code", "words"),
    [
        ("while True: pass", 422, "CAPTURE_TOO_LARGE", "time"),
        ("time.sleep(600)", 422, "CAPTURE_TOO_LARGE", "time"),
        ("bytearray(1 << 30)", 422, "CAPTURE_TOO_LARGE", "memory"),
        ("os.kill(os.getpid(), signal.SIGSEGV)", 422, "CAPTURE_UNREADABLE", "SIGSEGV"),
        ("os.kill(os.getpid(), signal.SIGABRT)", 422, "CAPTURE_UNREADABLE", "SIGABRT"),
        ("os._exit(7)", 422, "CAPTURE_UNREADABLE", "status 7"),
        ("raise OSError(errno.ENOSPC, 'full')", 507, "STORAGE_FULL", "full"),
        ("os.kill(os.getppid(), signal.SIGKILL); os._exit(0)", 503, "CHECK_INTERRUPTED", "interrupted"),
    ],
)
async def test_a_check_that_costs_too_much_or_crashes_is_a_problem_that_names_the_file(
    does: str,
    status: int,
    code: str,
    words: str,
    tmp_path: Path,
) -> None:
    server = scripted(does, seconds=1.0 if "sleep(600)" in does else 60.0)
    with pytest.raises(Problem) as caught, closing(CheckProcesses(server)) as checks:
        await checks.check(order(tmp_path, a__ply=CLOUD))
    problem = caught.value
    assert (problem.status, problem.code) == (status, code), problem.detail
    assert words in problem.detail
    assert problem.hints
    if code.startswith("CAPTURE"):
        assert problem.file == "a.ply"


async def test_a_fault_of_ours_is_an_internal_error_with_its_traceback(tmp_path: Path) -> None:
    with (
        closing(CheckProcesses(scripted("raise KeyError('MPO')"))) as checks,
        pytest.raises(RuntimeError, match="KeyError: 'MPO'"),
    ):
        await checks.check(order(tmp_path, a__ply=CLOUD))


async def test_what_a_check_costs_is_counted_even_if_its_client_leaves(tmp_path: Path) -> None:
    spent: list[float] = []
    busy = "until = time.process_time() + 0.3\n    while time.process_time() < until: pass\n    time.sleep(600)"
    with closing(CheckProcesses(scripted(busy))) as checks:
        checking = asyncio.create_task(checks.check(order(tmp_path, a__ply=CLOUD), spent.append))
        await asyncio.sleep(1.5)
        checking.cancel()
        await asyncio.gather(checking, return_exceptions=True)
    assert 0.3 <= sum(spent) < 2.0


async def test_a_client_that_leaves_ends_its_check(checks: Below, tmp_path: Path) -> None:
    """A pipe that nobody writes to: whoever opens it waits, in the kernel, where no exception can reach."""
    what = order(tmp_path, a__ply=b"", b__ply=CLOUD)
    (tmp_path / "in" / "a.ply").unlink()
    os.mkfifo(tmp_path / "in" / "a.ply")
    checking = asyncio.create_task(checks.check(what))
    await checks.until_running(1)
    checking.cancel()
    with pytest.raises(asyncio.CancelledError):
        await checking
    await checks.until_running(0)


async def test_a_server_that_was_killed_is_started_again(checks: Below, tmp_path: Path) -> None:
    await checks.check(order(tmp_path / "1", a__ply=CLOUD))
    await checks.until_running(0)
    server = checks.server()
    assert server is not None
    server.send_signal(signal.SIGKILL)
    server.wait(PATIENCE_S)
    assert (await checks.check(order(tmp_path / "2", a__ply=CLOUD))).sha256


WAITING = """
import os, socket, sys, time
from capture2vr.process import fork_server
def work(order, talk):
    talk.send({"begun": True})
    while not os.path.exists(order["until"]):
        time.sleep(0.01)
fork_server.serve(socket.socket(fileno=int(sys.argv[1])), work)
"""


def test_work_that_is_called_off_as_it_ends_harms_no_other(tmp_path: Path) -> None:
    """The server hears of both at once: it was busy, as while it starts other work."""
    before = {each.pid for each in psutil.Process().children()}
    with closing(ForkServer("-c", WAITING)) as server:
        ending, other = server.fork(), server.fork()
        for forked, name in ((ending, "ending"), (other, "other")):
            forked.channel.sendall(json.dumps({"until": str(tmp_path / name)}).encode() + b"\n")
            assert b"begun" in forked.channel.recv(1 << 16)
        (process,) = (each for each in psutil.Process().children() if each.pid not in before)
        process.suspend()
        (tmp_path / "ending").touch()
        until_zombie(process)
        os.close(ending.leash)
        process.resume()
        (tmp_path / "other").touch()
        with other.channel, other.channel.makefile() as said:
            assert json.loads(said.readline())["ended"] == 0
        ending.channel.close()
        os.close(other.leash)


def until_zombie(server: psutil.Process) -> None:
    """Wait until work has ended that the server has not heard of."""
    deadline = time.monotonic() + PATIENCE_S
    while all(each.status() != psutil.STATUS_ZOMBIE for each in server.children()):
        assert time.monotonic() < deadline
        time.sleep(0.01)


async def test_more_checks_than_run_at_once_all_end(checks: Below, tmp_path: Path) -> None:
    orders = [order(tmp_path / str(number), a__ply=CLOUD) for number in range(20)]
    packed = await asyncio.gather(*map(checks.check, orders))
    assert len({each.sha256 for each in packed}) == 1
    assert all(each.archive.exists() for each in packed)


async def test_the_processes_know_no_secret(checks: Below, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STORAGE_SECRET_KEY", "do-not-tell")
    monkeypatch.setenv("GATEWAY_EDGE_TOKEN", "do-not-tell")
    await checks.check(order(tmp_path, a__ply=CLOUD))
    server = checks.server()
    assert server is not None
    assert "do-not-tell" not in server.environ().values()


def test_an_app_that_is_dropped_leaves_no_process() -> None:
    checks = Below()
    checks.start()
    server = checks.server()
    assert server is not None
    del checks
    assert not server.is_running()
