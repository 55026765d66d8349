"""Every engine runs tasks, passes on how they end, and loses none with a process or a machine."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from capture2vr.edge.engine.address import check_engine, open_engine
from capture2vr.edge.engine.local_engine import LocalEngine
from capture2vr.edge.engine.nouns import Needs, Submitted, wait_for_all
from capture2vr.edge.errors import Cancelled, EdgeError
from tests.conftest import missing
from tests.support.network import own_network
from tests.support.patience import HANG_S
from tests.support.repository import ROOT
from tests.support.workers import engine_tasks

pytestmark = pytest.mark.slow

ONE = Needs(cpus=1)
CANCELLED = {"type": "Cancelled"}


def story(kind: str) -> dict[str, Any]:
    """What `engine_story.py` tells of an engine."""
    module = "tests.support.workers.engine_story"
    command: list[str] | None = [sys.executable, "-m", module, kind]
    if kind == "ray":
        command = own_network.command(module, kind)
    if command is None:
        missing("the right to make a network namespace")
    assert command is not None
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def need_ray() -> None:
    if importlib.util.find_spec("ray") is None:
        missing("Ray")


@pytest.fixture(scope="module")
def local_story() -> dict[str, Any]:
    return story("local")


@pytest.fixture(scope="module")
def ray_story() -> dict[str, Any]:
    """Of a head and two nodes."""
    need_ray()
    return story("ray")


@pytest.fixture(params=[pytest.param("local", marks=pytest.mark.essential), "ray"])
def told(request: pytest.FixtureRequest) -> dict[str, Any]:
    found: dict[str, Any] = request.getfixturevalue(f"{request.param}_story")
    return found


def test_results_come_back_and_large_inputs_arrive(told: dict[str, Any]) -> None:
    assert told["doubles"] == [0, 2, 4, 6, 8]
    assert told["digest is right"]


def test_an_error_is_raised_where_the_result_is_awaited(told: dict[str, Any]) -> None:
    assert told["fail"] == {
        "type": "CaptureError",
        "code": "CAPTURE_EMPTY",
        "message": "has nothing in it",
        "file": "a.ply",
        "hints": ["choose the files again, and check that they are not empty"],
        "retryable": True,
    }
    assert (told["unsendable"]["code"], told["unsendable"]["message"]) == (
        "TASK_FAILED",
        "Unsendable: holds a function",
    )


def test_a_task_that_is_killed_each_time_fails_by_name(told: dict[str, Any]) -> None:
    assert (told["die"]["code"], told["die"]["retryable"], told["deaths"]) == ("TASK_LOST", True, 4)


def test_what_is_cancelled_is_killed_and_leaves_its_place(told: dict[str, Any]) -> None:
    assert told["cancelled"] == {"fraction": 0.25, "ends": [CANCELLED] * 6, "after": 8}


def test_a_task_runs_where_the_gpu_is(ray_story: dict[str, Any]) -> None:
    assert ray_story["gpu"] == "0"


def test_captures_are_reconstructed_on_the_cluster(ray_story: dict[str, Any]) -> None:
    ran = ray_story["captures"]
    assert ran["status"] == 0, ran["said"]
    assert ran["states"] == {"leaf": "preview", "twig": "preview"}


def test_no_worker_imports_from_the_folder_where_ray_was_started(ray_story: dict[str, Any]) -> None:
    assert ray_story["strangers"] == []


def test_a_scene_is_made_on_the_cluster(ray_story: dict[str, Any]) -> None:
    scene = ray_story["scene"]
    assert scene["status"] == 0, scene["said"]
    assert scene["tiles"] == 2


def test_tiles_are_meshed_as_here(ray_story: dict[str, Any]) -> None:
    assert ray_story["tiles are the same"]


def test_nothing_is_lost_with_a_node(ray_story: dict[str, Any]) -> None:
    lost = ray_story["lost node"]
    assert lost["results"] == list(range(6))
    assert lost["begun"][-1] == 2, "what ran on the node was begun again"


def test_a_lost_head_is_named(ray_story: dict[str, Any]) -> None:
    for said in (*ray_story["lost head"].values(), ray_story["no head"]):
        assert said["code"] == "ENGINE_LOST"
        assert "the Ray head at ray://127.0.0.1:10001 cannot be reached" in said["message"]
    assert ray_story["no head"]["retryable"]


def test_a_result_that_cannot_be_read_leaves_nobody_waiting(ray_story: dict[str, Any]) -> None:
    told = ray_story["unreadable"]
    assert (told["itself"]["code"], told["itself"]["retryable"]) == ("ENGINE_LOST", True)
    assert "there is no such thing here" in told["itself"]["message"]
    assert told["later"]["code"] == "ENGINE_LOST"
    assert told["all have ended"]


def until_begun(folder: Path, count: int) -> None:
    deadline = time.monotonic() + HANG_S
    while len(list(folder.glob("begun-*"))) < count:
        assert time.monotonic() < deadline
        time.sleep(0.02)


def waiting(engine: LocalEngine, needs: Needs, folder: Path, number: int) -> Submitted[int]:
    return engine.submit(needs, engine_tasks.wait, str(folder), number)


def test_tasks_share_the_room_of_this_machine_in_their_order(tmp_path: Path) -> None:
    """Two of one core run at once; one that needs all memory waits for them, and the one behind it for that."""
    engine = LocalEngine(Needs(cpus=2, gpus=1, memory_bytes=100))
    try:
        small = [waiting(engine, Needs(1, 0, 40), tmp_path, number) for number in (0, 1)]
        large = waiting(engine, Needs(1, 0, 1_000), tmp_path, 2)  # more than there is: it runs alone
        behind = waiting(engine, Needs(1, 0, 50), tmp_path, 3)
        until_begun(tmp_path, 2)
        assert {path.name for path in tmp_path.iterdir()} == {"begun-0", "begun-1"}
        (tmp_path / "go").touch()
        fractions: list[float] = []
        wait_for_all([*small, large, behind], fractions.append)
        assert [task.result(0) for task in (*small, large, behind)] == [0, 1, 2, 3]
        assert all(0 <= fraction <= 1 for fraction in fractions)
        times = [path.stat().st_mtime for path in sorted(tmp_path.glob("begun-*"))]
        assert max(times[:2]) <= times[2] <= times[3]
    finally:
        engine.close()


def test_who_stops_waiting_stops_the_tasks(tmp_path: Path) -> None:
    def give_up(fraction: float) -> None:
        raise Cancelled

    with open_engine("local", ONE) as engine:
        tasks = [engine.submit(ONE, engine_tasks.wait, str(tmp_path), number) for number in range(3)]
        with pytest.raises(Cancelled):
            wait_for_all(tasks, give_up)
        assert all(isinstance(task.future.exception(), Cancelled) for task in tasks)


def test_a_closed_engine_takes_nothing(tmp_path: Path) -> None:
    engine = LocalEngine(Needs(cpus=1))
    runs, waits = (waiting(engine, ONE, tmp_path, number) for number in (0, 1))
    engine.close()
    for task in (runs, waits):
        with pytest.raises(Cancelled):
            task.result(HANG_S)
    with pytest.raises(EdgeError, match="closed"):
        engine.submit(ONE, engine_tasks.double, 1)


def test_each_task_has_the_threads_that_it_asked_for() -> None:
    with open_engine("local", ONE) as engine:
        assert engine.submit(ONE, engine_tasks.environment, "OMP_NUM_THREADS").result(HANG_S) == "1"


@pytest.mark.parametrize("setting", ["local", "ray://head.example:10001", "ray://10.0.0.7:10001", "ray://[::1]:10001"])
def test_the_setting_names_an_engine(setting: str) -> None:
    assert check_engine(setting) == setting


@pytest.mark.parametrize("setting", ["", "ray", "ray://", "ray://head", "http://head:10001", "ray://a b:1", "auto"])
def test_another_setting_is_refused(setting: str) -> None:
    with pytest.raises(ValueError, match=r"local, or ray://host:port"):
        check_engine(setting)


def test_ray_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "capture2vr.edge.engine.ray_engine", raising=False)
    with pytest.raises(EdgeError, match="needs Ray") as raised, open_engine("ray://head:10001", ONE):
        pass
    assert (raised.value.code, raised.value.hints) == ("ENGINE_MISSING", ("pip install 'capture2vr[ray]'",))
