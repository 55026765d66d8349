"""The field without training, against surfaces whose distance is known in closed form."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial.transform import Rotation

from capture2vr.edge.arrays import Floats
from capture2vr.edge.field.local import local_field
from capture2vr.edge.mesh.nouns import Mesh
from tests.support import surfaces

RNG = np.random.default_rng(7)


def test_over_a_flat_disk_the_field_is_the_height() -> None:
    field = local_field(surfaces.sampled(surfaces.disk(), 5_000))
    queries = RNG.uniform(-0.3, 0.3, (2_000, 3)) * [1, 1, 0.2]
    f, gradient = field(queries)
    excess = f - np.abs(queries[:, 2])
    assert excess.min() > -1e-5
    assert np.mean(excess < 1e-5) > 0.95  # the rest lie over gaps that chance left wider than the spacing
    np.testing.assert_allclose(gradient[:, 2], np.sign(queries[:, 2]), atol=1e-5)


def test_near_a_sphere_the_field_is_the_distance_and_the_gradient_points_away() -> None:
    field = local_field(surfaces.sampled(surfaces.sphere(), 10_000))
    outward = RNG.normal(size=(4_000, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    height = RNG.uniform(-0.03, 0.03, 4_000)
    f, gradient = field(outward * (0.5 + height)[:, None])
    assert np.abs(f - np.abs(height)).mean() < 1.5e-4  # planes beside a ball of radius ½ miss by spacing²/2R = 3e-4
    facing = np.einsum("nx,nx->n", gradient, outward) * np.sign(height)
    assert np.mean(facing[np.abs(height) > 0.002] > 0.98) > 0.999


@pytest.mark.parametrize(
    "surface", [surfaces.hemisphere, surfaces.mobius, surfaces.pleated_skirt, surfaces.bumpy_sheet]
)
def test_the_surface_itself_is_the_zero_set(surface: Callable[[], Mesh]) -> None:
    field = local_field(surfaces.sampled(surface(), 10_000))
    f, gradient = field(surfaces.sampled(surface(), 5_000, seed=1))
    assert f.mean() < 1e-3
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1, atol=1e-4)


def test_between_two_sheets_the_gradient_turns_in_the_middle() -> None:
    field = local_field(surfaces.sampled(surfaces.two_sheets(apart=0.06), 10_000))
    x, y = RNG.uniform(-0.4, 0.4, (2, 2_000))
    middle = _middle_height(x, y)
    for height in (-0.02, 0.02):
        f, gradient = field(np.stack([x, y, middle + height], axis=1))
        assert np.mean(gradient[:, 2] * -np.sign(height) > 0.7) > 0.99
        assert np.abs(f - 0.01).mean() < 2e-3


def test_the_field_grows_beyond_an_open_edge() -> None:
    points = surfaces.sampled(surfaces.disk(), 5_000)
    beyond = np.linspace(0.55, 0.8, 26)
    f, _ = local_field(points)(np.stack([beyond, 0 * beyond, 0 * beyond], axis=1))
    assert (np.diff(f) > 0).all()
    spacing = np.sqrt(np.pi / 4 / 5_000)
    np.testing.assert_allclose(f, beyond - 0.5, atol=4 * spacing)


def test_given_normals_are_used_whatever_their_sign_and_length() -> None:
    points = surfaces.sampled(surfaces.sphere(), 500)
    signs = RNG.choice([-3.0, 0.5], (500, 1))
    queries = RNG.uniform(-0.6, 0.6, (500, 3))
    f, gradient = local_field(points, normals=points)(queries)
    again, flipped = local_field(points, normals=points * signs)(queries)
    np.testing.assert_allclose(f, again, atol=1e-5)
    np.testing.assert_allclose(gradient, flipped, atol=1e-4)


@pytest.mark.slow
@settings(max_examples=15)
@given(turn=st.tuples(*[st.floats(-3, 3)] * 3), shift=st.tuples(*[st.floats(-0.2, 0.2)] * 3), size=st.floats(0.5, 1))
def test_the_field_moves_with_the_points(turn: tuple[float, ...], shift: tuple[float, ...], size: float) -> None:
    points = surfaces.sampled(surfaces.hemisphere(), 800)
    queries = points[:200] + np.random.default_rng(1).normal(0, 0.01, (200, 3))
    rotation = Rotation.from_rotvec(turn)

    def move(xyz: Floats) -> Floats:
        return np.asarray(rotation.apply(xyz)) * size + shift

    f, gradient = local_field(points)(queries)
    moved_f, moved_gradient = local_field(move(points))(move(queries))
    np.testing.assert_allclose(moved_f, f * size, atol=2e-4)
    # On the surface itself either side is right.
    clear = f > 1e-3
    assert np.mean(np.abs(rotation.apply(gradient) - moved_gradient).max(axis=1)[clear] < 0.02) > 0.97


def test_a_query_does_not_depend_on_its_batch() -> None:
    field = local_field(surfaces.sampled(surfaces.smooth_sheet(), 2_000))
    queries = RNG.uniform(-0.5, 0.5, (20_000, 3))
    f, gradient = field(queries)
    for part in (slice(0, 1), slice(8_000, 9_000)):
        alone, direction = field(queries[part])
        np.testing.assert_array_equal(alone, f[part])
        np.testing.assert_array_equal(direction, gradient[part])
    assert field(queries[:0])[0].shape == (0,)


@pytest.mark.parametrize(
    "points",
    [
        np.array([[0, 0, 0], [1, 0, 0.0]]),
        np.array([[0, 0, 0]] * 40 + [[1, 0, 0], [0, 1, 0.0]]),
        np.linspace(0, 1, 50)[:, None] * [1, 0, 0],
        np.zeros((30, 3)),
    ],
    ids=["two points", "duplicates", "a line", "one place"],
)
def test_degenerate_points_still_give_finite_distances(points: Floats) -> None:
    f, gradient = local_field(points)(RNG.uniform(-1, 1, (100, 3)))
    assert np.isfinite(f).all()
    assert np.isfinite(gradient).all()
    assert (f >= 0).all()


def test_points_that_are_none_are_refused() -> None:
    with pytest.raises(ValueError, match="N ≥ 2"):
        local_field(np.zeros((1, 3)))
    with pytest.raises(ValueError, match=r"\(5, 2\)"):
        local_field(np.zeros((5, 2)))
    with pytest.raises(ValueError, match="1 points are not finite"):
        local_field(np.array([[0, 0, 0], [0, np.nan, 0]]))
    with pytest.raises(ValueError, match="normals"):
        local_field(np.zeros((5, 3)), normals=np.zeros((4, 3)))


@pytest.mark.slow
def test_memory_grows_with_the_points_not_with_their_neighbourhoods() -> None:
    few, many = (_peak_bytes(surfaces.sampled(surfaces.smooth_sheet(), count)) for count in (10_000, 30_000))
    # 360 B for each. A table of its 16 neighbours would take another 380, and the arrays over it several times that.
    assert (many - few) / 20_000 < 500


def _peak_bytes(points: Floats) -> int:
    """What a field of the points takes at most while it is made and asked at each of them."""
    tracemalloc.start()
    try:
        field = local_field(points)
        field(points)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.data
def test_a_real_dress_is_near_its_own_zero_set(data_dir: Path) -> None:
    truth = surfaces.read_unit(data_dir / "dress" / "dress-v17k-f34k.obj")
    f, _ = local_field(surfaces.sampled(truth, 10_000))(surfaces.sampled(truth, 10_000, seed=1))
    assert f.mean() < 0.003  # the mean spacing is 0.015


def _middle_height(x: Floats, y: Floats) -> Floats:
    """Height midway between the two sheets over (x, y)."""
    vertices = surfaces.two_sheets(apart=0.06).vertices.reshape(2, -1, 3)
    return np.asarray(LinearNDInterpolator(vertices[0, :, :2], vertices.mean(axis=0)[:, 2])(x, y))
