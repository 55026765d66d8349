"""Photos upon a mesh: the right place, only what they see, at one brightness, without a line where one ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from capture2vr.edge.errors import Cancelled
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.srgb import to_linear, to_srgb
from capture2vr.edge.texture.bake_photos import PhotoProjection, PosedPicture
from capture2vr.edge.texture.nearest_colour import ColouredPoints
from tests.support import surfaces

GROUND = surfaces.patch(lambda u, v: [u, v, 0 * u], 20, 20)  # in the unit frame: x and y from -½ to ½, z = 0
UP = np.array([0.0, 0.0, 1.0])
SIDE = 320  # pixels of a picture


def waves(places: np.ndarray) -> np.ndarray:
    """(N,3) sRGB codes of a print on the ground."""
    x, y = places[:, 0], places[:, 1]
    return np.stack([128 + 60 * np.sin(9 * x), 128 + 60 * np.cos(8 * y), 110 + 50 * np.sin(7 * (x + y))], axis=1)


def camera(eye: tuple[float, float, float]) -> np.ndarray:
    """(4,4) from the world to a camera that looks straight down: its x is the world's, its y is -y, its z is -z."""
    turn = np.diag([1.0, -1.0, -1.0])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, -turn @ np.array(eye)
    return pose


def photo(
    eye: tuple[float, float, float],
    *,
    shows: Callable[[np.ndarray], np.ndarray] = waves,
    exposure: float = 1.0,
    depth: float | None = None,
    scale: float = 1.0,
) -> PosedPicture:
    """What a camera over the ground, whose picture is as wide as it is high over the ground, takes of it.

    scale  units of the camera per unit of the ground
    """
    at = (np.arange(SIDE) + 0.5) / SIDE - 0.5
    x, y = np.meshgrid(eye[0] + at * eye[2], eye[1] - at * eye[2])
    light = to_linear(shows(np.stack([x.ravel(), y.ravel()], axis=1)).astype(np.uint8)) * exposure
    rgb = to_srgb(light).reshape(SIDE, SIDE, 3)
    measured = None if depth is None else (lambda: np.full((48, 48), depth * scale, np.float32))
    to_camera = np.diag([scale, scale, scale, 1.0]) @ camera(eye)
    return PosedPicture(to_camera, np.ones(2), np.full(2, 0.5), lambda: rgb, measured)


def known(shows: Callable[[np.ndarray], np.ndarray] = waves) -> ColouredPoints:
    xyz = np.random.default_rng(0).uniform(-0.5, 0.5, (20_000, 3)) * [1, 1, 0]
    return ColouredPoints.of(xyz, shows(xyz).astype(np.uint8))


def places(count: int = 4_000, inner: float = 0.45) -> np.ndarray:
    return np.random.default_rng(1).uniform(-inner, inner, (count, 3)) * [1, 1, 0]


