"""From one photo to an asset: the cut-out, and what is no thing; the network of the bench, and its training."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.arrays import Bytes
from capture2vr.edge.convert.capture_points import CapturePoints
from capture2vr.edge.errors import Cancelled, CaptureError, EdgeError
from capture2vr.edge.origin import PROPOSED
from capture2vr.edge.pipeline import reconstruct
from capture2vr.edge.preset import load_preset
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.single_photo.cutout import cut_out
from capture2vr.edge.single_photo.relief import MOST_CONFIDENT, make_relief
from capture2vr.order import download_formats
from capture2vr.order.asset_names import AssetNames
from capture2vr.order.job_options import JobOptions
from capture2vr.storage.bundle import Bundle
from tests.bench.single_photo_network.camera import SIDE
from tests.bench.single_photo_network.network import BINS, POINTS, Pixels
from tests.bench.single_photo_network.prediction_views import VIEWS, _choose_yaw, predict_from_views
from tests.bench.single_photo_network.weights import SHIPPED, load_pixels
from tests.bench.single_photo_training import __main__ as training_command
from tests.bench.single_photo_training.batches import HELD_OUT, held_out_batch, training_batches
from tests.bench.single_photo_training.evaluate import head_points
from tests.bench.single_photo_training.field_heads import (
    ANCHORS,
    Field,
    Implicit,
    anchors,
    field_points,
    value_and_gradient,
)
from tests.bench.single_photo_training.losses import chamfer
from tests.bench.single_photo_training.pictures import render_pictures
from tests.bench.single_photo_training.shapes import SAMPLES, generate_shapes
from tests.bench.single_photo_training.train import HeadTraining, train
from tests.bench.single_photo_training.weight_files import (
    FIELDS,
    TrainingRecord,
    load_field,
    save_half,
    training_of,
)
from tests.referees.glb_reader import Glb
from tests.support.photos.single_photos import photo

CPU = torch.device("cpu")
W, H = 400, 300
QUICK_STEPS = 6


def wall(level: int, noise: float, seed: int = 0) -> Bytes:
    """A plain wall, darker towards the corners as lenses make it."""
    y, x = np.mgrid[-1 : 1 : complex(H), -1 : 1 : complex(W)]
    dimmed = level * (1 - 0.15 * (x * x + y * y))[..., None]
    return np.clip(dimmed + np.random.default_rng(seed).normal(0, noise, (H, W, 3)), 0, 255).astype(np.uint8)


def with_disc(centre: tuple[int, int], radius: int, colour: tuple[int, int, int]) -> tuple[Bytes, np.ndarray]:
    rgb = wall(215, 4)
    truth = np.zeros((H, W), np.uint8)
    cv2.circle(truth, centre, radius, 1, -1)
    rgb[truth > 0] = colour
    return rgb, truth > 0


@pytest.fixture(scope="module")
def dress() -> tuple[Bytes, torch.Tensor]:
    """A photo of a held-out dress before a wall, 512 pixels wide, and the dress."""
    made = generate_shapes(HELD_OUT + 77, 1, names=("dress",), samples=4 * SAMPLES)
    seen = render_pictures(made, 3, clean=True).picture[0].permute(1, 2, 0).numpy()
    large = cv2.resize(seen, (300, 300), interpolation=cv2.INTER_CUBIC).clip(0, 1)
    rgb = cv2.resize(wall(210, 3), (512, 400)).astype(np.float32)
    part = rgb[60:360, 100:400]
    part[:] = part * (1 - large[..., 3:]) + 255 * large[..., :3]
    return rgb.astype(np.uint8), made.xyz


@pytest.mark.slow
@settings(max_examples=6)
@given(st.integers(90, 310), st.integers(90, 210), st.integers(30, 70))
def test_a_disc_before_a_wall_is_cut_out_wherever_it_is(x: int, y: int, radius: int) -> None:
    rgb, truth = with_disc((x, y), radius, (170, 60, 40))
    mask = cut_out(photo(rgb)).mask
    truth = cv2.resize(truth.astype(np.uint8), mask.shape[::-1], interpolation=cv2.INTER_AREA) > 0
    assert (mask & truth).sum() / (mask | truth).sum() > 0.9


@pytest.mark.slow
@pytest.mark.parametrize(
    "rgb",
    [
        wall(245, 0),
        wall(235, 6),
        wall(120, 12),
        np.zeros((H, W, 3), np.uint8),
        np.full((H, W, 3), 255, np.uint8),
        np.random.default_rng(0).integers(0, 255, (H, W, 3)).astype(np.uint8),
    ],
    ids=["white wall", "wall", "grey wall", "black", "white", "noise"],
)
def test_nothing_to_see_is_an_error_with_advice(rgb: Bytes) -> None:
    with pytest.raises(CaptureError) as caught:
        cut_out(photo(rgb, name="wall.jpg"))
    assert caught.value.code == "CAPTURE_NO_OBJECT"
    assert caught.value.file == "wall.jpg"
    assert len(caught.value.hints) >= 1


@pytest.mark.slow
def test_a_thing_that_is_cut_off_on_every_side_is_an_error() -> None:
    rgb = wall(215, 3)
    rgb[:, 90:310] = (160, 40, 30)
    rgb[70:230] = (160, 40, 30)
    with pytest.raises(CaptureError, match=r"wall|reaches beyond|stands out|differ"):
        cut_out(photo(rgb))


def test_a_sideways_photo_is_turned_upright() -> None:
    rgb, _ = with_disc((120, 100), 60, (30, 60, 160))
    upright, sideways = cut_out(photo(rgb)), cut_out(photo(np.rot90(rgb).copy(), turns=1))
    assert upright.mask.shape == sideways.mask.shape
    assert (upright.mask ^ sideways.mask).mean() < 0.02


def test_an_alpha_channel_is_the_mask() -> None:
    alpha = np.zeros((H, W), np.uint8)
    alpha[50:200, 100:180] = 255
    mask = cut_out(replace(photo(wall(200, 3)), load_alpha=lambda: alpha)).mask
    rows, columns = np.nonzero(mask)
    scale = 320 / W
    assert np.allclose(
        [rows.min(), rows.max() + 1, columns.min(), columns.max() + 1], np.array([50, 200, 100, 180]) * scale, atol=1
    )


def test_an_alpha_channel_that_hides_nothing_is_none() -> None:
    rgb, truth = with_disc((120, 100), 60, (30, 60, 160))
    opaque = replace(photo(rgb), load_alpha=lambda: np.full((H, W), 255, np.uint8))
    assert cut_out(opaque).mask.mean() == pytest.approx(truth.mean(), rel=0.1)


def test_the_outline_tells_how_a_bar_is_turned() -> None:
    along = torch.linspace(-1, 1, 400)
    bar = torch.stack([0.1 * torch.sin(40 * along), 0.1 * torch.cos(40 * along), along], dim=1)[None]
    camera = torch.tensor([[0.2, 0.0, 0.2, 0.8, 0.0, 0.0]])
    mask = torch.zeros(1, SIDE, SIDE)
    mask[:, 28:36, 4:60] = 1  # long from left to right
    unsure = torch.zeros(1, BINS)
    yaw = _choose_yaw(bar, unsure, camera, mask)
    assert abs(yaw.sin().item()) > 0.9
    unsure[0, 0] = 9.0  # and where the network is sure, outlines do not count
    assert _choose_yaw(bar, unsure, camera, mask).cos().item() > 0.97


def test_a_relief_can_be_cancelled(dress: tuple[Bytes, torch.Tensor]) -> None:
    def stop(fraction: float) -> None:
        if fraction > 0.5:
            raise Cancelled

    with pytest.raises(Cancelled):
        make_relief(photo(dress[0]), tick=stop)


@pytest.mark.slow
def test_the_shipped_heads_are_small_and_much_better_than_the_mean_shape() -> None:
    assert sum(file.stat().st_size for folder in (SHIPPED, FIELDS) for file in folder.iterdir()) <= 12e6
    lesson = held_out_batch(5, 2)
    picture, truth = lesson.picture[:32], lesson.surface[:32, :POINTS]
    mean = anchors(held_out_batch(6, 2).surface[:, :256].reshape(1, -1, 3), POINTS).expand(32, -1, -1)
    as_mean = chamfer(mean, truth)
    pixels, some = load_pixels(), slice(0, 32, 4)
    together = predict_from_views(pixels, picture).points[:, :, ::VIEWS].flatten(1, 2)
    assert chamfer(together, truth).mean() < 0.3 * as_mean.mean()
    assert chamfer(head_points(pixels, picture), truth).mean() < 0.3 * as_mean.mean()
    by_anchors = head_points(load_field("anchor-udf"), picture[some])
    assert chamfer(by_anchors, truth[some]).mean() < 0.45 * as_mean[some].mean()
    without = head_points(load_field("implicit"), picture[some])
    assert chamfer(by_anchors, truth[some]).mean() < chamfer(without, truth[some]).mean()
    assert all(training_of(name).steps > 0 for name in ("pixels", "anchor-udf", "implicit"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["anchor-udf", "implicit"])
def test_a_field_is_small_on_the_surface_and_its_points_lie_there(name: str) -> None:
    field: Field = load_field(name)
    lesson = held_out_batch(5, 1)[torch.arange(0, 20, 3)]
    seen = field.encode(lesson.picture)
    near, far = (field(seen, lesson.surface[:, :500] * grow).mean().item() for grow in (1.0, 1.5))
    assert near < 0.6 * far
    points = field_points(field, seen, torch.Generator().manual_seed(0))
    left, gradient = value_and_gradient(field, seen, points)
    assert left.median() < 0.03
    assert gradient.shape == points.shape


def test_anchors_are_means_of_what_is_near_them() -> None:
    points = torch.rand(2, 800, 3, generator=torch.Generator().manual_seed(0))
    found = anchors(points, 100)
    assert found.shape == (2, 100, 3)
    apart = torch.cdist(points, found).amin(dim=2).mean()
    assert apart < torch.cdist(points, points[:, :100]).amin(dim=2).mean()


def test_anchors_reach_the_whole_thing_where_there_are_nearly_as_many_as_points() -> None:
    along = torch.linspace(0, 1, POINTS)[None, :, None] * torch.tensor([1.0, 0.0, 0.0])
    found = anchors(along, ANCHORS)
    assert found.shape == (1, ANCHORS, 3)
    assert torch.cdist(along, found).amin(dim=2).max() < 2 / ANCHORS


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Little bags, and a checkpoint after every other step or so."""
    monkeypatch.setattr("tests.bench.single_photo_training.batches._SHEETS", 1)
    monkeypatch.setattr("tests.bench.single_photo_training.batches._EACH", 1)
    monkeypatch.setattr("tests.bench.single_photo_training.batches._VIEWS", 1)
    monkeypatch.setattr("tests.bench.single_photo_training.batches._USES", 2)
    monkeypatch.setattr("tests.bench.single_photo_training.batches.BATCH", 8)
    monkeypatch.setattr("tests.bench.single_photo_training.batches.STEPS", QUICK_STEPS)
    monkeypatch.setattr("tests.bench.single_photo_training.train._CHECKPOINT_S", 0.2)
    monkeypatch.setattr("tests.bench.single_photo_training.train._REPORT_STEPS", 1)


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_lessons_begin_at_any_step_and_never_end() -> None:
    whole = list(islice(training_batches(3, 0), 2 * QUICK_STEPS + 1))
    for step in (1, QUICK_STEPS - 1, QUICK_STEPS, 2 * QUICK_STEPS):
        assert torch.equal(next(training_batches(3, step)).picture, whole[step].picture)
    assert not torch.equal(whole[0].picture, whole[QUICK_STEPS].picture)


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("name", ["pixels", "implicit"])
def test_a_killed_training_ends_like_one_that_nobody_stopped(name: str, tmp_path: Path) -> None:
    training = HeadTraining(name, 7, seed=1)
    whole = train(training, tmp_path / "whole", CPU, report=lambda line: None)

    def killed_after(step: int) -> Callable[[str], None]:
        def report(line: str) -> None:
            if line.startswith(f"step {step}/"):
                raise KeyboardInterrupt

        return report

    for step in (3, 6):
        with pytest.raises(KeyboardInterrupt):
            train(training, tmp_path / "killed", CPU, report=killed_after(step))
    again = train(training, tmp_path / "killed", CPU, report=lambda line: None)
    for key, value in whole.state_dict().items():
        assert torch.equal(value, again.state_dict()[key]), key
    assert training_of(name, tmp_path / "killed").steps == 7


