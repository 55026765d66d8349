"""Splats are drawn as the sum over each pixel, written out, says; so are the derivatives of the picture."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from capture2vr.edge.arrays import Floats
from capture2vr.edge.splat_training.splat_rendering import PinholeView, SplatTensors, draw_splats

WIDTH, HEIGHT = 24, 18


def view_of(seed: int = 0) -> PinholeView:
    rng = np.random.default_rng(seed)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(rng.normal(scale=0.2, size=3)).as_matrix()
    pose[:3, 3] = [*rng.normal(scale=0.05, size=2), 1.0]
    focal, middle = torch.tensor([20.0, 22.0]), torch.tensor([12.5, 8.0])
    return PinholeView(torch.tensor(pose, dtype=torch.float32), focal, middle, WIDTH, HEIGHT)


def splats_of(seed: int, count: int) -> SplatTensors:
    rng = np.random.default_rng(seed)
    arrays = (
        rng.uniform(-0.5, 0.5, (count, 3)),
        rng.normal(size=(count, 4)),
        rng.uniform(0.01, 0.15, (count, 3)),
        rng.uniform(0.05, 0.95, count),
        rng.uniform(0, 1, (count, 3)),
    )
    return SplatTensors(*(torch.tensor(each, dtype=torch.float32) for each in arrays))


def written_out(splats: SplatTensors, view: PinholeView) -> tuple[Floats, Floats]:
    """Each pixel's sum over all splats, from front to back, in double precision."""
    xyz, turns, scale, opacity, rgb = (
        getattr(splats, name).numpy().astype(float) for name in ("xyz", "rotation", "scale", "opacity", "rgb")
    )
    pose, (fx, fy), (cx, cy) = view.to_camera.numpy().astype(float), view.focal.tolist(), view.middle.tolist()
    local = xyz @ pose[:3, :3].T + pose[:3, 3]
    colours, covered = np.zeros((HEIGHT, WIDTH, 3)), np.zeros((HEIGHT, WIDTH))
    for row in range(HEIGHT):
        for column in range(WIDTH):
            light = 1.0
            for number in np.argsort(np.linalg.norm(local, axis=1)):
                x, y, z = local[number]
                at = np.array([fx * x / z + cx, fy * y / z + cy])
                if z <= 0 or (np.abs(at / [WIDTH, HEIGHT] - 0.5) >= 0.65).any():
                    continue
                slope = np.array([[fx / z, 0, -fx * x / z**2], [0, fy / z, -fy * y / z**2]])
                axes = slope @ pose[:3, :3] @ Rotation.from_quat(turns[number]).as_matrix() @ np.diag(scale[number])
                spread = axes @ axes.T + 0.3 * np.eye(2)
                away = np.array([column + 0.5, row + 0.5]) - at
                reach, place = 3 * np.sqrt(np.diag(spread)), np.array([column, row])
                if (place < np.floor(at - reach)).any() or (place >= np.ceil(at + reach)).any():
                    continue
                alpha = min(0.99, opacity[number] * math.exp(-0.5 * away @ np.linalg.inv(spread) @ away))
                if alpha <= 1 / 255 or light <= math.exp(-7):
                    continue
                colours[row, column] += light * alpha * rgb[number]
                covered[row, column] += light * alpha
                light *= 1 - alpha
    return colours, covered


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.integers(1, 25))
@settings(max_examples=8)
def test_a_picture_is_the_sum_over_its_splats(seed: int, count: int) -> None:
    splats, view = splats_of(seed, count), view_of(seed)
    colours, covered = draw_splats(splats, view)
    expected, expected_covered = written_out(splats, view)
    # Rounded to 32 bits, a splat may be on either side of the limits beyond which it is not drawn.
    np.testing.assert_allclose(colours.numpy(), expected, atol=3 / 255)
    np.testing.assert_allclose(covered.numpy(), expected_covered, atol=3 / 255)
    assert float(np.abs(colours.numpy() - expected).mean()) < 2e-5


@pytest.mark.parametrize("name", ["xyz", "rotation", "scale", "opacity", "rgb"])
def test_the_derivatives_are_those_of_the_picture(name: str) -> None:
    """Against differences of the picture, in double precision, where no splat crosses a limit."""
    view = view_of()
    view = PinholeView(view.to_camera.double(), view.focal.double(), view.middle.double(), WIDTH, HEIGHT)
    made = splats_of(5, 6)
    splats = {each: getattr(made, each).double() for each in ("xyz", "rotation", "scale", "opacity", "rgb")}
    weights = torch.rand(HEIGHT, WIDTH, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))

    def loss(value: torch.Tensor) -> torch.Tensor:
        colours, covered = draw_splats(SplatTensors(**{**splats, name: value}), view)
        return (colours * weights).sum() + covered.square().sum()

    at = splats[name].clone().requires_grad_()
    (slope,) = torch.autograd.grad(loss(at), at)
    direction = torch.randn(at.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    step = 1e-7
    with torch.no_grad():
        difference = float(loss(at + step * direction) - loss(at - step * direction)) / (2 * step)
    assert float((slope * direction).sum()) == pytest.approx(difference, rel=1e-4)


def test_nothing_in_sight_is_black_and_open() -> None:
    behind = splats_of(0, 5)
    behind = SplatTensors(
        behind.xyz - torch.tensor([0.0, 0.0, 9.0]),
        *(getattr(behind, name) for name in ("rotation", "scale", "opacity", "rgb")),
    )
    colours, covered = draw_splats(behind, view_of())
    assert not colours.any()
    assert not covered.any()
