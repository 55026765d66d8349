"""Measuring a thing on its page: known shapes give known figures, by mouse, touch and keys, also in the headset."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Page, expect

from capture2vr.storage.catalogue.publish import publish
from tests.support.headsets import enter, wear
from tests.support.pages import await_data
from tests.support.screenshots import await_frames, halves, stage
from tests.support.sites import Site
from tests.support.things import BLUE, box
from tests.web.conftest import without_a_past

pytestmark = pytest.mark.browser
SIZE = (0.4, 0.4, 0.4)
QUALITY = {"held_out_mean": 0.001}
"""0.4 mm of 0.4 m: two points are √2 times as far off."""
FRONT = 0.2  # z of the front face
PLACES = """async ([size, points]) => {
    const THREE = await import('/web/vendor/three-0.187.0.module.js');
    const { frame } = await import('/web/graphics/scene.js');
    const { left, top, width, height } = document.getElementById('stage').getBoundingClientRect();
    const camera = new THREE.PerspectiveCamera(45, width / height, 0.01, 200);
    frame(camera, size, new THREE.Vector3(0, size[1] / 2, 0));
    camera.updateMatrixWorld();
    const seen = points.map((point) => new THREE.Vector3(...point).project(camera));
    return seen.map(({ x, y }) => [left + width * (1 + x) / 2, top + height * (1 - y) / 2]);
}"""
AREA = """async ([vertices, faces, loop]) => {
    const THREE = await import('/web/vendor/three-0.187.0.module.js');
    const { areaInside } = await import('/web/viewer/surface-area.js');
    const corners = vertices.map((vertex) => new THREE.Vector3(...vertex));
    const triangles = faces.map((face) => face.map((corner) => corners[corner]));
    return areaInside(loop.map((point) => new THREE.Vector3(...point)), triangles);
}"""
MEASURE = """async ([kind, points, manifest]) => {
    const THREE = await import('/web/vendor/three-0.187.0.module.js');
    const { accuracyOf, errorOf, measure } = await import('/web/viewer/measurement.js');
    const places = points.map((point) => new THREE.Vector3(...point));
    const value = measure(kind, places, () => [places.slice(0, 3)]);
    const accuracy = accuracyOf({ scale_confidence: manifest.scale, size_m: [1, 0.5, 0.5] }, manifest);
    return [value, errorOf({ kind, points: places, value, version: 1 }, accuracy)];
}"""


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    """A small touch screen: the panel leaves room beside it."""
    with without_a_past(browser, {"width": 480, "height": 300}, has_touch=True) as context:
        yield context


@pytest.fixture
def blank(page: Page, site: Site) -> Page:
    """A page of the site without a thing, to call the viewer's modules."""
    page.goto(f"{site.url}/browse/default")
    return page


def open_panel(page: Page, site: Site, key: str, **manifest: Any) -> Page:
    publish(box("Cube", BLUE, size=SIZE, **{"quality": QUALITY, **manifest}), site.store, key=key)
    page.goto(f"{site.url}/view/{key}")
    await_data(page, loaded="2 1 0")
    page.locator("#measure > summary").click()
    page.wait_for_function("() => document.body.hasAttribute('data-measuring')")
    return page


def places(page: Page, *points: tuple[float, float, float]) -> list[tuple[float, float]]:
    """Where points of the thing are on the page, as it is first shown."""
    return [(x, y) for x, y in page.evaluate(PLACES, [SIZE, points])]


def choose(page: Page, *points: tuple[float, float, float]) -> None:
    for x, y in places(page, *points):
        page.mouse.click(x, y)


def measured(page: Page) -> dict[str, float]:
    told = (page.get_attribute("body", "data-measured") or "").split("; ")
    return {kind: float(value) for kind, value in (each.split() for each in told if each)}


# ---- figures --------------------------------------------------------------------------------------------------------


def test_lengths_angles_and_heights_are_exact(blank: Page) -> None:
    def of(kind: str, *points: list[float]) -> float:
        return float(blank.evaluate(MEASURE, [kind, points, {"scale": "metric"}])[0])

    assert of("distance", [0, 0, 0], [0.3, 0.4, 1.2]) == pytest.approx(1.3, abs=1e-12)
    assert of("angle", [1, 0, 0], [0, 0, 0], [0, 2, 0]) == pytest.approx(90, abs=1e-9)
    assert of("angle", [1, 0, 0], [0, 0, 0], [-1, 0, 1]) == pytest.approx(135, abs=1e-9)
    assert of("height", [3, 0.7, 1]) == 0.7


