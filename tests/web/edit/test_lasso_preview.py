"""What lines in photos leave out is seen on the thing before it is saved, as the worker decides it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from capture2vr.cli.up import Stack
from capture2vr.edge.asset.capture_files import capture_files
from capture2vr.edge.cameras.nouns import PhotoView, picture_camera
from capture2vr.edge.capture.nouns import Intrinsics, Photo, PictureCamera
from capture2vr.edge.capture.upright_places import turn_places
from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.photos.upright_photo import UprightPhoto
from capture2vr.edge.points.lasso import left_out
from capture2vr.edge.points.nouns import Points
from capture2vr.order.download_formats import CAMERAS
from capture2vr.order.photo_lasso import PhotoLasso
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.local import LocalStore
from tests.support.pages import await_data
from tests.support.scenes import PHONE
from tests.support.two_balls import POSES, RED_AT, line_around, picture_name, two_balls
from tests.web.edit.test_edit import open_tab, recipe_of
from tests.web.edit.test_photo_lassos import draw_by_mouse, make_balls

pytestmark = pytest.mark.browser
KEY = "balls-with-cameras"
TO_ASSET = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""From Z up to Y up."""


def cameras_json(cameras: list[PictureCamera]) -> bytes:
    """The file of a bundle, of a capture whose Z axis is up."""
    points = Points(np.eye(3), None, np.ones(3, np.float32), 1.0, "metric", None, cameras=tuple(cameras))
    return capture_files(points, TO_ASSET)[CAMERAS]


