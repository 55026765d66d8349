"""The object in a rectangle: which points are its own, of those that photos show, and its outlines in all photos."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
import trimesh

from capture2vr.edge.arrays import Bools, Floats
from capture2vr.edge.capture.nouns import ShownPicture
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.marking.isolate_marked import isolate_marked
from capture2vr.edge.marking.marked_object import Mark, choose_marked, middle_of
from capture2vr.edge.marking.outline_points import label_pixels, outline_points, seen_points
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.order.photo_box import PhotoBox
from tests.support.photos.posed_pictures import photographs, print_on, silhouette
from tests.support.scenes import plane

EYES = [(1.6 * np.cos(turn), 1.6 * np.sin(turn), 1.1) for turn in np.radians(range(0, 360, 45))]
MIDDLE, ASIDE = np.array([0.0, 0.0, 0.15]), np.array([0.1, 0.45, 0.12])
BALL = trimesh.creation.icosphere(4, 0.15).apply_translation(MIDDLE)


def cube(at: Floats) -> trimesh.Trimesh:
    return trimesh.creation.box((0.24, 0.24, 0.24)).subdivide().subdivide().apply_translation(at)


def mesh_of(*parts: trimesh.Trimesh) -> Mesh:
    whole = trimesh.util.concatenate(list(parts))
    return Mesh(np.asarray(whole.vertices, float), np.asarray(whole.faces, np.int64))


def sampled(*parts: trimesh.Trimesh) -> tuple[Floats, Floats]:
    """Points (N,3) of meshes, 12 mm apart, and the numbers (N,) of their parts."""
    clouds = [trimesh.sample.sample_surface(part, int(part.area / 0.012**2), seed=1)[0] for part in parts]
    return np.concatenate(clouds), np.repeat(np.arange(len(parts)), [len(cloud) for cloud in clouds])


def box_around(mask: Bools, loose: float = 0.05) -> PhotoBox:
    rows, columns = np.flatnonzero(mask.any(axis=1)) / len(mask), np.flatnonzero(mask.any(axis=0)) / mask.shape[1]
    return PhotoBox(columns[0], rows[0], columns[-1], rows[-1]).grown(loose)


def mark_in(picture: PosedPicture, box: PhotoBox) -> Mark:
    return Mark(picture, ShownPicture("0.jpg", lambda at: at), box)


def chosen(parts: Sequence[trimesh.Trimesh], number: int, loose: float = 0.05) -> tuple[Bools, Bools]:
    """Which of the points over the table the rectangle around a part chooses, and which are that part's; masks (N,)."""
    pictures = photographs(mesh_of(plane(2.0, 2.0), *parts), EYES)
    xyz, part = sampled(plane(2.0, 2.0), *parts)
    over = xyz[:, 2] > 0.02
    mark = mark_in(pictures[0], box_around(silhouette(mesh_of(parts[number]), EYES[0]), loose))
    rgb = np.rint(print_on(xyz)).astype(np.uint8)
    return choose_marked(xyz, rgb, over, mark, pictures), over & (part == number + 1)


@pytest.mark.parametrize("loose", [0.2, -0.03], ids=["loose", "tight"])
@pytest.mark.parametrize("number", [0, 1], ids=["ball", "cube"])
def test_of_two_objects_on_a_table_the_one_in_the_rectangle_is_chosen_whole(number: int, loose: float) -> None:
    """All have the same print: colours tell nothing."""
    found, truth = chosen([BALL, cube(ASIDE)], number, loose)
    assert not (found & ~truth).any()
    assert (found & truth).sum() > 0.99 * truth.sum()


@pytest.mark.slow
def test_of_two_objects_that_touch_the_one_in_the_rectangle_is_chosen() -> None:
    found, truth = chosen([BALL, cube(np.array([0.0, 0.27, 0.12]))], 0)
    assert (found & truth).sum() > 0.75 * (found | truth).sum()


def test_where_a_rectangle_shows_no_candidate_nothing_is_chosen() -> None:
    pictures = photographs(mesh_of(plane(2.0, 2.0), BALL), EYES[:2])
    xyz, _ = sampled(plane(2.0, 2.0), BALL)
    empty = mark_in(pictures[0], PhotoBox(0.05, 0.75, 0.3, 0.95))
    assert not choose_marked(xyz, None, xyz[:, 2] > 0.02, empty, pictures).any()
    middle = middle_of(empty, xyz)
    assert middle is not None
    assert abs(middle[2]) < 0.01
    assert middle_of(mark_in(pictures[0], PhotoBox(0.0, 0.0, 0.02, 0.02)), xyz[:1]) is None


def test_a_rectangle_around_nothing_with_depth_says_so() -> None:
    """At the wall there are no points."""
    pictures = photographs(mesh_of(plane(2.0, 2.0), BALL), EYES[:2])
    xyz, _ = sampled(plane(2.0, 2.0), BALL)
    points = Points(xyz, None, np.ones(len(xyz), np.float32), 1.0, "metric", np.array([0.0, 0.0, 1.0]))
    with pytest.raises(CaptureError, match=r"0\.jpg: what you marked gave no depth") as caught:
        isolate_marked(points, mark_in(pictures[0], PhotoBox(0.0, 0.0, 0.03, 0.03)), cameras=np.array(EYES))
    assert caught.value.code == "CAPTURE_NOTHING_LEFT"
    assert caught.value.hints


def test_a_pixel_has_the_label_of_the_nearest_point_before_it() -> None:
    picture = photographs(mesh_of(BALL), EYES[:1])[0]
    far = MIDDLE - 0.14 * (picture.eye - MIDDLE) / np.linalg.norm(picture.eye - MIDDLE)  # behind the ball's middle
    xyz = np.concatenate([sampled(BALL)[0], [far]])
    seen = seen_points(picture, xyz)
    assert len(xyz) - 1 not in seen.index
    is_ball = np.arange(len(xyz)) < len(xyz) - 1
    labels = label_pixels(seen, is_ball, (100, 100))
    assert set(np.unique(labels)) == {0, 2}
    assert (label_pixels(seen, ~is_ball, (100, 100)) == 1).sum() == (labels == 2).sum()


@pytest.mark.slow
def test_an_outline_is_the_silhouette_also_where_something_stands_before_the_object() -> None:
    parts = [BALL, cube(np.array([0.45, 0.0, 0.12]))]  # before the ball, seen from the first eye
    pictures = photographs(mesh_of(plane(2.0, 2.0), *parts), EYES)
    xyz, part = sampled(plane(2.0, 2.0), *parts)
    for number in (0, 3):
        outline = outline_points(pictures[number], seen_points(pictures[number], xyz), part == 1)
        assert outline is not None
        truth = silhouette(mesh_of(BALL), EYES[number])
        if number == 0:
            truth &= ~silhouette(mesh_of(parts[1]), EYES[0])
        assert (outline & truth).sum() > 0.9 * (outline | truth).sum()


def test_a_mask_that_came_with_a_photo_is_its_outline() -> None:
    picture = photographs(mesh_of(BALL), EYES[:1])[0]
    given = np.eye(7, dtype=bool)
    masked = PosedPicture(picture.to_camera, picture.focal, picture.middle, picture.load_rgb, load_mask=lambda: given)
    xyz, _ = sampled(BALL)
    assert outline_points(masked, seen_points(masked, xyz), np.ones(len(xyz), bool)) is not None
    assert (outline_points(masked, seen_points(masked, xyz), np.ones(len(xyz), bool)) == given).all()
    nothing = np.zeros(len(xyz), bool)
    assert outline_points(picture, seen_points(picture, xyz), nothing) is None
