"""Pictures and the rays behind them: right where the answer is known in closed form."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from capture2vr.edge.arrays import Bytes, Floats
from capture2vr.edge.mesh.normals import vertex_normals
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.render.contact_sheet import render_sheet
from capture2vr.edge.render.rays import RaycastingScene, open_sky, pinhole
from tests.support import surfaces
from tests.support.photos.painted import painted, quarters

pytestmark = pytest.mark.slow

SIZE = 96


def picture(mesh: Mesh | TexturedMesh, size: int = SIZE) -> Bytes:
    return np.asarray(Image.open(io.BytesIO(render_sheet(mesh, size=size))))


def views(mesh: Mesh) -> list[Bytes]:
    """Front, right, back, left."""
    sheet = picture(mesh)
    return [sheet[row : row + SIZE, column : column + SIZE] for row in (0, SIZE) for column in (0, SIZE)]


def drawn(view: Bytes) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Pixels that differ from the backdrop, which every view shows along its left edge."""
    return (np.abs(view.astype(int) - view[:, :1]) > 8).any(axis=2)


def test_a_sheet_is_a_square_of_four_views() -> None:
    assert picture(surfaces.sphere()).shape == (2 * SIZE, 2 * SIZE, 3)


def test_a_sphere_is_a_disk_that_fills_the_view() -> None:
    for view in views(surfaces.sphere()):
        rows, columns = np.nonzero(drawn(view))
        assert np.ptp(rows) == pytest.approx(np.ptp(columns), abs=2)
        assert 0.8 * SIZE < np.ptp(columns) < SIZE
        assert drawn(view).sum() == pytest.approx(np.pi / 4 * np.ptp(rows) * np.ptp(columns), rel=0.05)


def test_nothing_is_cut_off() -> None:
    for mesh in (surfaces.disk(), surfaces.cylinder(), surfaces.mobius(), surfaces.two_sheets()):
        for view in views(mesh):
            edge = np.concatenate([drawn(view)[0], drawn(view)[-1], drawn(view)[:, -1]])
            assert not edge.any()


def test_both_sides_of_a_sheet_are_lit() -> None:
    sheet = painted(surfaces.smooth_sheet(), 200, 60, 60)
    for view in views(sheet):
        seen = view[drawn(view)]
        assert seen.mean(axis=0)[0] > 1.5 * seen.mean(axis=0)[1]
        assert seen[:, 0].mean() > 60


def test_turning_every_face_round_changes_nothing_one_could_see() -> None:
    mesh = surfaces.hemisphere()
    turned = replace(mesh, faces=mesh.faces[:, ::-1])
    difference = np.abs(picture(mesh).astype(int) - picture(turned))
    assert difference.mean() < 0.5