def test_how_far_off_they_may_be_agrees_with_points_that_are_moved(blank: Page) -> None:
    """The worst first-order change by points that move by the surface's distance, combined as independent ones are."""
    point = 0.001  # of a longest side of one metre
    manifest = {"scale": "metric", "quality": {"held_out_mean": point}}
    around = np.random.default_rng(0).uniform(0, 2 * np.pi, 5)
    loop = np.column_stack([np.cos(np.sort(around)), np.sin(np.sort(around)), np.zeros(5)])
    for kind, points, of in (("angle", loop[:3], corner), ("area", loop, inside)):
        _, error = blank.evaluate(MEASURE, [kind, points.tolist(), manifest])
        slopes = [slope(of, points, each) for each in range(len(points))]
        assert error == pytest.approx(point * np.linalg.norm(slopes), rel=1e-3), kind
    estimated = {"scale": "estimated", "quality": {"held_out_mean": point}, "edits": {"length": {"metres": 0.5}}}
    value, error = blank.evaluate(MEASURE, ["distance", [[0, 0, 0], [1, 0, 0]], estimated])
    assert error == pytest.approx(np.hypot(2**0.5 * point, 2**0.5 * point / 0.5 * value))
    assert blank.evaluate(MEASURE, ["distance", [[0, 0, 0], [1, 0, 0]], {**manifest, "scale": "unknown"}])[1] is None
    assert blank.evaluate(MEASURE, ["distance", [[0, 0, 0], [1, 0, 0]], {"scale": "metric"}])[1] is None


def corner(points: np.ndarray) -> float:
    """The angle at the second of three points, in degrees."""
    one, other = points[0] - points[1], points[2] - points[1]
    return float(np.degrees(np.arccos(one @ other / np.linalg.norm(one) / np.linalg.norm(other))))


def inside(loop: np.ndarray) -> float:
    """The area of a loop on the plane z = 0 (the shoelace formula)."""
    (x, y), (u, v) = loop[:, :2].T, np.roll(loop, -1, axis=0)[:, :2].T
    return float(abs((x * v - u * y).sum()) / 2)


def slope(of: Callable[[np.ndarray], float], points: np.ndarray, moved: int) -> float:
    """How much a figure changes with the place of one of its points at most, by differences."""
    steps = [np.where(np.arange(len(points))[:, None] == moved, step, 0) for step in np.eye(3) * 1e-6]
    return float(np.linalg.norm([(of(points + step) - of(points - step)) / 2e-6 for step in steps]))


def area(page: Page, mesh: trimesh.Trimesh, loop: np.ndarray | list[list[float]]) -> float | None:
    found: float | None = page.evaluate(AREA, [mesh.vertices.tolist(), mesh.faces.tolist(), np.asarray(loop).tolist()])
    return found


def test_the_area_of_a_face_leaves_the_other_side_of_the_box_out(blank: Page) -> None:
    cube = trimesh.creation.box(SIZE).subdivide().subdivide()
    corners = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]]) * 0.2
    assert area(blank, cube, corners) == pytest.approx(0.16, abs=1e-9)
    assert area(blank, cube, corners[::-1]) == pytest.approx(0.16, abs=1e-9), "in whichever order"
    assert area(blank, cube, corners * [0.5, 0.31, 1]) == pytest.approx(0.16 * 0.5 * 0.31, abs=1e-9)
    hooked = np.array([[0, 0], [0.1, 0], [0.1, 0.1], [0.05, 0.02]])  # with a corner that points inward
    assert area(blank, cube, np.column_stack([hooked, np.full(4, 0.2)])) == pytest.approx(0.0035, abs=1e-9)
    assert area(blank, cube, corners[[0, 2, 1, 3]]) is None, "its lines cross"
    assert area(blank, cube, [[0, 0, 0.2], [0.1, 0, 0.2], [0.2, 0, 0.2]]) is None, "one line has no inside"


