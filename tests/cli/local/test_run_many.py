"""`run` of several captures: each in a folder of its own, and one that is bad spoils no other."""

from __future__ import annotations

import importlib.util
import json
import os
from pathlib import Path

import numpy as np
import pytest

from tests.cli.local.test_run import capture2vr
from tests.conftest import missing
from tests.support.clouds import write_ply

pytestmark = pytest.mark.slow

DRAFT = ("--preset", "draft", "--resolution", "24")


@pytest.fixture
def leaves(tmp_path: Path) -> list[Path]:
    """A leaf in a file, one in a folder, and a file that is none."""
    xyz = np.random.default_rng(2).normal(size=(500, 3)) * [0.02, 0.0, 0.1]
    (tmp_path / "b").mkdir()
    bad = tmp_path / "bad.ply"
    bad.write_bytes(b"no ply")
    return [write_ply(tmp_path / "a leaf.ply", xyz), write_ply(tmp_path / "b" / "twig.ply", xyz).parent, bad]


def test_each_has_its_folder_and_a_bad_one_is_named(leaves: list[Path], tmp_path: Path) -> None:
    done = capture2vr("run", *leaves, "-o", tmp_path / "out", *DRAFT)
    assert done.returncode == 1, done.stderr
    assert "bad: bad.ply" in done.stderr
    assert "Traceback" not in done.stderr
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"a-leaf", "b"}
    for key in ("a-leaf", "b"):
        report = json.loads((tmp_path / "out" / key / "report.json").read_text())
        assert (report["key"], report["state"]) == (key, "preview")
        assert (tmp_path / "out" / key / "lod0.glb").is_file()
    (tmp_path / "out" / "b" / "scene.blend").write_text("mine")
    again = capture2vr("run", *leaves[:2], "-o", tmp_path / "out", *DRAFT)
    assert again.returncode == 0, again.stderr
    assert (tmp_path / "out" / "b" / "scene.blend").read_text() == "mine"


def test_a_capture_may_be_a_link_and_have_links(leaves: list[Path], tmp_path: Path) -> None:
    (tmp_path / "link.ply").symlink_to(leaves[0])
    (leaves[1] / "elsewhere.ply").symlink_to(leaves[0])
    (leaves[1] / "twice.ply").hardlink_to(leaves[1] / "twig.ply")
    os.mkfifo(leaves[1] / "pipe")
    done = capture2vr("run", tmp_path / "link.ply", leaves[1], "-o", tmp_path / "out", *DRAFT)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"a-leaf", "b"}
    pipe = capture2vr("run", leaves[1] / "pipe", leaves[0], "-o", tmp_path / "out", *DRAFT)
    assert (pipe.returncode, "pipe is neither a file nor a folder" in pipe.stderr) == (2, True), pipe.stderr


@pytest.mark.parametrize(
    ("extra", "word"),
    [
        (["nowhere.ply"], "nowhere.ply: there is no such file"),
        (["x/a leaf.ply"], "would both be written to"),
        (["--key", "mine"], "--key, --reference, --box and --edits are of one capture"),
        (["--preset", "magic"], "magic"),
    ],
)
def test_what_cannot_be_done_is_said_before_anything_is(
    leaves: list[Path], extra: list[str], word: str, tmp_path: Path
) -> None:
    (tmp_path / "x").mkdir()
    (tmp_path / "x" / "a leaf.ply").write_bytes(leaves[0].read_bytes())
    named = [tmp_path / word if word.endswith(".ply") else word for word in extra]
    done = capture2vr("run", *leaves, *named, "-o", tmp_path / "out")
    assert (done.returncode, word in done.stderr) == (2, True), done.stderr
    assert not (tmp_path / "out").exists()


def test_a_folder_of_other_things_is_left_alone(leaves: list[Path], tmp_path: Path) -> None:
    (tmp_path / "out" / "b").mkdir(parents=True)
    (tmp_path / "out" / "b" / "diary.txt").write_text("mine")
    done = capture2vr("run", *leaves, "-o", tmp_path / "out", *DRAFT)
    assert (done.returncode, "is no result of `capture2vr run`" in done.stderr) == (2, True)
    assert (tmp_path / "out" / "b" / "diary.txt").read_text() == "mine"


def test_a_cluster_that_is_not_there_is_named(
    leaves: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if importlib.util.find_spec("ray") is None:
        missing("Ray")
    monkeypatch.setenv("EDGE_ENGINE", "ray://127.0.0.1:9")
    done = capture2vr("run", *leaves, "-o", tmp_path / "out", *DRAFT)
    assert (done.returncode, "Ray head at ray://127.0.0.1:9 cannot be reached" in done.stderr) == (2, True), done.stderr
    monkeypatch.setenv("EDGE_ENGINE", "ray")
    wrong = capture2vr("run", *leaves, "-o", tmp_path / "out", *DRAFT)
    assert (wrong.returncode, "EDGE_ENGINE" in wrong.stderr) == (2, True), wrong.stderr
