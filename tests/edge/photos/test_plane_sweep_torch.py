"""The plane sweep in PyTorch gives what the one in OpenCV gives."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.cameras.nouns import PhotoView
from capture2vr.edge.capture.nouns import Intrinsics, Photo
from capture2vr.edge.errors import Cancelled
from capture2vr.edge.photos.plane_sweep import sweep
from capture2vr.edge.photos.plane_sweep_torch import TorchSweep, _aggregate
from capture2vr.edge.photos.sgm import aggregate
from capture2vr.edge.photos.undistorted import UndistortedPhoto

CAMERA = Intrinsics(150.0, 150.0, 79.5, 59.5, 160, 120)
SLOPE, DISTANCE = 0.4, 2.0
DEVICES = ["cpu", pytest.param("cuda:0", marks=pytest.mark.gpu)]


def _nothing(longest: int | None = None) -> Bytes:
    raise AssertionError("no photo is read here")


def _texture() -> Floats:
    rng = np.random.default_rng(0)
    fine, coarse = (cv2.resize(rng.random((n, n)).astype(np.float32), (2000, 2000)) for n in (700, 60))
    return 255 * (0.6 * fine + 0.4 * coarse)


def _seen(x: float, texture: Floats) -> tuple[UndistortedPhoto, Floats]:
    """A slanted textured wall z = DISTANCE + SLOPE·x from (x, 0, 0), and its depth in that picture."""
    u, v = np.meshgrid((np.arange(160) - CAMERA.cx) / CAMERA.fx, (np.arange(120) - CAMERA.cy) / CAMERA.fy)
    z = (DISTANCE + SLOPE * x) / (1 - SLOPE * u)
    at = 300 * (np.stack([u * z + x, v * z]) + 3)
    grey = cv2.remap(texture, at[0].astype(np.float32), at[1].astype(np.float32), cv2.INTER_LINEAR)
    grey = grey + np.random.default_rng(int(1000 * x) % 97).normal(0, 1, grey.shape)
    pose = np.eye(4)
    pose[0, 3] = x
    view = PhotoView(Photo("wall", (160, 120), "one", _nothing), CAMERA, (0.0,) * 5, pose)
    return UndistortedPhoto(view, grey.clip(0, 255).astype(np.uint8), CAMERA, np.linalg.inv(pose)), z


@pytest.fixture(scope="module")
def wall() -> tuple[list[UndistortedPhoto], Floats]:
    texture = _texture()
    seen = [_seen(x, texture) for x in (0.0, -0.25, 0.25, 0.12)]
    return [picture for picture, _ in seen], seen[0][1]


@pytest.mark.parametrize("device", DEVICES)
def test_the_depths_and_the_scores_are_those_of_opencv(
    wall: tuple[list[UndistortedPhoto], Floats], device: str
) -> None:
    if device != "cpu" and not torch.cuda.is_available():
        pytest.skip("there is no CUDA device")
    (reference, *sources), truth = wall
    z = truth.ravel()[::50]
    ours = sweep(reference, sources, z, backend_of=lambda one, others: TorchSweep(one, others, device))
    theirs = sweep(reference, sources, z)
    assert not np.array_equal(ours.depth, theirs.depth)
    inner = (slice(10, -10), slice(25, -25))  # what all pictures see
    off = np.abs(ours.depth - theirs.depth)[inner] / truth[inner]
    assert np.quantile(off, 0.95) < 2e-3
    assert np.abs(ours.score - theirs.score)[inner].mean() < 0.01
    wrong = [np.median(np.abs(each.depth - truth)[inner] / truth[inner]) for each in (ours, theirs)]
    assert wrong[0] < max(1.1 * wrong[1], 1e-3)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(3, 8)))
def test_paths_are_summed_alike(seed: int, shape: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(seed)
    cost = rng.integers(0, 256, shape).astype(np.uint8)
    grey = rng.integers(0, 256, shape[:2]).astype(np.uint8)
    ours = _aggregate(torch.from_numpy(cost).to(torch.int16), torch.from_numpy(grey).float())
    assert np.array_equal(ours.numpy(), aggregate(cost, grey))


def test_scores_are_correlations(wall: tuple[list[UndistortedPhoto], Floats]) -> None:
    (reference, source, *_), truth = wall
    q = (1 / truth).astype(np.float32)
    score = TorchSweep(reference, [source], "cpu").score(q)
    assert score.max() <= 1.001
    assert np.median(score[10:-10, 25:-25]) > 0.85
    louder = UndistortedPhoto(
        source.view, (source.grey * 0.5 + 40).astype(np.uint8), source.camera, source.world_to_camera
    )
    assert np.abs(TorchSweep(reference, [louder], "cpu").score(q) - score).mean() < 0.03  # exposure does not count


def test_the_sweep_is_cancelled_between_planes(wall: tuple[list[UndistortedPhoto], Floats]) -> None:
    (reference, *sources), truth = wall
    heard: list[float] = []

    def tick(fraction: float) -> None:
        heard.append(fraction)
        raise Cancelled

    with pytest.raises(Cancelled):
        sweep(reference, sources, truth.ravel(), tick, backend_of=lambda a, b: TorchSweep(a, b, "cpu"))
    assert heard[0] < 0.6