def test_light_comes_from_above_and_a_cup_is_dark_inside() -> None:
    ball = picture(surfaces.sphere())[:SIZE, :SIZE].astype(int)[:, SIZE // 2, 0]
    assert ball[SIZE // 4] > ball[3 * SIZE // 4] + 15
    cup = surfaces.patch(lambda u, v: [np.cos(2 * np.pi * u) / 8, v, np.sin(2 * np.pi * u) / 8], 64, 32)
    normals = vertex_normals(cup).astype(np.float32)
    outward = np.sign(np.einsum("vx,vx->v", normals, cup.vertices * [1, 0, 1]))[:, None] * normals
    scene, vertices = RaycastingScene(cup), cup.vertices.astype(np.float32)
    middle = np.abs(cup.vertices[:, 1]) < 0.1
    assert open_sky(scene, vertices, outward.astype(np.float32), rays=32)[middle].mean() > 0.95
    assert open_sky(scene, vertices, -outward.astype(np.float32), rays=32)[middle].mean() < 0.7


def test_colours_are_those_of_the_vertices() -> None:
    green = picture(painted(surfaces.sphere(), 30, 160, 40))[SIZE // 2, SIZE // 2]
    assert green[1] > 2 * green[0]
    assert green[1] > 2 * green[2]


def coarse_sphere() -> Mesh:
    """Radius ½, in 2,048 faces."""

    def shape(u: Floats, v: Floats) -> list[Floats]:
        return [np.sin(np.pi * v) * np.cos(2 * np.pi * u), np.cos(np.pi * v), np.sin(np.pi * v) * np.sin(2 * np.pi * u)]

    return surfaces.patch(shape, 64, 16)


def test_a_picture_on_the_surface_shows_where_its_coordinates_say() -> None:
    """A sphere whose texture is red above and green below, cut into charts that share no vertices."""
    sphere = coarse_sphere()
    above = sphere.vertices[sphere.faces].mean(axis=1)[:, 1] > 0
    corners = np.arange(3 * len(sphere.faces)).reshape(-1, 3)
    uv = np.repeat(np.where(above[:, None], [0.25, 0.25], [0.25, 0.75]), 3, axis=0)
    mesh = Mesh(sphere.vertices[sphere.faces].reshape(-1, 3), corners)
    sheet = picture(TexturedMesh(mesh, uv, quarters(), 64)).astype(int)
    top, bottom = sheet[SIZE // 4, SIZE // 2], sheet[3 * SIZE // 4, SIZE // 2]
    assert top[0] > 2 * top[1:].max()
    assert bottom[1] > 2 * bottom[[0, 2]].max()


def test_the_charts_of_a_picture_leave_no_edges_in_the_shading() -> None:
    sphere = coarse_sphere()
    corners = np.arange(3 * len(sphere.faces)).reshape(-1, 3)
    mesh = Mesh(sphere.vertices[sphere.faces].reshape(-1, 3), corners)
    blue = TexturedMesh(mesh, np.full((len(mesh.vertices), 2), [0.9, 0.1]), quarters(), 64)
    difference = np.abs(picture(blue).astype(int) - picture(painted(sphere, 0, 0, 255)))
    assert difference.mean() < 1.5


def test_the_same_mesh_gives_the_same_picture() -> None:
    assert render_sheet(surfaces.mobius(), size=48) == render_sheet(surfaces.mobius(), size=48)


def test_a_mesh_without_faces_is_refused() -> None:
    with pytest.raises(ValueError, match="without faces"):
        render_sheet(Mesh(np.zeros((3, 3)), np.empty((0, 3), np.int64)))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_rays_meet_a_plane_at_its_depth(scale: float) -> None:
    plane = Mesh(np.array([[-9.0, -9, 5], [9, -9, 5], [9, 9, 5], [-9, 9, 5]]) * scale, np.array([[0, 1, 2], [0, 2, 3]]))
    steps = np.linspace(-0.5, 0.5, 17)
    rays = pinhole(steps, steps, *np.eye(3))
    hits = RaycastingScene(plane).cast(np.zeros((1, 3)), rays)
    assert (hits.face >= 0).all()
    assert np.allclose(hits.along, 5 * scale, rtol=1e-4)
    met = np.einsum("nc,ncx->nx", hits.bary, plane.vertices[plane.faces[hits.face]])
    assert np.allclose(met, rays * 5 * scale, atol=1e-3 * scale)


def test_rays_that_miss_say_so() -> None:
    hits = RaycastingScene(surfaces.disk()).cast(np.array([[0.0, 0, 3]]), np.array([[0.0, 0, 1], [0, 0, -1]]))
    assert hits.face[0] == -1
    assert np.isinf(hits.along[0])
    assert hits.along[1] == pytest.approx(3, rel=1e-4)


def test_a_thing_blocks_a_ray_only_within_reach() -> None:
    scene = RaycastingScene(surfaces.disk())
    start, ray = np.array([[0.1, 0.1, 1.0]]), np.array([[0.0, 0, -1]])
    assert scene.blocked(start, ray, 1.1).all()
    assert not scene.blocked(start, ray, 0.9).any()


@pytest.mark.data
def test_a_real_dress_fills_its_picture(data_dir: Path) -> None:
    import trimesh

    raw = trimesh.load(data_dir / "dress" / "dress-v17k-f34k.obj", force="mesh", process=False)
    for view in views(Mesh(np.array(raw.vertices), np.array(raw.faces))):
        rows, _ = np.nonzero(drawn(view))
        assert np.ptp(rows) > 0.7 * SIZE
        assert len(np.unique(view[drawn(view)][:, 0])) > 40  # shades: folds can be read
