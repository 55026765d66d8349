"""The extraction, on fields whose zero set is known in closed form, and on fields that err."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from capture2vr.edge.arrays import DistanceFn, Floats
from capture2vr.edge.errors import Cancelled
from capture2vr.edge.mesh.band import Band
from capture2vr.edge.mesh.crossings import find_crossings
from capture2vr.edge.mesh.dual import connect
from capture2vr.edge.mesh.edges import edges_of
from capture2vr.edge.mesh.extract import extract
from capture2vr.edge.mesh.grid import SIDE, STEP, find, grid_around
from capture2vr.edge.mesh.manifold import to_manifold
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.spacing import auto_resolution, point_spacing
from capture2vr.edge.mesh.topology import component_count
from tests.support import surfaces
from tests.support.mesh_metrics import chamfer_l1


def ball(centre: tuple[float, float, float] = (0, 0, 0), radius: float = 0.5) -> DistanceFn:
    def distance(q: Floats) -> tuple[Floats, Floats]:
        away = np.linalg.norm(q - centre, axis=1)
        return np.abs(away - radius), (q - centre) / away[:, None] * np.sign(away - radius)[:, None]

    return distance


def flat_disk(turn: Rotation, radius: float = 0.5) -> DistanceFn:
    """Unsigned distance to a disk; across it the gradient is the normal, beyond its rim it points away from the rim."""

    def distance(q: Floats) -> tuple[Floats, Floats]:
        local = turn.inv().apply(q)
        across = np.hypot(local[:, 0], local[:, 1])
        rim = local.copy()
        rim[:, :2] *= (np.maximum(across - radius, 0) / np.maximum(across, 1e-12))[:, None]
        away = np.linalg.norm(rim, axis=1)
        return away, turn.apply(rim / np.maximum(away, 1e-12)[:, None])

    return distance


def sheets(apart: float) -> DistanceFn:
    def distance(q: Floats) -> tuple[Floats, Floats]:
        above = np.where(q[:, 2] > 0, q[:, 2] - apart / 2, q[:, 2] + apart / 2)
        gradient = np.zeros_like(q)
        gradient[:, 2] = np.sign(above)
        return np.abs(above), gradient

    return distance


def counts(mesh: Mesh) -> tuple[int, int, int]:
    """Pieces, borders, edges of more than two faces."""
    edges = edges_of(mesh.faces)
    return component_count(edges.ends), component_count(edges.border_ends), edges.crowded_count


@pytest.mark.parametrize("resolution", [8, 33, 64])
def test_a_sphere_comes_out_closed_and_round(resolution: int) -> None:
    near = surfaces.sampled(surfaces.sphere(), 4_000)
    mesh = extract(ball(), near, resolution=resolution)
    assert counts(mesh) == (1, 0, 0)
    edges = edges_of(mesh.faces)
    assert len(mesh.vertices) - len(edges.size) + len(mesh.faces) == 2  # Euler: no handle either
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 0.5).max() < 1e-5


@settings(max_examples=15)
@given(turn=st.integers(0, 2**31), resolution=st.integers(16, 48))
def test_a_disk_in_any_pose_is_one_piece_with_one_border(turn: int, resolution: int) -> None:
    pose = Rotation.random(rng=np.random.default_rng(turn))
    near = pose.apply(surfaces.sampled(surfaces.disk(), 3_000))
    mesh = extract(flat_disk(pose), near, resolution=resolution)
    assert counts(mesh) == (1, 1, 0)
    side = np.ptp(near, axis=0).max() / resolution
    local = pose.inv().apply(mesh.vertices)
    assert np.abs(local[:, 2]).max() < 1e-5
    assert np.hypot(local[:, 0], local[:, 1]).max() < 0.5 + 2 * side


def test_a_surface_on_the_planes_of_its_own_box_is_found() -> None:
    near = surfaces.sampled(surfaces.grid_with_holes(), 5_000)
    assert np.ptp(near[:, 2]) == 0
    mesh = extract(sheets(0.0), near, resolution=64)
    assert counts(mesh)[0] == 1
    assert np.abs(mesh.vertices[:, 2]).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cells_apart", "resolution"), [(1.6, 40), (2.3, 40), (4.0, 40), (3.0, 128), (5.0, 128), (7.0, 128), (5.0, 200)]
)
def test_two_close_sheets_stay_two_and_nothing_grows_between_them(cells_apart: float, resolution: int) -> None:
    """Also where they lie along the grid, and a coarse cell sees the same between them as across a surface."""
    apart = cells_apart / resolution
    rng = np.random.default_rng(3)
    near = rng.uniform(-0.5, 0.5, (6_000, 3))
    near[:, 2] = np.where(near[:, 2] > 0, apart / 2, -apart / 2)
    mesh = extract(sheets(apart), near, resolution=resolution)
    assert counts(mesh)[0] == 2
    np.testing.assert_allclose(np.abs(mesh.vertices[:, 2]), apart / 2, atol=1e-5)


@pytest.mark.parametrize("cells_apart", [0.3, 0.9])
def test_layers_closer_than_a_cell_stay_manifold(cells_apart: float) -> None:
    near = surfaces.sampled(surfaces.sphere(), 4_000)
    thin = cells_apart / 48

    def shell(q: Floats) -> tuple[Floats, Floats]:
        inner, outer = ball(radius=0.5 - thin)(q), ball()(q)
        nearer = inner[0] < outer[0]
        return np.minimum(inner[0], outer[0]), np.where(nearer[:, None], inner[1], outer[1])

    mesh = extract(shell, near, resolution=48)
    assert counts(mesh)[2] <= 2e-2 * len(mesh.faces)
    assert counts(to_manifold(mesh))[2] == 0


def test_gradients_that_err_beside_the_surface_are_outvoted() -> None:
    near = surfaces.sampled(surfaces.sphere(), 4_000)
    rng = np.random.default_rng(0)

    def noisy(q: Floats) -> tuple[Floats, Floats]:
        f, g = ball()(q)
        wrong = (f < 0.002) & (rng.random(len(q)) < 0.3)
        return f, np.where(wrong[:, None], -g, g)

    clean, mesh = extract(ball(), near, resolution=48), extract(noisy, near, resolution=48)
    assert counts(mesh)[0] == 1
    assert chamfer_l1(mesh, surfaces.sphere(), 20_000) < 1.1 * chamfer_l1(clean, surfaces.sphere(), 20_000)


def test_the_walk_crosses_gaps_between_sparse_points_and_finds_no_far_sheet() -> None:
    both = [ball(), ball((3, 0, 0), 0.5)]

    def distance(q: Floats) -> tuple[Floats, Floats]:
        (f, g), (e, h) = both[0](q), both[1](q)
        return np.minimum(f, e), np.where((f < e)[:, None], g, h)

    near = surfaces.sampled(surfaces.sphere(), 300)  # 300 points, 64 cells: most crossed cells hold none
    mesh = extract(distance, near, resolution=64)
    assert counts(mesh) == (1, 0, 0)
    assert mesh.vertices.max() < 0.6


def test_points_off_the_surface_still_lead_to_it() -> None:
    near = surfaces.sampled(surfaces.sphere(), 2_000) * 1.06  # two cells outside
    assert counts(extract(ball(), near, resolution=32))[0] == 1


def test_an_empty_field_gives_an_empty_mesh() -> None:
    near = surfaces.sampled(surfaces.disk(), 500)
    mesh = extract(lambda q: (np.full(len(q), 9.0), np.tile([0.0, 0, 1], (len(q), 1))), near, resolution=16)
    assert mesh.faces.shape == (0, 3)


def test_points_without_extent_are_refused() -> None:
    with pytest.raises(ValueError, match="without extent"):
        extract(ball(), np.zeros((5, 3)), resolution=16)


def test_tick_rises_to_one_and_cancels_between_slabs() -> None:
    near = surfaces.sampled(surfaces.sphere(), 2_000)
    heard: list[float] = []
    extract(ball(), near, resolution=64, tick=heard.append)
    assert heard == sorted(heard)
    assert heard[0] == 0
    assert heard[-1] == 1
    asked: list[int] = []

    def counting(q: Floats) -> tuple[Floats, Floats]:
        asked.append(len(q))
        return ball()(q)

    def stop(fraction: float) -> None:
        if fraction > 0:
            raise Cancelled

    with pytest.raises(Cancelled):
        extract(counting, near, resolution=64, tick=stop)
    assert len(asked) == 1


def test_memory_and_queries_grow_with_the_surface_not_with_the_volume() -> None:
    near = surfaces.sampled(surfaces.sphere(), 2_000)
    asked, peaks = [], []
    for resolution in (32, 64, 128):
        queries: list[int] = []

        def counting(q: Floats, queries: list[int] = queries) -> tuple[Floats, Floats]:
            queries.append(len(q))
            return ball()(q)

        tracemalloc.start()
        extract(counting, near, resolution=resolution)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        asked.append(sum(queries))
    assert asked[2] < 4.5 * asked[1] < 4.5 * 4.5 * asked[0]
    assert peaks[2] < 5 * peaks[1]


@settings(max_examples=20)
@given(seed=st.integers(0, 2**31))
def test_keys_name_cells_and_come_back_as_places(seed: int) -> None:
    rng = np.random.default_rng(seed)
    near = rng.uniform(-0.5, 0.5, (50, 3))
    grid = grid_around(near, 37)
    inside = near - grid.xyz_of(grid.cells_of(near))
    assert inside.min() >= -1e-12
    assert inside.max() < grid.side * (1 + 1e-9)
    keys = np.unique(rng.integers(0, SIDE**3, 100))
    np.testing.assert_array_equal(find(keys, keys), np.arange(len(keys)))
    np.testing.assert_array_equal(find(keys, keys + 1)[~np.isin(keys + 1, keys)], len(keys))


@settings(max_examples=20)
@given(seed=st.integers(0, 2**31))
def test_quads_of_any_signs_share_each_grid_face_in_pairs(seed: int) -> None:
    """Random signs are the hardest input there is: every line across a grid face must still join two quads."""
    rng = np.random.default_rng(seed)
    cube = np.stack(np.meshgrid(*[np.arange(1, 7)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    inner = ((cube > 1) & (cube < 6)).all(axis=1)
    sign = np.where(inner & (rng.random(len(cube)) < 0.5), -1.0, 1.0)
    gradient = sign[:, None] * np.array([[1.0, 0, 0]])
    band = Band(cube @ STEP, np.full(len(cube), 0.1), gradient, 0.0)
    crossings = find_crossings(band, grid_around(np.array([[0.0, 0, 0], [6, 6, 6]]), 6))
    quads, _ = connect(crossings)
    sides = np.sort(np.concatenate([quads[:, [i, (i + 1) % 4]] for i in range(4)]), axis=1)
    _, uses = np.unique(sides, axis=0, return_counts=True)
    assert (uses % 2 == 0).all()


def test_spacing_is_that_of_the_points_and_the_resolution_follows_it() -> None:
    near = surfaces.sampled(surfaces.sphere(), 10_000)
    expected = np.sqrt(np.pi / 10_000)  # area of a sphere of radius ½
    assert abs(np.median(point_spacing(near)) / expected - 1) < 0.1
    assert auto_resolution(near) == pytest.approx(1.5 / expected, rel=0.15)
    assert auto_resolution(near[:120]) == 48
    assert auto_resolution(surfaces.sampled(surfaces.sphere(), 50_000)) > 1.9 * auto_resolution(near)
    assert point_spacing(np.repeat(near[:200], 20, axis=0)).min() > 0
