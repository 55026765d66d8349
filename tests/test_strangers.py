"""Nobody's code but ours is run, whatever modules lie in the folder in which the product is started."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from capture2vr.cli.up import run_stack
from capture2vr.edge.arrays import no_tick
from capture2vr.edge.cameras.learned_matches import find_matches, is_installed
from capture2vr.edge.cameras.sfm_process import solve
from capture2vr.edge.engine.local_engine import LocalEngine
from capture2vr.edge.engine.nouns import Needs
from capture2vr.edge.jobs.make_download import make_download
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.texture.unwrap import unwrap
from capture2vr.order.download_formats import FORMATS
from capture2vr.process.child_start import python_command, start_child
from capture2vr.process.fork_client import ForkServer
from capture2vr.storage.catalogue.downloads import DownloadOrder
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.memory import MemoryStore
from tests.conftest import missing
from tests.edge.cameras.test_learned_matches import problem_of_matches
from tests.edge.cameras.test_structure_from_motion import scene
from tests.referees.ktx2.encoder import ktx2  # noqa: F401 - a fixture is used by its name
from tests.support import captures, surfaces
from tests.support.downloadable import downloadable
from tests.support.patience import HANG_S
from tests.support.repository import ROOT
from tests.support.strangers import strangers_folder, that_ran
from tests.support.workers import engine_tasks

XYZ = np.random.default_rng(3).normal(size=(300, 3)) * [0.2, 0.01, 0.3]
RGB = np.random.default_rng(4).integers(0, 256, (300, 3)).astype(np.uint8)


@pytest.fixture
def strangers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, which is full of a stranger's modules."""
    folder = strangers_folder(tmp_path / "strangers")
    monkeypatch.chdir(folder)
    return folder


def decode_laz(folder: Path) -> None:
    captures.save_las(folder / "scan.laz", XYZ, RGB)
    assert read_capture(folder / "scan.laz").cloud is not None


def decode_e57(folder: Path) -> None:
    captures.save_e57(folder / "scan.e57", [captures.e57_scan(XYZ, RGB)])
    assert read_capture(folder / "scan.e57").cloud is not None


def solve_structure_from_motion(_: Path) -> None:
    assert len(solve(problem_of_matches(np.linspace(-40, 40, 4))).placed) == 4


def match_photos(_: Path) -> None:
    if not is_installed():
        missing("the extra learned-matching")
    assert len(find_matches(scene(3, np.array([0.0, 12.0])), np.array([0, 1])).table)


def unwrap_mesh(_: Path) -> None:
    assert unwrap(surfaces.patch(lambda u, v: [u, v, 0 * u], 9, 9), side=64).charts


def convert_for_download(folder: Path) -> None:
    store, scratch = MemoryStore(), folder / "scratch"
    scratch.mkdir()
    publish(downloadable(), store, key="sheet", job="job_1")
    manifest = read_entry(store, "sheet").document["manifest"]["sha256"]
    assert make_download(store, DownloadOrder("sheet", manifest, FORMATS["obj"]), scratch, no_tick).size


def run_tasks(_: Path) -> None:
    with closing(LocalEngine(Needs(cpus=1))) as engine:
        assert engine.submit(Needs(cpus=1), engine_tasks.double, 21).result(HANG_S) == 42


def fork_from(module: str) -> Callable[[Path], None]:
    def fork(_: Path) -> None:
        with closing(ForkServer.of(module)) as server, server.fork().channel as channel:
            channel.shutdown(socket.SHUT_WR)  # no order: it has nothing to do, and ends
            assert json.loads(channel.recv(100))["ended"] == 0

    return fork


def start_services(folder: Path) -> None:
    with run_stack("127.0.0.1", 0, folder / "data") as stack:
        assert stack.url


CHILDREN = {
    "LAZ": decode_laz,
    "E57": decode_e57,
    "SfM": solve_structure_from_motion,
    "matches": match_photos,
    "unwrap": unwrap_mesh,
    "download": convert_for_download,
    "local engine": run_tasks,
    "upload checks": fork_from("capture2vr.gateway.uploads.check_work"),
    "pictures": fork_from("capture2vr.gateway.pictures.shrink_work"),
    "inspection": fork_from("capture2vr.edge.jobs.inspection_work"),
    "up": start_services,
}


@pytest.mark.essential
@pytest.mark.slow
@pytest.mark.parametrize("child", CHILDREN)
def test_no_child_imports_from_the_current_folder(child: str, strangers: Path, tmp_path: Path) -> None:
    folder = tmp_path / "work"
    folder.mkdir()
    CHILDREN[child](folder)
    assert that_ran(strangers) == []


@pytest.mark.slow
def test_node_does_not_either(strangers: Path, request: pytest.FixtureRequest) -> None:
    encode = request.getfixturevalue("ktx2")
    (strangers / "node_modules" / "ktx2-encoder").mkdir(parents=True)
    (strangers / "node_modules" / "ktx2-encoder" / "index.js").write_text("throw new Error('a stranger')")
    assert encode(np.full((16, 16, 3), 100, np.uint8))
    assert that_ran(strangers) == []


@pytest.mark.essential
@pytest.mark.slow
def test_the_command_line_does_not_either(strangers: Path, tmp_path: Path) -> None:
    captures.save_las(tmp_path / "scan.laz", XYZ, RGB)
    command = [Path(sys.executable).with_name("capture2vr"), "run", tmp_path / "scan.laz", "-o", tmp_path / "out"]
    ended = subprocess.run([*command, "--preset", "draft"], capture_output=True, text=True, timeout=HANG_S)
    assert ended.returncode == 0, ended.stderr
    assert that_ran(strangers) == []


def test_the_stranger_is_heard_where_nothing_keeps_him_out(strangers: Path) -> None:
    assert subprocess.run([sys.executable, "-m", "capture2vr"], capture_output=True).returncode != 0
    assert that_ran(strangers)


def test_what_a_child_starts_in_turn_does_not_either(strangers: Path) -> None:
    code = "import subprocess, sys; sys.exit(subprocess.run([sys.executable, '-c', 'import json']).returncode)"
    with start_child(python_command("-c", code), environment={"PATH": os.environ["PATH"]}) as child:
        assert child.wait(HANG_S) == 0
    assert that_ran(strangers) == []


def test_one_place_starts_all_processes() -> None:
    starting = re.compile(
        r"subprocess\.(Popen|run|call|check_\w+)\(|sys\.executable|create_subprocess_|os\.(exec|spawn|posix_spawn)"
    )
    product = (ROOT / "services").rglob("*.py")
    assert [path.name for path in product if starting.search(path.read_text(encoding="utf-8"))] == ["child_start.py"]
