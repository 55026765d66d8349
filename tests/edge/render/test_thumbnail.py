"""The pictures of a page: what they show, from where, how many bytes they take, and that they turn."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy.spatial import ConvexHull

from capture2vr.edge.arrays import Bools, Bytes, Floats
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.render.thumbnail import THUMBNAIL_BYTES, TURNING_BYTES, thumbnail, turning_preview
from tests.support import surfaces
from tests.support.photos.painted import jpeg, painted, quarters

WEDGE = Mesh(  # convex, and no two of its sides look alike
    np.array([[-1.0, 0, -0.3], [-1, 0, 0.3], [1, 0, -0.3], [1, 0, 0.5], [0.8, 0.9, 0.1]]),
    np.array([[0, 1, 3], [0, 3, 2], [0, 1, 4], [1, 3, 4], [3, 2, 4], [2, 0, 4]]),
)
TRIANGLE = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
SHEET = surfaces.patch(lambda u, v: [u, v, 0 * u], 16, 16)  # upright, its front to +Z


def frames(webp: bytes) -> list[Bytes]:
    """(S,S,4) each."""
    with Image.open(io.BytesIO(webp)) as opened:
        shown = []
        for number in range(getattr(opened, "n_frames", 1)):
            opened.seek(number)
            shown.append(np.asarray(opened.convert("RGBA")))
    return shown


def solid(frame: Bytes) -> Bools:
    return frame[..., 3] > 127


def outline(azimuth: float, side: int) -> Bools:
    """(side,side) the wedge's convex hull from azimuth° and 18° above, by the formula of a pinhole.

    All frames are taken from as near as the one that needs most room allows: 28° wide, with a margin of 6 %.
    """
    centred = WEDGE.vertices - (WEDGE.vertices.min(axis=0) + WEDGE.vertices.max(axis=0)) / 2
    seen = [centred @ axes(30 - 15 * frame).T for frame in range(24)]
    away = max((1.06 * np.abs(each[:, :2]).max(axis=1) / 0.25 + each[:, 2]).max() for each in seen)
    right, up, toward = (centred @ axes(azimuth).T).T
    places = side / 2 * (1 + np.stack([right, -up], axis=1) / (away - toward)[:, None] / 0.25)
    drawn = Image.new("1", (side, side))
    ImageDraw.Draw(drawn).polygon([tuple(place - 0.5) for place in places[ConvexHull(places).vertices]], fill=1)
    return np.asarray(drawn)


def axes(azimuth: float) -> Floats:
    """(3,3) right, up and towards the viewer, at 18° above the floor."""
    turn, tilt = np.radians(azimuth), np.radians(18)
    toward = np.array([np.cos(tilt) * np.sin(turn), np.sin(tilt), np.cos(tilt) * np.cos(turn)])
    right = np.array([np.cos(turn), 0, -np.sin(turn)])
    return np.stack([right, np.cross(toward, right), toward])


def overlap(one: Bools, other: Bools) -> float:
    return float((one & other).sum() / (one | other).sum())


def brightness(frame: Bytes) -> float:
    return float(frame[solid(frame)][:, :3].mean())


def dice() -> Mesh:
    """A cube whose sides +X, +Y, +Z are red, green, blue, and all others yellow."""
    cube = surfaces.cube()
    rgb = np.tile(np.array([255, 255, 0], np.uint8), (len(cube.vertices), 1))
    seen_from = (cube.vertices.reshape(6, -1, 3)).mean(axis=1)
    for axis, colour in enumerate(([255, 0, 0], [0, 255, 0], [0, 0, 255])):
        (side,) = np.flatnonzero(seen_from[:, axis] > 0.49)
        rgb.reshape(6, -1, 3)[side] = colour
    return replace(cube, rgb=rgb)


def share(frame: Bytes, strong: tuple[int, ...], weak: tuple[int, ...]) -> float:
    """Of the thing's pixels, how many are strong in these channels and weak in those."""
    pixels = frame[solid(frame)].astype(int)
    return float((pixels[:, strong].min(axis=1) > 2 * pixels[:, weak].max(axis=1)).mean())


def test_a_thumbnail_is_a_small_picture_on_nothing() -> None:
    webp = thumbnail(surfaces.mobius())
    (frame,) = frames(webp)
    assert Image.open(io.BytesIO(webp)).format == "WEBP"
    assert frame.shape == (256, 256, 4)
    assert len(webp) <= THUMBNAIL_BYTES
    border = np.concatenate([frame[0], frame[-1], frame[:, 0], frame[:, -1]])
    assert not border[:, 3].any()
    rows, columns = np.nonzero(solid(frame))
    assert max(np.ptp(rows), np.ptp(columns)) > 200


def test_it_shows_front_right_side_and_top_but_neither_back_nor_bottom() -> None:
    (frame,) = frames(thumbnail(dice()))
    right, top, front = (share(frame, (axis,), tuple({0, 1, 2} - {axis})) for axis in range(3))
    assert front > right > top > 0.1
    assert right + top + front > 0.95
    assert share(frame, (0, 1), (2,)) < 0.06  # where red meets green


@pytest.mark.slow
def test_frames_turn_once_round() -> None:
    shown = frames(turning_preview(WEDGE))
    assert len(shown) == 24
    outlines = [outline(30 - 15 * frame, 192) for frame in range(24)]
    for number, frame in enumerate(shown):
        alike = [overlap(solid(frame), other) for other in outlines]
        assert alike[number] > 0.95  # Pillow draws outlines half a pixel too far out
        assert int(np.argmax(alike)) == number