def test_the_area_of_a_curved_surface_is_that_of_its_triangles(blank: Page) -> None:
    ball = trimesh.creation.icosphere(subdivisions=4)
    around = np.linspace(0, 2 * np.pi, 12, endpoint=False) + 0.1
    loop = np.column_stack([0.6 * np.cos(around), 0.8 * np.ones(12), 0.6 * np.sin(around)])
    crumbs = ball.subdivide().subdivide().subdivide()  # the same surface; each crumb is inside or not
    middles, ends = crumbs.triangles_center, np.roll(loop, -1, axis=0)
    inward = np.cross(ends - loop, [0, 1, 0]) * -1
    inward *= np.sign((inward * -loop).sum(axis=1))[:, None]
    kept = ((middles @ inward.T - (loop * inward).sum(axis=1)) > 0).all(axis=1) & (middles[:, 1] > 0)
    cap = float(crumbs.area_faces[kept].sum())
    assert area(blank, ball, loop) == pytest.approx(cap, rel=1e-3)
    assert cap > 1.05 * 0.36 * 6 * np.sin(np.pi / 6), "more than the flat polygon"
    fine = np.linspace(0, 2 * np.pi, 128, endpoint=False)
    latitude = np.column_stack([0.75**0.5 * np.cos(fine), np.full(128, 0.5), 0.75**0.5 * np.sin(fine)])
    assert area(blank, ball, latitude) == pytest.approx(np.pi, rel=3e-3), "2πh (Archimedes), the other side left out"


def test_a_sheet_behind_and_torn_off_is_not_counted_but_a_seam_is_crossed(blank: Page) -> None:
    front = trimesh.creation.box((1, 1, 1e-9))
    square = np.array([[-0.4, -0.4, 0], [0.4, -0.4, 0], [0.4, 0.4, 0], [-0.4, 0.4, 0]])
    vertices = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    sheet = trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], process=False)
    behind = trimesh.Trimesh(vertices - [0, 0, 0.2], [[0, 1, 2], [0, 2, 3]], process=False)
    assert area(blank, trimesh.util.concatenate([sheet, behind]), square) == pytest.approx(0.64, abs=1e-9)
    assert area(blank, sheet, square) == area(blank, front, square)
    split = trimesh.Trimesh(np.concatenate([vertices, vertices + 1e-6]), [[0, 1, 2], [4, 6, 7]], process=False)
    assert area(blank, split, square) == pytest.approx(0.64, abs=1e-5), "corners that are rounded apart are one"


# ---- the panel ------------------------------------------------------------------------------------------------------


@pytest.mark.essential
def test_a_length_and_an_angle_are_measured_by_mouse(page: Page, site: Site) -> None:
    open_panel(page, site, "measured")
    choose(page, (0.05, 0.1, FRONT), (0.15, 0.1, FRONT))
    assert measured(page) == {"distance": pytest.approx(0.1, rel=0.02)}
    expect(page.locator("#measure-said")).to_have_text("Distance: 10.00 ± 0.06 cm.")
    page.get_by_role("button", name="Angle").click()
    choose(page, (0.15, 0.1, FRONT), (0.05, 0.1, FRONT), (0.05, 0.18, FRONT))
    assert measured(page)["angle"] == pytest.approx(90, abs=1)
    page.get_by_role("button", name="Height").click()
    choose(page, (0.1, 0.12, FRONT))
    assert measured(page)["height"] == pytest.approx(0.12, abs=1e-3)
    expect(page.locator("#measure-list li")).to_have_count(3)
    expect(page.locator("#measure-scale")).to_contain_text("Its size was measured by what captured it.")
    page.get_by_role("button", name="Remove angle").click()
    assert set(measured(page)) == {"distance", "height"}
    page.get_by_role("button", name="Remove all").click()
    assert measured(page) == {}


def test_an_area_is_measured_by_touch_and_a_loop_that_crosses_itself_is_said(page: Page, site: Site) -> None:
    open_panel(page, site, "around")
    page.get_by_role("button", name="Area").tap()
    for x, y in places(page, (0.02, 0.1, FRONT), (0.15, 0.2, FRONT), (0.15, 0.1, FRONT), (0.02, 0.2, FRONT)):
        page.touchscreen.tap(x, y)
    await_data(page, points="4")
    page.get_by_role("button", name="Close the loop").tap()
    expect(page.locator("#measure-said")).to_contain_text("cross")
    page.get_by_role("button", name="Take the last point back").tap()
    page.get_by_role("button", name="Close the loop").tap()
    assert measured(page) == {"area": pytest.approx(0.13 * 0.1 / 2, rel=0.02)}
    expect(page.locator("#measure-said")).to_have_text("Area: 65.0 ± 0.5 cm².")


