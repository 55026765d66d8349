"""What each of the inputs that were once misread means (`misread` of the test data): told of a reading."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.points.clean_cloud import cloud_points
from tests.support.odd.truth import Judge

_SIZE = (0.6, 0.4, 0.2)  # of most of them: an ellipsoid, of points in red, green and a dark blue or of triangles
_COLOURS = (127, 128, 40)
_SURVEY = (345_678, 5_432_100, 321)
_CHART = (
    *((255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 200, 0)),
    *((200, 60, 40), (30, 120, 60), (128, 128, 128), (20, 60, 160)),
)


def files_of(data_dir: Path, name: str) -> dict[str, bytes]:
    """The files of an input by their names, without its README; a zip is called scan.zip."""
    files = {path.name: path.read_bytes() for path in sorted((data_dir / "misread" / name).iterdir())}
    del files["README"]
    return {("scan.zip" if file.endswith(".zip") else file): data for file, data in files.items()}


def solid(points: int, colours: tuple[int, int, int] | None, size: tuple[float, ...] = _SIZE) -> Judge:
    """So many points, of this size in metres, and of these colours in the mean; points: at least, where negative."""

    def judge(capture: Capture) -> str:
        cloud = capture.cloud
        if cloud is None or (len(cloud.xyz) != points if points > 0 else len(cloud.xyz) < -points):
            return f"{0 if cloud is None else len(cloud.xyz):,} points"
        extent = np.ptp(cloud.xyz, axis=0) * capture.metres_per_unit
        if np.abs(extent - size).max() > 0.02:
            return f"{extent.round(2).tolist()} m"
        if colours is None or cloud.rgb is None:
            return (
                ""
                if colours is None and cloud.rgb is None
                else "colours that it has not"
                if cloud.rgb is not None
                else "no colours"
            )
        mean = cloud.rgb.mean(axis=0)
        return f"colours of {mean.round().tolist()} in the mean" if np.abs(mean - colours).max() > 2 else ""

    return judge


def all_of(*judges: Judge) -> Judge:
    """The first fault that one of several finds."""
    return lambda capture: next(filter(None, (judge(capture) for judge in judges)), "")


def surveyed(place: tuple[float, ...] = _SURVEY) -> Judge:
    """Z is up, and the manifest's offset is the survey's."""

    def judge(capture: Capture) -> str:
        offset = cloud_points(capture).offset
        if capture.up is None or tuple(capture.up) != (0, 0, 1):
            return f"{capture.up} is up"
        return "" if offset is not None and np.abs(offset - place).max() < 10 else f"an offset of {offset}"

    return judge


def _without_notch(capture: Capture) -> str:
    assert capture.cloud is not None
    xyz = capture.cloud.xyz
    beyond = ((xyz[:, 0] > 1.05) & (xyz[:, 1] > 1.05)).mean()
    return f"{100 * beyond:.0f} % of the points outside of the floor" if beyond else ""


def split_views(count: int, side: int) -> Judge:
    """So many square photos, this many pixels wide."""

    def judge(capture: Capture) -> str:
        sizes = {photo.size for photo in capture.photos}
        return (
            ""
            if len(capture.photos) == count and sizes == {(side, side)}
            else f"{len(capture.photos)} photos of {sizes}"
        )

    return judge


def chart(capture: Capture) -> str:
    """The colours of eight patches, as sRGB."""
    pixels = capture.photos[0].load(None)
    height, width = pixels.shape[:2]
    places = [(height * (2 * row + 1) // 4, width * (2 * column + 1) // 8) for row in range(2) for column in range(4)]
    off = np.abs(np.array([pixels[place] for place in places], float) - _CHART).max()
    return f"colours off by up to {off:.0f}" if off > 4 else ""


MISREAD: dict[str, Judge] = {
    "csv_name_first": solid(3_000, None),
    "csv_pandas_index": solid(3_000, _COLOURS),
    "csv_units": solid(3_000, _COLOURS),
    "glb_emissive_only": solid(100_000, (128, 127, 40)),
    "glb_points": solid(3_000, _COLOURS),
    "gltf_asset_late": solid(100_000, None),
    "las_rgb_all_zero": solid(3_000, (130, 130, 130)),
    "las_us_feet": solid(3_000, _COLOURS, (12, 8, 4)),
    "obj_concave": all_of(solid(100_000, None, (4, 3, 2.5)), _without_notch),
    "obj_cp1252_names": solid(100_000, _COLOURS),
    "obj_grey16_texture": solid(100_000, (128, 128, 128)),
    "pack_backslashes_zip": solid(-1_000, _COLOURS),
    "photo_p3_chart": chart,
    "photos_equirect_small": split_views(80, 160),
    "ply_ascii_face_scalar_first": solid(100_000, _COLOURS),
    "ply_float_colour_over_one": solid(3_000, _COLOURS),
    "ply_nan_40pct": solid(3_000, _COLOURS),
    "ply_openmvs_views": solid(3_000, _COLOURS),
    "pts_two_scans": solid(3_000, _COLOURS),
    "stl_trailing": solid(100_000, None),
    "tab_decimal_comma_room": solid(-1_000, None, (6, 4, 2.5)),
    "tab_excel_unicode": solid(3_000, _COLOURS),
    "xyz_msvc_nan": solid(2_940, _COLOURS),
    "xyz_utm": all_of(solid(-1_000, None, (6, 4, 2.5)), surveyed()),
}
