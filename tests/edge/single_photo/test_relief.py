"""A printed relief: the shape of an inflated outline, the photo on its front, and what the tap cuts out."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import cv2
import numpy as np
import pytest

from capture2vr.edge.arrays import Bools, Bytes, no_tick
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.place_views import posed_picture
from capture2vr.edge.render.sample_image import bilinear, pixels_at
from capture2vr.edge.single_photo.cutout import cut_out
from capture2vr.edge.single_photo.membrane import closed_mesh, inflate
from capture2vr.edge.single_photo.outline_kind import Inflation, OutlineKind, inflation_of
from capture2vr.edge.single_photo.printed_views import continued, toned_down
from capture2vr.edge.single_photo.relief import make_relief
from capture2vr.edge.single_photo.to_points import to_points
from capture2vr.order.photo_box import PhotoBox
from tests.support.photos.single_photos import photo

SIDE = 160


def disc(radius: float = 60, *, side: int = SIDE, at: tuple[int, int] | None = None) -> Bools:
    """A disc around a pixel (x, y), by default the middle."""
    y, x = np.mgrid[:side, :side] - np.array(at[::-1] if at else ((side - 1) / 2,) * 2)[:, None, None]
    return np.asarray(x**2 + y**2 < radius**2)


def drawn(*polygon: tuple[int, int]) -> Bools:
    """A filled polygon of pixels (x, y)."""
    return np.asarray(cv2.fillPoly(np.zeros((SIDE, SIDE), np.uint8), [np.array(polygon)], 1) > 0)


def volume(mesh: Mesh) -> float:
    """Volume that a closed mesh encloses; negative where its faces are wound inwards."""
    corners = mesh.vertices[mesh.faces]
    return float(np.einsum("fx,fx->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def border_edges(mesh: Mesh) -> int:
    """Number of edges that do not have one face on each side."""
    edges = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return int((np.unique(edges, axis=0, return_counts=True)[1] != 2).sum())


def patterned(mask: Bools, *, seed: int = 0) -> Bytes:
    """A photo of a thing in a pattern of two colours, which its mask shows, before a grey wall."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: mask.shape[0], : mask.shape[1]]
    wave = (np.sin(x / 6) * np.sin(y / 9))[..., None]
    thing = np.array([190, 70, 40]) + 40 * wave
    return np.clip(np.where(mask[..., None], thing, 150) + rng.normal(0, 2, (*mask.shape, 3)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_a_disc_inflates_to_an_ellipsoid_of_known_height(share: float) -> None:
    height = inflate(disc(60), Inflation(share)).height

    y, x = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    inner = x**2 + y**2 < 50**2
    true = share * np.sqrt(60**2 - x**2 - y**2, where=inner, out=np.zeros((SIDE, SIDE)))
    assert np.abs(height - true)[inner].max() < 1.5  # pixels, half of which is the edge that every part has


def test_a_strip_inflates_to_a_cylinder() -> None:
    mask = np.zeros((SIDE, SIDE), bool)
    mask[70:90, 5:-5] = True

    height = inflate(mask, Inflation(1 / np.sqrt(2))).height

    assert height[79:81, 60:100].mean() == pytest.approx(10, abs=0.7)  # half of its width


def test_with_a_limit_what_is_wide_is_a_plate() -> None:
    mask = np.zeros((SIDE, SIDE), bool)
    mask[20:140, 30:130] = True

    height = inflate(mask, Inflation(thickness=6.0, limit=4.0)).height

    assert np.ptp(height[50:110, 60:100]) < 0.1
    assert height[80, 80] == pytest.approx(6, abs=0.3)


@pytest.mark.parametrize(
    "mask",
    [
        disc(),
        disc() & ~disc(20),
        disc(25, at=(40, 40)) | disc(30, at=(110, 100)),
        drawn((20, 20), (140, 25), (90, 60), (95, 150), (85, 150), (80, 60)),
        drawn((20, 78), (140, 78), (140, 80), (20, 80)),
    ],
    ids=["disc", "ring", "two", "thin leg", "needle"],
)
@pytest.mark.parametrize("inflation", [Inflation(0.7), Inflation(3.0, 20.0)], ids=["ball", "plate"])
def test_the_mesh_is_closed_and_symmetric_with_its_outside_out(mask: Bools, inflation: Inflation) -> None:
    mesh = closed_mesh(inflate(mask, inflation))

    assert border_edges(mesh) == 0
    assert volume(mesh) > mask.sum()  # thicker than a pixel
    assert np.abs(mesh.vertices[:, 2].max() + mesh.vertices[:, 2].min()) < 1e-3


def test_its_outline_is_that_of_the_mask() -> None:
    mask = drawn((20, 20), (140, 25), (90, 60), (95, 150), (85, 150), (80, 60))

    found = inflate(mask, Inflation(0.7)).squared > 0

    assert (found & mask).sum() / (found | mask).sum() > 0.96


def leaf() -> Bools:
    return disc(70, side=200, at=(100, 50)) & disc(70, side=200, at=(100, 150))


def shirt() -> Bools:
    half = [(80, 30), (95, 22), (140, 60), (125, 78), (108, 62), (108, 140)]
    return drawn(*half, *((160 - x, y) for x, y in half[:0:-1]))


@pytest.mark.parametrize(
    ("kind", "mask"),
    [
        ("round", disc()),
        ("flat", drawn((20, 40), (140, 40), (140, 120), (20, 120))),
        ("long", drawn((75, 10), (85, 10), (95, 150), (65, 150))),
        ("leaf", leaf()),
        ("garment", shirt()),
        ("other", drawn((20, 20), (60, 20), (60, 100), (140, 100), (140, 140), (20, 140))),
    ],
)
def test_outlines_are_told_apart(kind: OutlineKind, mask: Bools) -> None:
    assert inflation_of(mask)[0] == kind


def test_what_is_flat_is_inflated_less_than_what_is_round() -> None:
    thick = {}
    for mask in (disc(), leaf(), drawn((20, 40), (140, 40), (140, 120), (20, 120)), shirt()):
        kind, inflation = inflation_of(mask)
        thick[kind] = inflate(mask, inflation).height.max() / np.sqrt(mask.sum())

    assert thick["leaf"] < thick["flat"] < thick["garment"] < thick["round"] / 2


def test_colours_go_on_beside_the_thing_and_the_back_is_the_front_at_the_outline() -> None:
    mask = disc()
    rgb = np.where(mask[..., None], [200, 60, 40], [0, 0, 255]).astype(np.uint8)

    front = continued(cv2.resize(rgb, (480, 480)), mask)
    toned = toned_down(front, mask)

    assert np.abs(front.astype(int) - [200, 60, 40]).max() <= 5  # the blue wall is nowhere
    at_outline = cv2.resize((disc(60) & ~disc(59)).astype(np.uint8), (480, 480), interpolation=cv2.INTER_NEAREST) > 0
    assert np.abs(toned.astype(int) - front)[at_outline].max() < 15
    assert toned[240, 240].sum() < front[240, 240].sum()


@pytest.mark.slow
def test_the_front_is_the_photo_seen_by_its_camera() -> None:
    """Points on the front have the colours of the photo's pixels that they are seen in."""
    thing = disc(90, side=400)
    rgb = patterned(thing)

    relief = make_relief(photo(rgb), tick=no_tick)

    picture = relief.views[0].load_rgb()
    middle = picture.shape[0] // 2
    part = picture[middle - 40 : middle + 40, middle - 40 : middle + 40]
    difference = cv2.matchTemplate(rgb, np.ascontiguousarray(part), cv2.TM_SQDIFF)
    row, column = np.unravel_index(difference.argmin(), difference.shape)
    off = rgb[row : row + 80, column : column + 80].astype(float) - part
    assert (off * off).mean() < 1e-3  # the picture has the photo's own pixels, none of them resampled
    inner = relief.xyz[(relief.xyz[:, 2] > 0) & (np.hypot(*relief.xyz[:, :2].T) < 0.4)]
    at, _ = posed_picture(relief.views[0], np.eye(4)).project(inner)
    in_photo = (at * picture.shape[0] - middle + 40 + [column, row]) / rgb.shape[0]
    shown = relief.rgb[(relief.xyz[:, 2] > 0) & (np.hypot(*relief.xyz[:, :2].T) < 0.4)]
    error = bilinear(rgb, in_photo) - shown
    assert 10 * np.log10(255**2 / max(float((error**2).mean()), 1e-9)) > 40  # dB


@pytest.mark.slow
def test_depth_and_pictures_of_both_sides_belong_to_the_points() -> None:
    relief = make_relief(photo(patterned(disc(90, side=400))), tick=no_tick)

    for view, side in zip(relief.views, (1, -1), strict=True):
        chosen = relief.xyz[side * relief.xyz[:, 2] > 0.05]
        at, z = posed_picture(view, np.eye(4)).project(chosen)
        depth = pixels_at(view.load_depth_m(), at)
        assert np.abs(depth / z - 1).max() < 0.02
    spread = relief.xyz.max(axis=0) - relief.xyz.min(axis=0)
    assert spread[:2].max() == pytest.approx(1, abs=0.03)


@pytest.mark.slow
def test_points_of_one_photo_are_a_closed_guess_of_low_confidence() -> None:
    capture = Capture("image", "photo", photos=(photo(patterned(disc(90, side=400))),))

    points = to_points(capture)

    assert points.closed
    assert len(points.texture_views) == 2
    assert points.confidence.max() <= 0.2
    assert points.scale_confidence == "unknown"


def two_things() -> tuple[Bytes, Bools, Bools]:
    """A photo of two things before a wall of many colours, and their masks."""
    rng = np.random.default_rng(1)
    wall = cv2.resize(rng.integers(90, 170, (12, 16, 3)).astype(np.uint8), (400, 300), interpolation=cv2.INTER_CUBIC)
    masks = [cv2.circle(np.zeros((300, 400), np.uint8), at, 45, 1, cv2.FILLED) > 0 for at in ((110, 150), (300, 140))]
    for mask, colour in zip(masks, ((200, 30, 30), (30, 40, 210)), strict=True):
        wall[mask] = colour
    return wall, masks[0], masks[1]


@pytest.mark.slow
@pytest.mark.parametrize("which", [0, 1])
def test_a_tap_says_which_of_two_things_is_meant(which: int) -> None:
    rgb, *masks = two_things()
    tap = ((110 / 400, 150 / 300), (300 / 400, 140 / 300))[which]

    mask = cv2.resize(cut_out(photo(rgb), PhotoBox.of(tap)).mask.astype(np.uint8), (400, 300)) > 0

    assert mask[round(tap[1] * 300), round(tap[0] * 400)]
    assert (mask & masks[which]).sum() / (mask | masks[which]).sum() > 0.9


def test_a_tap_on_a_plain_sky_is_refused() -> None:
    sky = np.full((60, 80, 3), 180, np.uint8)
    sky += np.random.default_rng(0).integers(0, 4, sky.shape).astype(np.uint8)

    with pytest.raises(CaptureError) as refused:
        cut_out(photo(sky), PhotoBox.of((0.5, 0.4)))

    assert refused.value.code == "CAPTURE_NO_OBJECT"


@pytest.mark.slow
@pytest.mark.parametrize("tap", [(0.0, 0.0), (1.0, 1.0)])
def test_a_tap_on_the_edge_is_no_crash(tap: tuple[float, float]) -> None:
    rgb, *_ = two_things()
    with suppress(CaptureError):
        assert cut_out(photo(rgb), PhotoBox.of(tap)).mask.any()


def test_a_tap_chooses_among_the_parts_of_a_mask() -> None:
    rgb, first, second = two_things()
    masked = replace(photo(rgb), load_mask=lambda: first | second)

    mask = cv2.resize(cut_out(masked, PhotoBox.of((0.75, 0.47))).mask.astype(np.uint8), (400, 300)) > 0

    assert (mask & second).sum() / (mask | second).sum() > 0.9
    with pytest.raises(CaptureError, match="nothing with an outline"):
        cut_out(masked, PhotoBox.of((0.5, 0.1)))
