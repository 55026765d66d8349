"""Fronts are what cameras saw, whatever volume an open surface seems to enclose."""

from __future__ import annotations

import numpy as np
import pytest

from capture2vr.edge.asset.turn_to_cameras import turn_to_cameras
from capture2vr.edge.mesh.concatenate import concatenate
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.topology import orient
from tests.support import surfaces
from tests.support.photos.posed_pictures import photographs


def corner() -> Mesh:
    """Floor and two walls in one piece, wound by their volume; their photos are taken from between them."""
    apart = surfaces.corner()
    vertices, number = np.unique(apart.vertices.round(9), axis=0, return_inverse=True)
    return orient(Mesh(vertices, number.ravel()[apart.faces]))


CORNER = corner()
BALL = orient(surfaces.sphere())
EYES = ((1.0, 0.9, 1.1), (1.3, 0.5, 0.8), (0.6, 1.2, 0.9))


def share_of_fronts(mesh: Mesh) -> float:
    """Share of the faces whose fronts the first photo is before."""
    normals = face_normals(mesh.vertices, mesh.faces)
    return float((np.einsum("fx,fx->f", normals, EYES[0] - mesh.vertices[mesh.faces[:, 0]]) > 0).mean())


def test_a_corner_of_floor_and_walls_is_shown_from_where_its_photos_were_taken() -> None:
    assert share_of_fronts(CORNER) == 0, "by its volume it would be seen from outside of the room"
    for wound in (CORNER, Mesh(CORNER.vertices, CORNER.faces[:, ::-1])):
        assert share_of_fronts(turn_to_cameras(wound, photographs(CORNER, EYES))) == 1


def test_each_piece_is_turned_by_itself_and_a_closed_one_shows_its_outside() -> None:
    ball = Mesh(0.3 * BALL.vertices, BALL.faces)
    inside_out = Mesh(ball.vertices, ball.faces[:, ::-1])
    pictures = photographs(concatenate([CORNER, ball]), EYES)
    for each in (ball, inside_out):
        both = turn_to_cameras(concatenate([each, CORNER]), pictures)
        np.testing.assert_array_equal(both.faces[: len(ball.faces)], ball.faces)
        assert share_of_fronts(Mesh(both.vertices, both.faces[len(ball.faces) :])) == 1


@pytest.mark.parametrize("depth", [True, False])
def test_what_no_photo_has_depth_of_stays_as_it_is(depth: bool) -> None:
    away = Mesh(CORNER.vertices + 40, CORNER.faces)
    pictures = photographs(CORNER, EYES, depth=depth)
    np.testing.assert_array_equal(turn_to_cameras(away if depth else CORNER, pictures).faces, CORNER.faces)
    np.testing.assert_array_equal(turn_to_cameras(CORNER, []).faces, CORNER.faces)