def light_of(pictures: PhotoProjection, at: np.ndarray, texel: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """(N,3) sRGB codes and (N,) how sure."""
    light, sure = pictures(at, np.tile(UP, (len(at), 1)), texel, lambda _: None)
    return to_srgb(light).astype(int), sure


@pytest.mark.parametrize("scale", [1.0, 0.2])
def test_a_print_comes_back_where_it_was_and_the_pixel_is_told(scale: float) -> None:
    pictures = PhotoProjection(GROUND, [photo((0.1, -0.1, 1.5), depth=1.5, scale=scale)], known())
    shown, sure = light_of(pictures, places())
    assert (sure == 1).all()
    assert np.abs(shown - waves(places())).max() <= 4
    assert pictures.pixel == pytest.approx(1.5 / SIDE, rel=1e-3)


def test_what_something_hides_is_left_to_the_points() -> None:
    roof = Mesh(GROUND.vertices * 0.5 + [0.0, 0, 0.3], GROUND.faces)
    faces = np.concatenate([GROUND.faces, roof.faces + len(GROUND.vertices)])
    both = Mesh(np.concatenate([GROUND.vertices, roof.vertices]), faces)
    pictures = PhotoProjection(both, [photo((0, 0, 2.0))], known())
    at = places()
    _, sure = light_of(pictures, at)
    shadow = 0.25 * 2.0 / 1.7  # of the roof's half side, from the eye upon the ground
    beneath = np.abs(at[:, :2]).max(axis=1)
    assert (sure[beneath < shadow - 0.01] == 0).all()
    assert (sure[beneath > shadow + 0.01] == 1).all()


def test_what_stood_before_the_camera_is_left_to_the_points() -> None:
    """A hand in the picture: the mesh knows nothing of it, the depth image does."""
    pictures = PhotoProjection(GROUND, [photo((0, 0, 1.5), depth=0.7)], known())
    assert (light_of(pictures, places())[1] == 0).all()


@pytest.mark.parametrize("depth", [None, 1.5])
def test_what_a_mask_leaves_out_is_left_to_the_points(depth: float | None) -> None:
    """Where objects touch, a photo's depth does not tell them apart."""
    left = np.zeros((60, 60), bool)
    left[:, :30] = True
    masked = replace(photo((0, 0, 1.5), depth=depth), load_mask=lambda: left)
    at = places()
    shown, sure = light_of(PhotoProjection(GROUND, [masked], known()), at)
    assert (sure[at[:, 0] < -0.05] == 1).all()
    assert (sure[at[:, 0] > 0.05] == 0).all()
    assert np.abs(shown - waves(at))[at[:, 0] < -0.05].max() <= 4


@pytest.mark.parametrize("depth", [None, 2.0])
def test_a_room_photographed_from_its_middle_shows_its_photos(depth: float | None) -> None:
    """The middle of the walls lies beside the cameras, which is not how far away the walls are."""
    walls = [GROUND.vertices + offset for offset in ([0.0, 0, 0], [3.0, 0, 2], [0.0, 0, 4])]
    room = Mesh(np.concatenate(walls), np.concatenate([GROUND.faces + k * len(GROUND.vertices) for k in range(3)]))
    pictures = PhotoProjection(room, [photo((x, 0, 2.0), depth=depth) for x in (-0.05, 0.05)], known())
    shown, sure = light_of(pictures, places())
    assert (sure == 1).all()
    assert np.abs(shown - waves(places())).max() <= 4


def test_neither_the_back_of_a_camera_nor_the_side_of_a_surface_shows_anything() -> None:
    pictures = PhotoProjection(GROUND, [photo((0, 0, -1.5))], known())  # looks down, from below
    assert (light_of(pictures, places())[1] == 0).all()
    flat = PhotoProjection(GROUND, [photo((0, 0, 1.5))], known())
    sideways = np.tile([1.0, 0.0, 0.0], (4_000, 1))
    assert (flat(places(), sideways, 0.0, lambda _: None)[1] == 0).all()


def test_pictures_of_different_exposure_are_brought_to_one_brightness() -> None:
    taken = [photo((x, 0, 1.6), exposure=exposure) for x, exposure in ((-0.2, 0.6), (0.0, 1.0), (0.2, 1.3))]
    shown, _ = light_of(PhotoProjection(GROUND, taken, known()), places())
    assert np.abs(shown - waves(places())).mean() < 2


def test_exposure_steps_leave_no_seam_where_the_points_have_them_too() -> None:
    """Each half of the ground was captured at an exposure of its own: matched to these points, the photos keep a step
    between them. They share the middle, which tells that they show one print."""

    def stepped(at: np.ndarray) -> np.ndarray:
        return to_srgb(to_linear(waves(at).astype(np.uint8)) * np.where(at[:, :1] < 0, 0.6, 1.2))

    eyes = [(x, 0.0, 0.6) for x in (-0.3, -0.1, 0.1, 0.3)]
    taken = [photo(eye, exposure=exposure) for eye, exposure in zip(eyes, (0.6, 0.6, 1.2, 1.2), strict=True)]
    at = places() * [1, 0.5, 1]
    shown, _ = light_of(PhotoProjection(GROUND, taken, known(stepped)), at)
    ratio = to_linear(shown.astype(np.uint8)) / to_linear(waves(at).astype(np.uint8))
    left, right = (np.median(ratio[part], axis=0) for part in (at[:, 0] < -0.1, at[:, 0] > 0.1))
    np.testing.assert_allclose(left, right, rtol=0.03)


def test_no_line_shows_where_a_picture_ends() -> None:
    """The second picture ends in the middle of the ground and is tinted where nothing can correct it."""

    def tinted(at: np.ndarray) -> np.ndarray:
        return np.clip(waves(at) + np.where(at[:, :1] > 0.1, 30, 0), 0, 255)

    taken = [photo((-0.2, 0, 1.6)), photo((0.45, 0, 0.9), shows=tinted)]
    along = np.stack([np.linspace(-0.4, 0.4, 2_000), np.full(2_000, 0.03), np.zeros(2_000)], axis=1)
    shown, _ = light_of(PhotoProjection(GROUND, taken, known()), along)
    off = shown - waves(along)
    away = np.abs(along[:, 0] - 0.1) > 0.01  # there the tint itself begins
    assert np.abs(off).max() > 10  # it is seen at all
    assert np.abs(np.diff(off, axis=0))[away[1:]].max() <= 4


def test_the_best_view_decides_where_views_disagree() -> None:
    """Two pictures of a fine print, one of them misplaced by half a wave: what is sharp stays sharp."""

    def stripes(at: np.ndarray, shift: float = 0.0) -> np.ndarray:
        return np.repeat(128 + 100 * np.sign(np.sin(40 * (at[:, :1] + shift))), 3, axis=1)

    grey = known(lambda at: np.full((len(at), 3), 128.0))
    taken = [photo((0, 0, 1.2), shows=stripes), photo((1.1, 0, 2.5), shows=lambda at: stripes(at, 0.08))]
    shown, _ = light_of(PhotoProjection(GROUND, taken, grey), places(inner=0.3))
    contrast = np.percentile(shown, 90) - np.percentile(shown, 10)
    assert contrast > 120


def test_coarse_texels_get_the_mean_of_fine_pixels() -> None:
    def dots(at: np.ndarray) -> np.ndarray:
        odd = np.floor(at * SIDE / 1.5).astype(int).sum(axis=1) % 2 == 1
        return np.where(odd[:, None], 255, 0).repeat(3, axis=1)

    pictures = PhotoProjection(GROUND, [photo((0, 0, 1.5), shows=dots)], known(lambda at: np.full((len(at), 3), 188.0)))
    fine, coarse = (light_of(pictures, places(), texel)[0] for texel in (0.0, 0.05))
    assert coarse.std() < 12 < fine.std()


def test_no_picture_sees_a_thing_somewhere_else() -> None:
    pictures = PhotoProjection(GROUND, [photo((50, 0, 1.0))], known())
    assert pictures.pixel == 0
    assert (light_of(pictures, places())[1] == 0).all()


def test_it_can_be_stopped_between_two_pictures() -> None:
    def stop(fraction: float) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        PhotoProjection(GROUND, [photo((0, 0, 1.5))] * 3, known(), stop)
    pictures = PhotoProjection(GROUND, [photo((0, 0, 1.5))] * 3, known())
    with pytest.raises(Cancelled):
        pictures(places(), np.tile(UP, (4_000, 1)), 0.0, stop)


def test_close_to_outlines_inferred_surface_is_left_to_the_points() -> None:
    """It may stand out beyond the object there, and then the photo shows what is behind."""
    points = known()
    points = replace(points, inferred=points.xyz[:, 0] > 0)
    at = places(inner=0.499) * [1, 0.6, 1]
    _, sure = light_of(PhotoProjection(GROUND, [photo((0, 0, 1.5))], points), at)
    beside = 0.5 - at[:, 0]
    assert (sure[beside < 0.02] == 0).all()
    assert (sure[beside > 0.1] == 1).all()  # where it was measured, up to its own outline