def test_a_full_disk_at_the_end_of_a_training_is_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """/dev/full takes the weights' bytes as a disk without space does."""
    (tmp_path / "pixels.pt.part").symlink_to("/dev/full")
    monkeypatch.setattr(training_command, "train", lambda *_, **__: save_half(Pixels(), TrainingRecord(1, 1.0), file))
    file = tmp_path / "pixels.pt"
    monkeypatch.setattr(sys, "argv", ["training", "--head", "pixels", "--out", str(tmp_path)])
    assert training_command.main() == 1
    told = f"{tmp_path}: No space left on device; mend that and run it again: it goes on from the last checkpoint"
    assert capsys.readouterr().err == f"{told}\n"
    assert not file.exists()


def test_weights_that_are_missing_or_of_another_head_are_named(tmp_path: Path) -> None:
    with pytest.raises(EdgeError, match="does not exist"):
        load_pixels(tmp_path)
    torch.save({"head": Implicit(Pixels()).whole.state_dict(), "steps": 1, "seconds": 1.0}, tmp_path / "pixels.pt")
    with pytest.raises(EdgeError, match="another version") as caught:
        load_pixels(tmp_path)
    assert caught.value.code == "WEIGHTS_ABSENT"


@pytest.mark.essential
@pytest.mark.slow
@pytest.mark.usefixtures("small_pictures")
def test_one_photo_in_an_asset_out_that_says_it_is_a_guess(tmp_path: Path, dress: tuple[Bytes, torch.Tensor]) -> None:
    cv2.imwrite(str(tmp_path / "dress.png"), dress[0][..., ::-1])
    preset, options = replace(load_preset("draft"), resolution=48), JobOptions(names=AssetNames("Dress"))
    steps = reconstruct(read_capture(tmp_path), preset, options)
    *_, bundle = (step for step in steps if isinstance(step, Bundle))
    manifest = bundle.manifest
    assert manifest["origin"] == "guess"
    assert manifest["quality"]["origins"] == {"measured": 0.0, "proposed": 1.0, "filled": 0.0}
    assert manifest["origins"] == {"measured": 0, "proposed": manifest["points"], "filled": 0}
    assert set(CapturePoints.read(bundle.files[download_formats.POINTS]).origin) == {PROPOSED}
    assert set(Glb.of(bundle.files["lod0.glb"]).attribute("_ORIGIN")) == {PROPOSED}
    assert 0 < manifest["confidence"] <= MOST_CONFIDENT
    assert manifest["scale_confidence"] == "unknown"
    assert any("guess" in warning for warning in manifest["warnings"])
    assert manifest["size_m"][1] == max(manifest["size_m"]) == pytest.approx(0.4, rel=0.1)
    assert 100 <= len(manifest["anchors"]["xyz_m"]) // 3 == len(manifest["anchors"]["rgb"]) // 3 <= 1000
