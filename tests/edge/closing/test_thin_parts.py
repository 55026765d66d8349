"""Thin parts are found by their outlines: as wide as they are, without webs, where colours tell them from the rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.capture.nouns import Intrinsics
from capture2vr.edge.closing.close_object import close_object
from capture2vr.edge.closing.thin_parts import ThinParts, find_thin_parts, outlined
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.points.nouns import Points, TextureView
from capture2vr.edge.points.plane import Plane
from capture2vr.edge.render.object_colours import MOST
from capture2vr.edge.render.posed_picture import PosedPicture
from tests.support.photos.posed_pictures import SIDE, photographs

AROUND = [(1.3 * np.cos(turn), 1.3 * np.sin(turn), 0.9) for turn in np.radians(np.arange(0, 360, 30))]
FOOT, TOP, RADIUS = np.array([0.0, 0.0, -0.1]), np.array([0.25, 0.1, 0.5]), 0.014  # of a stem: 3.5 pixels wide
BALL = trimesh.creation.icosphere(4, 0.2).apply_translation([0, 0, -0.28])


def points_on(shape: trimesh.Trimesh, count: int) -> Floats:
    return np.asarray(trimesh.sample.sample_surface(shape, count, seed=0)[0], np.float64)


def stem() -> trimesh.Trimesh:
    return trimesh.creation.cylinder(RADIUS, segment=[FOOT, TOP], sections=16)


def web() -> Floats:
    """Points between the stem and the place below its top, where nothing is."""
    along, down = np.random.default_rng(0).random((2, 1_500))
    along, down = 0.4 + 0.5 * along, 0.05 + 0.15 * down
    return FOOT + along[:, None] * (TOP - FOOT) - np.outer(down, [0, 0, 1])


def taken(*shapes: trimesh.Trimesh) -> list[PosedPicture]:
    whole = trimesh.util.concatenate(shapes)
    return photographs(Mesh(np.asarray(whole.vertices), np.asarray(whole.faces)), AROUND)


def found(photos: list[PosedPicture], *parts: Floats) -> tuple[ThinParts | None, list[Floats]]:
    """What is found, and which points of each part are replaced."""
    thin = find_thin_parts(np.concatenate(parts), photos, Plane(np.array([0.0, 0, 1]), -0.48, 0.0, 0.5))
    replaced = np.zeros(sum(map(len, parts)), bool) if thin is None else thin.replaced
    return thin, np.split(replaced, np.cumsum([len(part) for part in parts])[:-1])


@pytest.fixture(scope="module")
def photos() -> list[PosedPicture]:
    return [each.loaded() for each in taken(BALL, stem())]


def test_a_stem_gets_its_length_and_width_and_loses_its_web(photos: list[PosedPicture]) -> None:
    ball, some = points_on(BALL, 6_000), points_on(stem(), 60)
    thin, (of_ball, _, of_web) = found(photos, ball, some, web())
    assert thin is not None
    assert of_web.mean() > 0.97
    assert of_ball.mean() < 0.02
    axis = FOOT + np.linspace(0, 1, 200)[:, None] * (TOP - FOOT)
    assert cKDTree(thin.xyz).query(axis[40:])[0].max() < 2 * RADIUS, "there is a point beside each place of it"
    away = cKDTree(axis).query(thin.xyz)[0]
    assert 0.7 < np.median(away) / RADIUS < 1.4
    assert np.percentile(away, 98) < 3 * RADIUS


def test_a_stem_of_which_no_point_was_measured_may_be_somebody_elses(photos: list[PosedPicture]) -> None:
    far = trimesh.creation.cylinder(RADIUS, segment=[[-0.3, 0.2, 0.1], [-0.3, 0.25, 0.5]], sections=16)
    pictures = taken(BALL, stem(), far)
    ball, some = points_on(BALL, 6_000), points_on(stem(), 60)
    thin, _ = found(pictures, ball, some, np.array([[-0.32, 0.4, 0.55]]))  # which makes room for the other one
    assert thin is not None
    assert cKDTree(points_on(far, 5_000)).query(thin.xyz)[0].min() > 3 * RADIUS


def test_before_a_background_of_its_colours_nothing_is_known(photos: list[PosedPicture]) -> None:
    def before_its_own(photo: PosedPicture) -> PosedPicture:
        rgb, wall = photo.load_rgb(), photo.depth() > 4.9
        own = rgb[~wall]
        filled: Bytes = rgb.copy()
        filled[wall] = own[np.random.default_rng(0).integers(len(own), size=int(wall.sum()))]
        return replace(photo, load_rgb=lambda: filled)

    thin, _ = found([before_its_own(each) for each in photos], points_on(BALL, 6_000), points_on(stem(), 60))
    assert thin is None


def test_a_ball_has_no_thin_parts() -> None:
    assert found(taken(BALL), points_on(BALL, 6_000))[0] is None


def test_of_a_plate_the_rims_alone_are_lines_and_stay_where_they_are() -> None:
    plate = trimesh.creation.box((0.02, 0.5, 0.5)).apply_translation([0, 0, 0.1])
    thin, (_, of_plate) = found(taken(BALL, plate), points_on(BALL, 6_000), points_on(plate, 9_000))
    assert of_plate.mean() < 0.4
    assert thin is None or cKDTree(points_on(plate, 50_000)).query(thin.xyz)[0].max() < 0.015


def test_few_photos_make_no_hull(photos: list[PosedPicture]) -> None:
    assert found(photos[:7], points_on(BALL, 6_000), points_on(stem(), 60))[0] is None


def test_a_sticker_is_no_outline() -> None:
    evidence = np.full((60, 60), -MOST, np.float32)
    evidence[10:50, 10:50] = MOST
    evidence[25:35, 25:35] = -1.0  # of other colours than the object's and the background's
    evidence[10, 10:50] = 1.0  # an outline's pixels have both colours
    known = outlined(evidence)
    assert (known[11:50, 10:50] == MOST).all()
    assert (known[10, 10:50] == 1.0).all()
    assert (known[:10] == -MOST).all()


def test_of_a_figure_of_wire_alone_its_lines_are_left() -> None:
    ring = trimesh.creation.torus(0.3, RADIUS, major_sections=96, minor_sections=12)
    ring.apply_transform(trimesh.transformations.rotation_matrix(1.2, (1, 0.3, 0)))
    views = tuple(as_view(each) for each in taken(ring))
    xyz = np.concatenate([points_on(ring, 3_000), points_on(trimesh.creation.icosphere(2, 0.25), 300)])
    points = Points(
        xyz=xyz,
        rgb=np.full((len(xyz), 3), 99, np.uint8),
        confidence=np.ones(len(xyz), np.float32),
        metres_per_unit=1.0,
        scale_confidence="unknown",
        up=None,
        texture_views=views,
    )
    made = close_object(points, None, "unseen")
    assert len(made.xyz) == len(made.confidence) == len(made.rgb) > 1_000  # type: ignore[arg-type]
    assert cKDTree(points_on(ring, 50_000)).query(made.xyz)[0].max() < RADIUS
    assert made.inferred is None


def as_view(photo: PosedPicture) -> TextureView:
    assert photo.load_depth is not None
    camera = Intrinsics(SIDE, SIDE, SIDE / 2 - 0.5, SIDE / 2 - 0.5, SIDE, SIDE)
    return TextureView(camera, np.linalg.inv(photo.to_camera), photo.load_rgb, photo.load_depth, photo.name)