def test_keys_are_enough(page: Page, site: Site) -> None:
    open_panel(page, site, "by-keys")
    assert page.evaluate("document.activeElement.id") == "stage"
    page.keyboard.press("Enter")
    await_data(page, points="1")
    expect(page.locator("#measure-said")).to_have_text("And the other one.")
    for key in ("Shift+ArrowRight", "Shift+ArrowUp"):
        page.keyboard.press(key)
    expect(page.locator("#cross")).to_be_visible()
    page.keyboard.press("Enter")
    assert 0.005 < measured(page)["distance"] < 0.1
    for _ in range(30):
        page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("Enter")
    expect(page.locator("#measure-said")).to_contain_text("There is nothing of it")
    for _ in range(15):
        page.keyboard.press("Shift+ArrowLeft")
    page.keyboard.press("Enter")
    page.keyboard.press("Escape")
    await_data(page, points="0")
    expect(page.locator("#measure")).to_have_attribute("open", "")
    page.keyboard.press("Escape")
    expect(page.locator("#measure")).not_to_have_attribute("open", "")
    assert page.evaluate("document.activeElement.parentElement.id") == "measure"
    page.mouse.click(240, 150)
    assert len(measured(page)) == 1, "what was measured stays, and no more is"


@pytest.mark.parametrize(
    ("manifest", "text", "sentence"),
    [
        ({"scale_confidence": "unknown"}, "cm ?", "Its true size is not known"),
        ({"scale_confidence": "estimated", "edits": {"length": {"start": [0, 0, 0], "end": [1, 0, 0], "metres": 0.2}}},
         "± ", "a length of 20 cm between two points that a person gave"),
        ({"origin": "guess", "quality": {}}, "10 cm", "Its shape is a guess from one photo."),
    ],
)  # fmt: skip
def test_what_is_not_known_of_the_scale_is_said(
    page: Page, site: Site, manifest: dict[str, Any], text: str, sentence: str
) -> None:
    open_panel(page, site, "scaled", **manifest)
    choose(page, (0.05, 0.1, FRONT), (0.15, 0.1, FRONT))
    expect(page.locator("#measure-said")).to_contain_text(text)
    expect(page.locator("#measure-scale")).to_contain_text(sentence)
    assert ("±" in page.locator("#measure-said").inner_text()) == ("±" in text)


def test_in_the_headset_the_figures_stand_in_the_scene(
    context: BrowserContext, iwer: Path, page: Page, site: Site
) -> None:
    wear(context, iwer)
    open_panel(page, site, "worn")
    choose(page, (0.03, 0.3, FRONT), (0.18, 0.3, FRONT))
    await_frames(page)
    assert orange(stage(page)) > 20
    page.keyboard.press("Escape")  # the panel closes, and the buttons below are there again
    enter(page)
    for eye in halves(stage(page)):
        assert orange(eye) > 8, "the line and its ends, in an eye of 240 pixels"
        assert dark_ground(eye) > 100, "the label"
    page.evaluate("xrDevice.activeSession.end()")
    await_data(page, xr="off")
    page.locator("#measure > summary").click()
    page.get_by_role("button", name="Remove all").click()
    await_frames(page)
    assert orange(stage(page)) == 0


def orange(png: bytes) -> int:
    """Pixels of the marks' colour."""
    red, green, blue = np.moveaxis(np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int), 2, 0)
    return int(((red > 180) & (green > 90) & (green < 190) & (blue < 90)).sum())


def dark_ground(png: bytes) -> int:
    """Pixels of a label's ground before the blue cube, whose own are all much bluer."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
    middle = pixels[pixels.shape[0] // 4 : -pixels.shape[0] // 4, pixels.shape[1] // 4 : -pixels.shape[1] // 4]
    return int((middle.max(axis=2) < 90).sum())
