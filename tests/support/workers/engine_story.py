"""What an engine does in a few tasks, as JSON: `python -m tests.support.workers.engine_story local | ray`.

A process of its own, because Ray's client is one for a process, and because of the network that it needs.
"""

from __future__ import annotations

import json
import os
import secrets
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from capture2vr.edge.arrays import no_tick
from capture2vr.edge.engine.address import LOCAL, open_engine
from capture2vr.edge.engine.nouns import Engine, Needs, Submitted, wait_for_all
from capture2vr.edge.errors import Cancelled, EdgeError
from capture2vr.edge.tiles.mesh_tile import mesh_tile
from capture2vr.edge.tiles.parts import PART_NEEDS
from tests.edge.tiles.hall import GRID, hall
from tests.support.clouds import write_ply
from tests.support.patience import HANG_S
from tests.support.strangers import that_ran
from tests.support.workers import engine_tasks
from tests.support.workers.ray_cluster import ADDRESS, RayCluster, running

_MEMORY = 1 << 30
_ONE = Needs(cpus=1, memory_bytes=_MEMORY // 4)


def until(holds: Callable[[], Any]) -> Any:
    """What a condition returns once it holds."""
    deadline = time.monotonic() + HANG_S
    while not (found := holds()):
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.02)
    return found


def lives(pid: int) -> bool:
    """Whether a process runs; one that has ended may stay a zombie where nobody asks for its status."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def error_of(task: Submitted[Any]) -> dict[str, Any]:
    try:
        return {"result": task.result(HANG_S)}
    except EdgeError as error:
        return {
            "type": type(error).__name__,
            "code": error.code,
            "message": error.message,
            "file": error.file,
            "hints": error.hints,
            "retryable": error.retryable,
        }
    except Cancelled:
        return {"type": "Cancelled"}


def tell(engine: Engine, folder: Path) -> dict[str, Any]:
    """What holds for every engine."""
    data = os.urandom(3_000_000)
    said: dict[str, Any] = {}
    doubles = [engine.submit(_ONE, engine_tasks.double, number) for number in range(5)]
    said["doubles"] = [task.result(HANG_S) for task in doubles]
    said["digest is right"] = engine.submit(_ONE, engine_tasks.digest, data).result(HANG_S) == engine_tasks.digest(
        lambda _: None, data
    )
    said["fail"] = error_of(engine.submit(_ONE, engine_tasks.fail, "a.ply"))
    said["unsendable"] = error_of(engine.submit(_ONE, engine_tasks.fail_unsendable))
    said["die"] = error_of(engine.submit(_ONE, engine_tasks.die, str(folder / "died")))
    said["deaths"] = len((folder / "died").read_text().split())
    said["cancelled"] = cancel(engine, folder / "cancel")
    return said


def cancel(engine: Engine, folder: Path) -> dict[str, Any]:
    """Cancel tasks that run and one that waits; the place is free then."""
    folder.mkdir()
    tasks = [engine.submit(_ONE, engine_tasks.wait, str(folder), number) for number in range(6)]
    until(lambda: list(folder.glob("begun-*")))
    fraction = until(lambda: max(task.fraction for task in tasks))
    for task in tasks:
        task.cancel()
    pids = [int(pid) for file in folder.glob("begun-*") for pid in file.read_text().split()]
    until(lambda: not any(map(lives, pids)))
    return {
        "fraction": fraction,
        "ends": [error_of(task) for task in tasks],
        "after": engine.submit(_ONE, engine_tasks.double, 4).result(HANG_S),
    }


def run_captures(folder: Path, strangers: Path) -> dict[str, Any]:
    """What `capture2vr run` of two captures says, started among a stranger's modules, and what it has written."""
    folder.mkdir()
    xyz = np.random.default_rng(2).normal(size=(500, 3)) * [0.02, 0.0, 0.1]
    captures = [str(write_ply(folder / f"{name}.ply", xyz)) for name in ("leaf", "twig")]
    program = Path(sys.executable).with_name("capture2vr")
    command = [program, "run", *captures, "-o", folder / "out", "--preset", "draft"]
    environment = {**os.environ, "EDGE_ENGINE": ADDRESS}
    done = subprocess.run(command, cwd=strangers, env=environment, capture_output=True, text=True)
    reports = (folder / "out").glob("*/report.json")
    return {
        "status": done.returncode,
        "said": done.stderr,
        "states": {path.parent.name: json.loads(path.read_text())["state"] for path in reports},
    }


