"""Real meshes as shapes for the training: read or refused by name, drawn the same by the same seed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from capture2vr.edge.errors import EdgeError
from tests.bench.single_photo_network.camera import about_vertical
from tests.bench.single_photo_training.batches import HELD_OUT, real_batch, training_batches
from tests.bench.single_photo_training.real_things import (
    UNKNOWN,
    RealThing,
    draw_shapes,
    fingerprint,
    mesh_files,
    read_things,
)
from tests.bench.single_photo_training.shapes import CLASSES
from tests.bench.single_photo_training.train import SHIPPED, _Schedule


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A red box, higher than wide, a plain cone in a folder of its own, and two files that are no meshes."""
    folder = tmp_path_factory.mktemp("meshes")
    box = trimesh.creation.box((1.0, 3.0, 1.0))
    box.visual.vertex_colors = [255, 0, 0, 255]
    box.export(folder / "box.ply")
    (folder / "more").mkdir()
    trimesh.creation.cone(0.5, 1.0).export(folder / "more" / "cone.stl")
    (folder / "torn.glb").write_bytes(b"glTF" + bytes(20))
    (folder / "cloud.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 200\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        + "".join(f"{np.cos(n)} {np.sin(n)} {n / 50}\n" for n in range(200))
    )
    (folder / "notes.txt").write_text("no mesh")
    return folder


@pytest.fixture(scope="module")
def things(folder: Path) -> list[RealThing]:
    return read_things(mesh_files(folder), lambda line: None)


def test_meshes_are_read_and_the_rest_is_named(folder: Path) -> None:
    told: list[str] = []
    files = mesh_files(folder)
    assert [path.name for path in files] == ["box.ply", "cloud.ply", "cone.stl", "torn.glb"]
    things = read_things(files, told.append)
    assert [thing.name for thing in things] == ["box", "cone"]
    assert [line.split(" is left out: ")[0].rsplit("/", 1)[1] for line in told] == ["cloud.ply", "torn.glb"]
    assert things[0].rgb is not None
    assert things[0].rgb.mean(dim=0).tolist() == [1, 0, 0]
    assert things[1].rgb is None


@pytest.mark.slow
def test_a_folder_without_meshes_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(EdgeError, match="is not a folder"):
        mesh_files(tmp_path / "absent")
    command = [sys.executable, "-m", "tests.bench.single_photo_training", "--out", tmp_path, "--meshes", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "there is no mesh that can be read" in done.stderr


def test_drawn_things_keep_the_frame_and_their_uprightness(things: list[RealThing]) -> None:
    first, again, other = (draw_shapes(things, seed, 8, samples=2_000) for seed in (3, 3, 4))
    assert torch.equal(first.xyz, again.xyz)
    assert torch.equal(first.rgb, again.rgb)
    assert not torch.equal(first.xyz, other.xyz)
    own = about_vertical(first.xyz, -first.yaw)
    assert torch.allclose(own.amin(dim=1), -own.amax(dim=1), atol=1e-5)
    assert torch.allclose(first.xyz.norm(dim=2).amax(dim=1), torch.ones(8), atol=1e-5)
    assert ((first.normals.norm(dim=2) - 1).abs() < 1e-4).all()
    assert (first.label == UNKNOWN).all()
    box = draw_shapes(things[:1], 0, 4, samples=2_000)
    size = (box.xyz.amax(dim=1) - box.xyz.amin(dim=1)).unbind(dim=1)
    assert (size[1] > 1.5 * torch.maximum(size[0], size[2])).all()


@pytest.mark.slow
def test_every_other_picture_shows_a_real_thing(things: list[RealThing], monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("_SHEETS", 1), ("_EACH", 2), ("_VIEWS", 1), ("_USES", 1), ("BATCH", 2 * len(CLASSES))):
        monkeypatch.setattr(f"tests.bench.single_photo_training.batches.{name}", value)
    batch = next(training_batches(0, 0, things))
    assert (batch.label == UNKNOWN).sum() == len(CLASSES)
    assert set(next(training_batches(0, 0)).label.tolist()) == set(range(len(CLASSES)))
    shown = real_batch(things[:1], 0, 2, clean=True).picture
    red, green, _, mask = shown.sum(dim=(2, 3)).unbind(dim=1)
    assert (red > 0.2 * mask).all()
    assert (green < 0.1 * red).all()


def test_other_meshes_have_another_fingerprint(things: list[RealThing]) -> None:
    assert fingerprint(things) == fingerprint(things) != fingerprint(things[:1])
    assert HELD_OUT > 1 << 24


def steps_of(schedule: _Schedule, distances: list[float]) -> int:
    """Steps of a training that is evaluated after every step."""
    for step in range(1, 10_000):
        schedule.advance(step, distances[min(step, len(distances)) - 1])
        if step >= schedule.end:
            return step
    raise AssertionError("it never ends")


def test_a_flat_training_ends_early_and_a_falling_one_at_its_most() -> None:
    assert steps_of(_Schedule(1_000), [0.99**step for step in range(1, 1_000)]) == 1_000
    flat = _Schedule(1_000)
    assert steps_of(flat, [1.0 / step for step in range(1, 41)]) == 55  # 40 and a patience of 4, and a quarter of that
    assert flat.rate_share(0) == pytest.approx(1 / 300)
    assert _Schedule(1_000).rate_share(700) == 1
    assert flat.rate_share(54) == pytest.approx(1 / 11)


def test_all_shipped_heads_have_a_training_their_backbone_first() -> None:
    assert [each.head for each in SHIPPED] == ["pixels", "anchor-udf", "implicit"]