@pytest.mark.parametrize("turns", range(4))
def test_the_preview_decides_as_the_worker(page: Page, stack: Stack, turns: int) -> None:
    rng = np.random.default_rng(turns)
    pose = np.eye(4)
    pose[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    pose[:3, :3] *= np.linalg.det(pose[:3, :3])
    pose[:3, 3] = rng.normal(size=3)
    part = (0.1, 0.0, 0.9, 0.8)
    photo = Photo("a.jpg", (300, 200), "", lambda _: np.zeros((1, 1, 3), np.uint8), turns=turns, part=part)
    lens = (0.05, -0.02, 0.003, -0.002, 0.001)
    view = PhotoView(photo, Intrinsics(250.0, 240.0, 140.0, 110.0, 300, 200), lens, pose)
    lines = [
        PhotoLasso("a.jpg", ((0.2, 0.2), (0.7, 0.3), (0.6, 0.8), (0.3, 0.6), (0.8, 0.5))),
        PhotoLasso("a.jpg", ((0.1, 0.1), (0.95, 0.1), (0.9, 0.9), (0.1, 0.9)), keeps=True, through=bool(turns % 2)),
    ]
    # A wall at depth 2, and places on both sides of it.
    z = rng.choice([1.5, 2.0, 2.5, -1.0], 3_000)
    seen = np.stack([z * rng.uniform(-0.9, 0.9, 3_000), z * rng.uniform(-0.7, 0.7, 3_000), z], axis=1)
    wall = np.array([[-4.0, -4, 2], [4, -4, 2], [4, 4, 2], [-4, 4, 2]])

    pixels = seen[:, :2] / z[:, None] * [250, 240] + [140, 110]
    at = (pixels + 0.5) / [300, 200]
    shown = (z > 0) & (at >= 0).all(axis=1) & (at < 1).all(axis=1)
    verdict = left_out(UprightPhoto(view)(turn_places(at, turns)), lines)
    wanted = shown & ((verdict == 2) | ((verdict == 1) & (z < 2.1)))

    def told(xyz: np.ndarray) -> list[float]:
        world = xyz @ pose[:3, :3].T + pose[:3, 3]
        return list((world @ TO_ASSET[:3, :3].T).ravel().tolist())

    page.goto(f"{stack.url}/browse/default")
    found = page.evaluate(
        """async ({ cameras, wall, places, lines }) => {
            const { LassoCut } = await import('/web/edit/lasso-cut.js');
            const surface = { places: new Float32Array(wall), corners: [0, 1, 2, 0, 2, 3] };
            const cut = new LassoCut(JSON.parse(cameras).cameras, surface);
            return [...cut.leavesOut(new Float32Array(places), lines)];
        }""",
        {
            "cameras": cameras_json([picture_camera(view)]).decode(),
            "wall": told(wall),
            "places": told(seen),
            "lines": [asdict(line) for line in lines],
        },
    )
    # Floats of 32 bits may differ on a line itself.
    assert 100 < wanted.sum() < len(wanted)
    assert np.count_nonzero(np.array(found, bool) != wanted) <= 3


@pytest.fixture(scope="module")
def balls(stack: Stack, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A capture of two balls, whose newest version has the cameras of its pictures, as one of photos would."""
    capture = make_balls(stack, tmp_path_factory.mktemp("balls"), KEY)
    names = [picture_name(number) for number in range(len(POSES))]
    publish(balls_bundle(names), LocalStore(stack.store_root), key=KEY)
    return capture


def balls_bundle(names: Sequence[str]) -> Bundle:
    """The two balls, with cameras of these names at the first of their poses."""
    scene = two_balls()
    mesh = Mesh(scene.vertices @ TO_ASSET[:3, :3].T, scene.faces)
    size, camera = (PHONE.width, PHONE.height), (PHONE.fx, PHONE.fy, PHONE.cx, PHONE.cy)
    cameras = [
        PictureCamera(name, size, camera, (0.0, 0.0, 0.0, 0.0, 0.0), tuple(map(tuple, pose[:3].tolist())))  # type: ignore[arg-type]
        for name, pose in zip(names, POSES, strict=False)
    ]
    lods = [{"file": "lod0.glb", "level": 0, "triangles": len(mesh.faces), "vertices": len(mesh.vertices)}]
    manifest = {"lods": lods, "label": "Balls", "size_m": [1.2, 0.2, 1.2], "scale_confidence": "metric", "edits": {}}
    manifest["capture_to_asset"] = TO_ASSET.ravel().tolist()
    return Bundle("refined", {"lod0.glb": to_glb(mesh), CAMERAS: cameras_json(cameras)}, manifest)


def glimpse(page: Page) -> str:
    """The small picture of the thing, once it is drawn."""
    page.wait_for_function("() => document.querySelector('#glimpse').width > 0")
    return str(page.evaluate("document.querySelector('#glimpse').toDataURL()"))


def test_what_a_line_leaves_out_is_seen_before_it_is_saved(page: Page, stack: Stack, balls: str) -> None:
    page.goto(f"{stack.url}/edit/{KEY}")
    await_data(page, state="ready", kept="1.000")
    open_tab(page, "Photos")
    page.get_by_label("Photo", exact=True).select_option(picture_name(3))
    await_data(page, photo=picture_name(3))
    whole = glimpse(page)
    shares = []
    for through in (False, True):
        page.get_by_label("Also what is hidden in this photo").set_checked(through)
        draw_by_mouse(page, line_around(RED_AT, 3))
        page.wait_for_function("() => Number(document.body.dataset.kept) < 1")
        shares.append(float(page.evaluate("document.body.dataset.kept")))
        page.wait_for_function("before => document.querySelector('#glimpse').toDataURL() !== before", arg=whole)
        expect(page.locator("#lasso-said")).to_have_text("")
        page.get_by_role("button", name="Undo").click()
        await_data(page, kept="1.000")
        assert "lassos" not in recipe_of(page)
    # Each ball has nearly half of all vertices. The photo shows half of the red one, and what lies 3 % of its
    # distance behind that; along the lines of sight lies all of it.
    assert 0.62 < shares[0] < 0.76
    assert shares[1] == pytest.approx(0.5, abs=0.02)