def run_scene(folder: Path) -> dict[str, Any]:
    """What `capture2vr run` makes of a scene of two tiles, in a process of its own."""
    folder.mkdir()
    scene = write_ply(folder / "hall.ply", hall())
    command = [sys.executable, "-m", "capture2vr.cli", "run", str(scene), "-o", str(folder / "out")]
    flags = ["--preset", "scene-tiles", "--resolution", "500"]
    done = subprocess.run(
        [*command, *flags], env={**os.environ, "EDGE_ENGINE": ADDRESS}, capture_output=True, text=True
    )
    report = folder / "out" / "report.json"
    tiles = json.loads(report.read_text())["tileset"]["tiles"] if report.exists() else 0
    return {"status": done.returncode, "said": done.stderr, "tiles": tiles}


def lose_a_node(engine: Engine, cluster: RayCluster, folder: Path) -> dict[str, Any]:
    """Kill a node while both work: what ran there runs again, and all results are there."""
    folder.mkdir()
    tasks = [engine.submit(_ONE, engine_tasks.wait, str(folder), number) for number in range(6)]
    until(lambda: len(list(folder.glob("begun-*"))) == 2)
    pids = [int(file.read_text()) for file in folder.glob("begun-*")]
    cluster.kill("one")
    until(lambda: not all(map(lives, pids)))
    (folder / "go").touch()
    wait_for_all(tasks, lambda _: None)
    begun = [len(file.read_text().split()) for file in folder.glob("begun-*")]
    return {"results": [task.result(0) for task in tasks], "begun": sorted(begun)}


def mesh_tiles(engine: Engine) -> bool:
    """Whether the tiles of a hall that the engine meshes are to the last bit those that are meshed here."""
    cells, tiles = hall(), [(0, 0, 0), (1, 0, 0)]
    tasks = [engine.submit(PART_NEEDS, mesh_tile, cells, GRID, tile, 0.0) for tile in tiles]
    made = [task.result(HANG_S) for task in tasks]
    here = [mesh_tile(no_tick, cells, GRID, tile) for tile in tiles]
    return all(
        len(one.faces) > 100 and np.array_equal(one.vertices, other.vertices) and np.array_equal(one.faces, other.faces)
        for one, other in zip(made, here, strict=True)
    )


def read_the_unreadable(engine: Engine) -> dict[str, Any]:
    """Whether a result that nobody can read ends its task, one beside it, and whoever comes later."""
    tasks = [engine.submit(_ONE, work) for work in (engine_tasks.unreadable, engine_tasks.version)]
    ends = {"itself": error_of(tasks[0])}
    try:
        ends["later"] = error_of(engine.submit(_ONE, engine_tasks.version))
    except EdgeError as error:
        ends["later"] = {"code": error.code, "retryable": error.retryable}
    return ends | {"all have ended": tasks[1].future.done()}


def lose_the_head(engine: Engine, cluster: RayCluster, folder: Path) -> dict[str, Any]:
    folder.mkdir()
    task = engine.submit(_ONE, engine_tasks.wait, str(folder), 1)
    until(lambda: list(folder.glob("begun-*")))
    cluster.kill("head")
    said = {"while it runs": error_of(task)}
    try:
        engine.submit(_ONE, engine_tasks.double, 1)
    except EdgeError as error:
        said["afterwards"] = {"code": error.code, "message": error.message}
    return said


def on_a_cluster(folder: Path) -> dict[str, Any]:
    os.environ["RAY_CLIENT_RECONNECT_GRACE_PERIOD"] = "3"
    os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(16)}
    with running() as cluster:
        cluster.start_nodes(one="--num-gpus=1", two="")
        with open_engine(ADDRESS, Needs()) as engine:
            unreadable = read_the_unreadable(engine)
        with open_engine(ADDRESS, Needs()) as engine:
            said = tell(engine, folder) | {"unreadable": unreadable}
            needs = Needs(cpus=0.5, gpus=0.5)
            gpu = engine.submit(needs, engine_tasks.environment, "CUDA_VISIBLE_DEVICES")
            said["gpu"] = gpu.result(HANG_S)
            said["captures"] = run_captures(folder / "captures", cluster.strangers)
            said["scene"] = run_scene(folder / "scene")
            said["tiles are the same"] = mesh_tiles(engine)
            said["lost node"] = lose_a_node(engine, cluster, folder / "node")
            said["lost head"] = lose_the_head(engine, cluster, folder / "head")
        said["strangers"] = that_ran(cluster.strangers)
    said["no head"] = nobody_there()
    return said


def nobody_there() -> dict[str, Any]:
    try:
        with open_engine(ADDRESS, Needs()):
            return {}
    except EdgeError as error:
        return {"code": error.code, "message": error.message, "retryable": error.retryable}


def main(kind: str) -> None:
    with tempfile.TemporaryDirectory(prefix="engine-") as folder:
        if kind == LOCAL:
            with open_engine(LOCAL, Needs(os.cpu_count() or 1, 1, _MEMORY)) as engine:
                said = tell(engine, Path(folder))
        else:
            said = on_a_cluster(Path(folder))
    print(json.dumps(said))


if __name__ == "__main__":
    main(sys.argv[1])
