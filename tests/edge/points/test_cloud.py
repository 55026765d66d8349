"""Cleaning clouds: strays go, surfaces of any density stay, coordinates and colours keep their precision."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.nouns import Capture, Cloud
from capture2vr.edge.capture_to_points import to_points
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.origin import FILLED, marked
from capture2vr.edge.points.downsample import downsample_points, voxel_downsample, voxel_downsample_to
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.points.outliers import inliers, label_components
from capture2vr.edge.points.unit import unit_frame
from capture2vr.edge.points.voxel_grid import cell_keys, key_cells, sum_groups
from capture2vr.edge.read_capture import read_capture


def cloud(xyz: Floats, rgb: Bytes | None = None) -> Capture:
    return Capture(kind="points", format="ply", cloud=Cloud(np.asarray(xyz, np.float64), rgb))


def sphere(count: int, seed: int = 0) -> Floats:
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True) / 2


def hemisphere(count: int) -> Floats:
    points = sphere(count)
    points[:, 2] = np.abs(points[:, 2])
    return points


def sheets(count: int) -> Floats:
    """Two square sheets 0.06 apart."""
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (count, 3))
    points[:, 2] = np.where(np.arange(count) % 2, 0.03, -0.03)
    return points


def wires(count: int) -> Floats:
    """Two crossing tubes of 8 mm on 1 m: as thin as the legs of a toy."""
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, count)
    points = np.stack([rng.uniform(-0.5, 0.5, count), 0.004 * np.cos(angle), 0.004 * np.sin(angle)], axis=1)
    points[::2] = points[::2, [1, 0, 2]]
    return points


SURFACES = [sphere, hemisphere, sheets, wires]


@pytest.mark.parametrize("surface", SURFACES)
def test_clean_points_stay(surface) -> None:  # type: ignore[no-untyped-def]
    xyz = surface(10_000)
    assert len(to_points(cloud(xyz))) >= 0.999 * len(xyz)


@pytest.mark.parametrize("surface", [sphere, hemisphere, sheets])
def test_noisy_points_stay(surface) -> None:  # type: ignore[no-untyped-def]
    xyz = surface(10_000) + np.random.default_rng(1).normal(0, 0.005, (10_000, 3))
    assert len(to_points(cloud(xyz))) >= 0.995 * len(xyz)


@pytest.mark.slow
@pytest.mark.parametrize(("surface", "count"), [(sphere, 10_000), (hemisphere, 10_000), (sphere, 100_000)])
def test_strays_in_the_box_go(surface, count: int) -> None:  # type: ignore[no-untyped-def]
    xyz = surface(count)
    strays = np.random.default_rng(2).uniform(xyz.min(axis=0), xyz.max(axis=0), (count // 20, 3))
    points = to_points(cloud(np.concatenate([xyz, strays])))
    tree = cKDTree(points.xyz)
    off_surface, _ = cKDTree(xyz).query(strays)
    spacing = np.median(cKDTree(xyz).query(xyz[:2000], k=11)[0][:, 1:])
    told_apart = strays[off_surface > 3 * spacing]
    assert np.sum(tree.query(told_apart)[0] < 1e-9) <= 0.01 * len(told_apart)
    assert np.mean(tree.query(xyz)[0] < 1e-9) >= 0.997
    assert any("stray" in warning for warning in points.warnings)


def test_a_part_sampled_ten_times_thinner_stays() -> None:
    xyz = sphere(40_000)
    thinned = xyz[(xyz[:, 2] > 0) | (np.random.default_rng(3).random(len(xyz)) < 0.1)]
    kept = to_points(cloud(thinned)).xyz
    assert np.sum(kept[:, 2] <= 0) > 0.98 * np.sum(thinned[:, 2] <= 0)


def test_a_small_separate_part_stays() -> None:
    button = sphere(60, seed=4) * 0.02 + [0.8, 0, 0]
    kept = to_points(cloud(np.concatenate([sphere(10_000), button]))).xyz
    assert np.sum(kept[:, 0] > 0.6) == 60


def test_duplicates_count_once() -> None:
    xyz = sphere(2_000)
    assert len(to_points(cloud(np.repeat(xyz, 5, axis=0)))) == pytest.approx(2_000, abs=2)


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_georeferenced_coordinates_keep_their_precision(offset: float) -> None:
    xyz = sphere(5_000)
    kept = to_points(cloud(xyz + offset)).xyz
    assert kept.dtype == np.float64
    assert cKDTree(xyz).query(kept - offset)[0].max() < 1e-9


@pytest.mark.parametrize("count", [0, 1, 99])
def test_too_few_points_are_a_named_error(count: int) -> None:
    with pytest.raises(CaptureError) as error:
        to_points(cloud(np.repeat(sphere(count), 3, axis=0)))
    assert error.value.code == "CAPTURE_TOO_FEW_POINTS"
    assert str(count) in error.value.message


def test_values_that_are_not_finite_are_dropped() -> None:
    xyz = sphere(1_000)
    xyz[7] = np.nan
    xyz[8, 1] = np.inf
    assert len(to_points(cloud(xyz))) == 998


@pytest.mark.slow
def test_a_huge_cloud_is_thinned_and_keeps_its_colours() -> None:
    xyz = sphere(1_100_000)
    rgb = np.full((len(xyz), 3), [10, 200, 30], np.uint8)
    points = to_points(cloud(xyz, rgb))
    assert 500_000 < len(points) <= 1_000_000
    assert points.rgb is not None
    assert np.array_equal(np.unique(points.rgb, axis=0), [[10, 200, 30]])
    assert np.abs(np.linalg.norm(points.xyz, axis=1) - 0.5).max() < 1e-5


@pytest.mark.parametrize("far", [100.0, 1_000.0, 10_000.0])
def test_one_stray_point_far_away_does_not_thin_the_others_to_a_few(far: float) -> None:
    room = np.random.default_rng(0).random((20_000, 3)) * [20, 20, 0.01]
    kept, _ = voxel_downsample_to(np.concatenate([room, [[far, 0, 0]]]), None, 10_000)
    assert 5_000 <= len(kept) <= 10_000


def test_a_street_is_thinned_by_its_area_and_not_by_its_length() -> None:
    street = np.random.default_rng(0).random((20_000, 3)) * [1_000, 10, 0.01]
    assert 5_000 <= len(voxel_downsample_to(street, None, 10_000)[0]) <= 10_000


def test_points_at_few_places_are_thinned_to_these() -> None:
    places = np.random.default_rng(0).random((20, 3))
    assert len(voxel_downsample_to(np.repeat(places, 10, axis=0), None, 100)[0]) == 20


def test_a_voxel_asked_for_is_the_spacing() -> None:
    kept = to_points(cloud(sphere(20_000)), voxel=0.05).xyz
    spacing, _ = cKDTree(kept).query(kept, k=2)
    assert 0.02 < np.median(spacing[:, 1]) < 0.06


def test_thinning_averages_light_not_codes() -> None:
    xyz = np.array([[0.1, 0.1, 0.1], [0.2, 0.2, 0.2]])
    _, rgb = voxel_downsample(xyz, np.array([[0, 0, 0], [255, 255, 255]], np.uint8), 1.0)
    assert rgb is not None
    assert rgb.tolist() == [[188, 188, 188]]


@pytest.mark.parametrize(("size", "metres"), [(0.06, 0.06), (1.0, 1.0), (29.0, 29.0), (0.01, 1.0), (1800.0, 1.0)])
def test_an_unknown_unit_is_metres_where_that_is_plausible(size: float, metres: float) -> None:
    points = to_points(cloud(sphere(1_000) * size))
    longest = float(np.ptp(points.xyz, axis=0).max())
    assert longest * points.metres_per_unit == pytest.approx(metres, rel=0.05)
    assert points.scale_confidence == "unknown"
    assert bool(points.warnings) == (size != metres)


def test_a_known_unit_is_kept() -> None:
    capture = Capture("points", "las", Cloud(sphere(1_000) * 1800), metres_per_unit=0.3048, scale_confidence="metric")
    points = to_points(capture)
    assert points.metres_per_unit == 0.3048
    assert points.scale_confidence == "metric"
    assert not points.warnings


@settings(max_examples=30)
@given(
    offset=st.floats(-1e6, 1e6),
    scale=st.floats(1e-3, 1e3),
    seed=st.integers(0, 1000),
)
def test_the_unit_frame_goes_there_and_back(offset: float, scale: float, seed: int) -> None:
    xyz = np.random.default_rng(seed).normal(size=(50, 3)) * scale + offset
    frame = unit_frame(xyz)
    unit = frame.to_unit(xyz)
    assert np.ptp(unit, axis=0).max() == pytest.approx(1.0, rel=1e-6)
    assert np.abs(unit.max(axis=0) + unit.min(axis=0)).max() < 1e-6
    assert np.abs(frame.to_world(unit) - xyz).max() <= 1e-9 * max(scale, abs(offset), 1.0)


@pytest.mark.parametrize(
    ("xyz", "code"), [(np.zeros((0, 3)), "CAPTURE_EMPTY"), (np.ones((5, 3)), "CAPTURE_DEGENERATE")]
)
def test_no_extent_has_no_unit_frame(xyz: Floats, code: str) -> None:
    with pytest.raises(CaptureError) as error:
        unit_frame(xyz)
    assert error.value.code == code


@given(st.lists(st.tuples(*[st.integers(0, 2**21 - 1)] * 3), min_size=1))
def test_keys_and_cells_are_one_to_one(cells: list[tuple[int, int, int]]) -> None:
    assert key_cells(cell_keys(np.array(cells))).tolist() == [list(cell) for cell in cells]


@given(st.lists(st.integers(0, 5), min_size=1, max_size=50))
def test_group_sums_keep_the_total(keys: list[int]) -> None:
    values = np.arange(2 * len(keys), dtype=np.float64).reshape(-1, 2)
    distinct, sums = sum_groups(np.array(keys), values)
    assert distinct.tolist() == sorted(set(keys))
    assert np.allclose(sums.sum(axis=0), values.sum(axis=0))


def test_components_are_numbered_by_size() -> None:
    label = label_components(np.concatenate([sphere(100) + 5, sphere(1_000)]), 0.3)
    assert set(label[:100]) == {1}
    assert set(label[100:]) == {0}


@pytest.mark.parametrize("far", [50.0, 1e3, 1e6])
def test_strays_far_away_cost_no_other_point(far: float) -> None:
    """At 1,000 km, a millionth of the extent is the size of the thing."""
    xyz = np.vstack([sphere(14_000), [[far, 0, 0], [0, -far, far]]])
    assert 13_900 < len(to_points(cloud(xyz))) <= 14_000


def test_a_handful_of_points_has_no_strays() -> None:
    assert inliers(sphere(5)).all()


@pytest.mark.data
@pytest.mark.parametrize("file", ["cloud_room/frag_115.ply", "cloud_room/fragment.pcd"])
def test_real_clouds_lose_next_to_nothing(data_dir: Path, file: str) -> None:
    capture = read_capture(data_dir / file)
    assert capture.cloud is not None
    points = to_points(capture)
    assert len(points) > 0.999 * len(np.unique(capture.cloud.xyz, axis=0))
    assert points.metres_per_unit == 1.0


@pytest.mark.data
def test_real_dress_survives_strays(data_dir: Path) -> None:
    dress = trimesh.load(data_dir / "dress" / "dress-v17k-f34k.obj", force="mesh", process=False)
    xyz = trimesh.sample.sample_surface(dress, 10_000, seed=1)[0]
    strays = np.random.default_rng(0).uniform(*dress.bounds, (500, 3))
    kept = cKDTree(to_points(cloud(np.concatenate([xyz, strays]))).xyz)
    assert np.mean(kept.query(xyz)[0] < 1e-9) > 0.998


@given(st.integers(200, 3000), st.integers(100, 1000))
def test_at_most_is_at_most_and_keeps_the_extent(count: int, most: int) -> None:
    xyz = np.random.default_rng(count).random((count, 3)) * [1.0, 2.0, 0.001]
    inferred = xyz[:, 1] > 1
    points = Points(xyz, None, np.ones(count, np.float32), 1.0, "metric", None, origin=marked(inferred, FILLED))
    fewer = downsample_points(points, most)
    assert fewer.origin is not None
    filled = fewer.origin == FILLED
    assert (filled == (fewer.xyz[:, 1] > 1)).mean() > 0.8, "each voxel is what its nearest point is"
    assert len(fewer) <= most
    assert len(fewer.confidence) == len(fewer)
    assert len(fewer) == count if count <= most else len(fewer) >= most / 2
    assert np.ptp(fewer.xyz, axis=0)[1] > 1.5
    assert bool(fewer.warnings) == (count > most)