@pytest.mark.slow
def test_the_animation_loops_for_ever_and_keeps_within_its_bytes() -> None:
    webp = turning_preview(painted(WEDGE, 200, 40, 40))
    with Image.open(io.BytesIO(webp)) as opened:
        opened.load()
        assert opened.info["loop"] == 0
        assert opened.info["duration"] == 125
        assert opened.size == (192, 192)
    assert len(webp) <= TURNING_BYTES
    first, middle = frames(webp)[0], frames(webp)[12]
    for frame in (first, middle):
        assert share(frame, (0,), (1, 2)) > 0.95


@pytest.mark.slow
def test_both_sides_of_an_open_surface_are_lit() -> None:
    shown = frames(turning_preview(painted(SHEET, 180, 180, 180)))
    front, back = brightness(shown[2]), brightness(shown[14])
    assert front > 90
    assert back > 90


def test_a_picture_on_the_surface_is_where_its_coordinates_say() -> None:
    uv = np.stack([SHEET.vertices[:, 0] + 0.5, 0.5 - SHEET.vertices[:, 1]], axis=1)
    (frame,) = frames(thumbnail(TexturedMesh(SHEET, uv, quarters(), 64)))
    rows, columns = np.nonzero(solid(frame))
    top, bottom, left, right = rows.min(), rows.max(), columns.min(), columns.max()
    half_way = (top + bottom) // 2, (left + right) // 2

    def middle(row: int, column: int) -> NDArray[np.int64]:
        place = (row + half_way[0]) // 2, (column + half_way[1]) // 2
        return np.asarray(frame[place], np.int64)

    red, blue, green, yellow = (middle(row, column) for row in (top, bottom) for column in (left, right))
    assert red[0] > 2 * red[1:3].max()
    assert blue[2] > 2 * blue[:2].max()
    assert green[1] > 2 * green[[0, 2]].max()
    assert yellow[:2].min() > 2 * yellow[2]


def test_one_colour_is_the_same_from_a_picture_and_from_vertices() -> None:
    green = jpeg(np.full((64, 64, 3), (120, 200, 80), np.uint8))
    uv = np.full((len(SHEET.vertices), 2), 0.5)
    (one,), (other,) = (
        frames(thumbnail(TexturedMesh(SHEET, uv, green, 64))),
        frames(thumbnail(painted(SHEET, 120, 200, 80))),
    )
    both = solid(one) & solid(other)
    assert both.sum() > 0.98 * solid(one).sum()
    assert np.abs(one[both].astype(int) - other[both]).mean() < 3


@pytest.mark.slow
def test_colours_that_do_not_compress_still_keep_within_the_bytes() -> None:
    rough = surfaces.patch(lambda u, v: [u, v, 0.2 * np.sin(90 * u) * np.sin(80 * v)], 120, 120)
    rng = np.random.default_rng(0)
    noisy = replace(rough, rgb=rng.choice(np.array([0, 255], np.uint8), (len(rough.vertices), 3)))
    assert len(thumbnail(noisy)) <= THUMBNAIL_BYTES
    assert len(turning_preview(noisy)) <= TURNING_BYTES


@pytest.mark.slow
def test_a_thing_full_of_gaps_keeps_within_the_bytes() -> None:
    rng = np.random.default_rng(0)
    leaves = rng.normal(size=(25_000, 1, 3))
    leaves *= 0.5 * rng.random((25_000, 1, 1)) ** (1 / 6) / np.linalg.norm(leaves, axis=2, keepdims=True)
    corners = leaves + rng.normal(size=(25_000, 3, 3)) * 0.006
    bush = Mesh(corners.reshape(-1, 3), np.arange(75_000).reshape(-1, 3))
    assert len(thumbnail(bush)) <= THUMBNAIL_BYTES
    assert len(turning_preview(bush)) <= TURNING_BYTES


@pytest.mark.parametrize("size", [1e-20, 1e-3, 1e7, 1e30])
def test_any_size_and_place_gives_the_same_picture(size: float) -> None:
    (usual,) = frames(thumbnail(WEDGE))
    (other,) = frames(thumbnail(replace(WEDGE, vertices=(WEDGE.vertices + 100) * size)))
    assert overlap(solid(usual), solid(other)) > 0.99
    assert abs(brightness(usual) - brightness(other)) < 3


@pytest.mark.slow
def test_a_single_triangle_and_a_sheet_on_edge_have_pictures() -> None:
    (frame,) = frames(thumbnail(TRIANGLE))
    assert 0.1 < solid(frame).mean() < 0.6
    filled = [solid(frame).sum() for frame in frames(turning_preview(TRIANGLE))]
    assert max(filled) > 20 * min(filled)


def test_a_mesh_without_area_is_an_empty_picture_and_one_without_faces_is_refused() -> None:
    (frame,) = frames(thumbnail(replace(TRIANGLE, vertices=np.full((3, 3), 7.0))))
    assert not frame[..., 3].any()
    nothing = Mesh(np.zeros((3, 3)), np.empty((0, 3), np.int64))
    for picture in (thumbnail, turning_preview):
        with pytest.raises(ValueError, match="without faces"):
            picture(nothing)


def test_the_same_mesh_gives_the_same_bytes() -> None:
    assert thumbnail(dice()) == thumbnail(dice())


def test_a_cancelled_job_stops_between_frames() -> None:
    told: list[float] = []

    def heard(fraction: float) -> None:
        told.append(fraction)
        if fraction > 0.4:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        turning_preview(TRIANGLE, tick=heard)
    assert told == sorted(told)
    assert told[0] == 0
    assert len(told) < 20
