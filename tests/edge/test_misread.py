"""Files that were once misread: small ones of many programs, each with what it means (`misread` of the test data)."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from capture2vr.edge.capture.nouns import Capture, Cloud
from capture2vr.edge.points.clean_cloud import cloud_points
from capture2vr.edge.read_capture import read_capture
from capture2vr.process.archives import unpack

SIZE = (0.6, 0.4, 0.2)  # of most of them: an ellipsoid, of points in red, green and a dark blue or of triangles
COLOURS = (127, 128, 40)


def read(data_dir: Path, name: str, folder: Path) -> Capture:
    """Read a folder of the test data without its README; a zip is unpacked."""
    shutil.copytree(data_dir / "misread" / name, folder / name, copy_function=shutil.copyfile)
    (folder / name).chmod(0o755)
    (folder / name / "README").unlink()
    files = list((folder / name).iterdir())
    if files[0].suffix == ".zip":
        unpack(files[0], folder / "unpacked")
        return read_capture(folder / "unpacked")
    return read_capture(files[0] if len(files) == 1 else folder / name)


def cloud_of(capture: Capture) -> Cloud:
    assert capture.cloud is not None
    return capture.cloud


@pytest.mark.parametrize(
    ("name", "points", "colours"),
    [
        ("csv_name_first", 3_000, None),
        ("csv_pandas_index", 3_000, COLOURS),
        ("csv_units", 3_000, COLOURS),
        ("glb_emissive_only", 100_000, (128, 127, 40)),
        ("glb_points", 3_000, COLOURS),
        ("gltf_asset_late", 100_000, None),
        ("las_rgb_all_zero", 3_000, (130, 130, 130)),
        ("obj_cp1252_names", 100_000, COLOURS),
        ("obj_grey16_texture", 100_000, (128, 128, 128)),
        ("ply_ascii_face_scalar_first", 100_000, COLOURS),
        ("ply_float_colour_over_one", 3_000, COLOURS),
        ("ply_nan_40pct", 3_000, COLOURS),
        ("ply_openmvs_views", 3_000, COLOURS),
        ("pts_two_scans", 3_000, COLOURS),
        ("stl_trailing", 100_000, None),
        ("tab_excel_unicode", 3_000, COLOURS),
        ("xyz_msvc_nan", 2_940, COLOURS),
    ],
)
def test_an_ellipsoid_is_one(
    name: str, points: int, colours: tuple[int, int, int] | None, data_dir: Path, tmp_path: Path
) -> None:
    cloud = cloud_of(read(data_dir, name, tmp_path))
    assert len(cloud.xyz) == points
    np.testing.assert_allclose(np.ptp(cloud.xyz, axis=0), SIZE, atol=0.01)
    if colours is None:
        assert cloud.rgb is None
    else:
        assert cloud.rgb is not None
        np.testing.assert_allclose(cloud.rgb.mean(axis=0), colours, atol=2)


@pytest.mark.parametrize("name", ["tab_decimal_comma_room", "xyz_utm"])
def test_a_room_is_six_metres_long(name: str, data_dir: Path, tmp_path: Path) -> None:
    capture = read(data_dir, name, tmp_path)
    np.testing.assert_allclose(np.ptp(cloud_of(capture).xyz, axis=0), (6, 4, 2.5), atol=0.01)
    if name == "xyz_utm":
        np.testing.assert_array_equal(cloud_of(capture).origin, (345_678, 5_432_100, 321))
        np.testing.assert_array_equal(capture.up, (0, 0, 1))
        offset = cloud_points(capture).offset
        assert offset is not None
        np.testing.assert_array_equal(offset, (345_678, 5_432_100, 321))


def test_the_notch_of_a_floor_plan_has_no_floor(data_dir: Path, tmp_path: Path) -> None:
    xyz = cloud_of(read(data_dir, "obj_concave", tmp_path)).xyz
    np.testing.assert_allclose(np.ptp(xyz, axis=0), (4, 3, 2.5), atol=0.01)
    assert not ((xyz[:, 0] > 1.05) & (xyz[:, 1] > 1.05)).any()


def test_panoramas_are_split_into_views(data_dir: Path, tmp_path: Path) -> None:
    photos = read(data_dir, "photos_equirect_small", tmp_path).photos
    assert len(photos) == 80
    assert {photo.size for photo in photos} == {(160, 160)}


def test_feet_are_no_metres(data_dir: Path, tmp_path: Path) -> None:
    capture = read(data_dir, "las_us_feet", tmp_path)
    metres = np.ptp(cloud_of(capture).xyz, axis=0) * capture.metres_per_unit
    np.testing.assert_allclose(metres, (12, 8, 4), atol=0.02)


def test_folders_with_backslashes_are_folders(data_dir: Path, tmp_path: Path) -> None:
    capture = read(data_dir, "pack_backslashes_zip", tmp_path)
    assert len(cloud_of(capture).xyz) > 1_000


def test_photos_in_display_p3_have_the_colours_that_were_seen(data_dir: Path, tmp_path: Path) -> None:
    chart = read(data_dir, "photo_p3_chart", tmp_path).photos[0].load(None)
    height, width = chart.shape[:2]
    places = [(height * (2 * row + 1) // 4, width * (2 * column + 1) // 8) for row in range(2) for column in range(4)]
    wanted = [
        *((255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 200, 0)),
        *((200, 60, 40), (30, 120, 60), (128, 128, 128), (20, 60, 160)),
    ]
    np.testing.assert_allclose([chart[place] for place in places], wanted, atol=4)
