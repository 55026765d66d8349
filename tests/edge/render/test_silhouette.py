"""Rims that photos show to be background are found; true borders and thin parts are not."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import trimesh

from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.rays import RaycastingScene
from capture2vr.edge.render.silhouette import cast_pixels, colours_of, outline_thing, outside_outlines, see_mesh
from tests.support import surfaces
from tests.support.photos import posed_pictures
from tests.support.photos.posed_pictures import photographs, printed, silhouette

RIM = 0.03  # width: four pixels of the photos
EYES = [(0.5, 0.2, 1.4), (-0.3, 0.4, 1.4), (0.1, -0.5, 1.3), (-0.4, -0.3, 1.5), (0.0, 0.0, 1.6)]


def sheet(high: float) -> Mesh:
    """A wavy sheet over y in [−0.5, 0.5] and x from −0.5 to `high`, with a print."""
    flat = surfaces.patch(lambda u, v: [u, v, 0 * u], 120, 120)
    x, y = (0.5 + high) * (flat.vertices[:, 0] + 0.5) - 0.5, flat.vertices[:, 1]
    return printed(Mesh(np.stack([x, y, 0.05 * np.sin(6 * x) * np.cos(5 * y)], axis=1), flat.faces))


THING = sheet(0.5)


@pytest.mark.parametrize("depth", [True, False], ids=["with depth", "colours alone"])
def test_a_rim_beside_the_thing_is_found(depth: bool) -> None:
    mesh = sheet(0.5 + RIM)
    outside = outside_outlines(mesh, photographs(THING, EYES, depth=depth))
    x = mesh.vertices[:, 0]
    assert outside[x > 0.5 + RIM / 2].mean() > 0.6
    assert not outside[x < 0.5 - RIM / 2].any()


def test_masks_tell_a_rim_that_looks_like_the_thing() -> None:
    mesh = sheet(0.5 + RIM)
    photos = photographs(mesh, EYES)
    assert not outside_outlines(mesh, photos).any()
    masked = [
        replace(photo, load_mask=partial(silhouette, THING, eye)) for photo, eye in zip(photos, EYES, strict=True)
    ]
    outside = outside_outlines(mesh, masked)
    assert outside[mesh.vertices[:, 0] > 0.5 + RIM / 2].mean() > 0.6
    assert not outside[mesh.vertices[:, 0] < 0.5 - RIM / 2].any()


def test_a_thing_without_rims_keeps_everything() -> None:
    assert not outside_outlines(THING, photographs(THING, EYES)).any()


def test_a_dark_wall_between_bars_is_not_theirs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(posed_pictures, "_WALL", (20.0, 15.0, 10.0))
    ends = [[[x, 0, -0.45], [x, 0, 0.45]] for x in (-0.09, -0.03, 0.03, 0.09)]
    ends += [[[-0.09, 0, z], [0.09, 0, z]] for z in (-0.45, -0.15, 0.15, 0.45)]
    bars = trimesh.util.concatenate([trimesh.creation.cylinder(0.012, segment=each, sections=12) for each in ends])
    mesh = Mesh(np.asarray(bars.vertices), np.asarray(bars.faces))
    photos = photographs(mesh, [(0, -1.5, 0.1), (0.5, -1.4, 0.1), (-0.5, -1.4, 0.2)], depth=False)
    photo = photos[0]
    scene = RaycastingScene(mesh)
    view = see_mesh(photo, scene)
    assert view is not None
    thing, gaps = outline_thing(view, photo, mesh, scene, colours_of(mesh, photos)), view.whole & ~view.found
    assert gaps.sum() > view.found.sum() / 2
    assert thing[gaps].mean() < 0.1, "GrabCut alone takes seven tenths"
    assert thing[view.found].mean() > 0.97


@pytest.mark.parametrize(
    "eye", [(0.0, 0.0, 1.6), (0.9, 0.3, 0.7), (0.0, 0.0, 0.2), (0.49, 0.1, 0.04), (0.0, 0.0, -3.0)]
)
def test_rays_are_cast_wherever_the_mesh_may_be_seen(eye: tuple[float, float, float]) -> None:
    """From afar, from near, and from where a part of the mesh is behind the camera."""
    (picture,), scene = photographs(THING, [eye]), RaycastingScene(THING)
    hits, rays = cast_pixels(picture, scene, 160, 120)
    every = scene.cast(picture.eye[None], rays)
    on = every.face >= 0
    assert (hits.face == every.face).all()
    assert (hits.along == every.along).all()
    assert (hits.bary[on] == every.bary[on]).all()


def test_one_photo_alone_decides_nothing() -> None:
    mesh = sheet(0.5 + RIM)
    assert not outside_outlines(mesh, photographs(THING, EYES[:1])).any()


def test_a_thin_stem_keeps_its_thickness() -> None:
    """A tube of three pixels' width in most photos."""
    stem = printed(
        surfaces.patch(lambda u, v: [0.012 * np.cos(2 * np.pi * u), 0.012 * np.sin(2 * np.pi * u), v - 0.5], 24, 80)
    )
    eyes = [(1.5 * np.cos(turn), 1.5 * np.sin(turn), 0.2) for turn in np.arange(6) * np.pi / 3]
    assert outside_outlines(stem, photographs(stem, eyes)).mean() < 0.01
