"""How things look in the viewer: captured colours as they are, form without colours, a shadow, a backdrop."""

from __future__ import annotations

import io

import numpy as np
import pytest
import trimesh
from PIL import Image
from playwright.sync_api import Browser, Page, expect
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from capture2vr.edge.arrays import Bytes
from capture2vr.edge.export.glb import to_glb
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.origin import COLOURS, FILLED, MEASURED, PROPOSED
from capture2vr.storage.catalogue.publish import publish
from tests.support.pages import await_data
from tests.support.screenshots import await_frames, stage
from tests.support.sites import Site
from tests.support.things import RED, box, bundle_of, picture_of
from tests.web.conftest import without_a_past

pytestmark = pytest.mark.browser
SIZE = (0.4, 0.4, 0.4)
PICTURES = [(230, 225, 215), (128, 96, 64), (40, 60, 90)]
"""Colours of photos: nearly white, a brown, a dark blue."""
_LONG_PAUSES = "const timer = setTimeout; window.setTimeout = (run, ms, ...more) => timer(run, ms || 300, ...more);"
"""A machine on which what comes between two frames takes long."""


def pixels(png: bytes) -> Bytes:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def middle(page: Page) -> Bytes:
    """The colours around the middle of the view, (N,3): of the thing, whose faces meet there."""
    await_frames(page)
    picture = pixels(stage(page))
    height, width = picture.shape[:2]
    return picture[height // 2 - 20 : height // 2 + 20, width // 2 - 20 : width // 2 + 20].reshape(-1, 3)


def cube() -> trimesh.Trimesh:
    mesh = trimesh.creation.box(SIZE)
    mesh.apply_translation((0, SIZE[1] / 2, 0))
    return mesh


def pictured(colour: tuple[int, int, int]) -> bytes:
    """A cube that shows a photo of one colour all over."""
    mesh = cube()
    photo = Image.open(io.BytesIO(picture_of(colour, 64, "PNG")))
    material = PBRMaterial(baseColorTexture=photo, metallicFactor=0.0, roughnessFactor=0.9, doubleSided=True)
    mesh.visual = TextureVisuals(uv=np.zeros((len(mesh.vertices), 2)), material=material)
    glb: bytes = trimesh.Scene(mesh).export(file_type="glb")
    return glb


def coloured(colour: tuple[int, int, int]) -> bytes:
    """A cube whose vertices have a colour, but for those at the floor, which are black."""
    mesh = cube().subdivide_to_size(0.02)
    vertices = np.asarray(mesh.vertices)
    rgb = np.where(vertices[:, 1:2] < 0.05, 0, np.array(colour)).astype(np.uint8)
    return to_glb(Mesh(vertices, np.asarray(mesh.faces), rgb), "meshopt")


def show(page: Page, site: Site, key: str, glb: bytes) -> None:
    publish(bundle_of(key, {"lod0.glb": glb}, [12], SIZE), site.store, key=key)
    page.goto(f"{site.url}/view/{key}")
    await_data(page, loaded="0")


@pytest.mark.parametrize("colour", PICTURES)
def test_a_photo_is_shown_in_its_own_colours(page: Page, site: Site, colour: tuple[int, int, int]) -> None:
    show(page, site, "pictured", pictured(colour))
    assert np.abs(middle(page).astype(int) - colour).max() <= 1, "neither lit, nor washed out, nor tinted"


@pytest.mark.essential
@pytest.mark.parametrize("colour", PICTURES)
def test_captured_colours_of_vertices_are_shown_as_they_are(
    page: Page, site: Site, colour: tuple[int, int, int]
) -> None:
    show(page, site, "coloured", coloured(colour))
    assert np.abs(middle(page).astype(int) - colour).max() <= 1


@pytest.mark.essential
def test_what_was_not_measured_is_shown_in_a_colour_of_its_own_while_that_is_wanted(page: Page, site: Site) -> None:
    mesh, white = cube(), np.full((8, 3), 255, np.uint8)
    for origin in (MEASURED, PROPOSED, FILLED):
        marks = np.full(len(mesh.vertices), origin, np.uint8)
        marks[0] = FILLED  # at a corner that is not looked at: of what is all measured, a file says nothing
        marked = Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces), white * (np.arange(8) > 0)[:, None], marks)
        show(page, site, f"origin-{origin}", to_glb(marked, "meshopt"))
        before = middle(page).astype(int)
        assert np.ptp(before, axis=1).max() <= 2, "grey and white, as its colours are"
        button = page.get_by_role("button", name="Measured", exact=True)
        button.click()
        expect(page.get_by_role("list", name="Where the surface comes from")).to_contain_text("a guess")
        shown = np.median(middle(page), axis=0)
        hue, wanted = shown / shown.max(), np.array(COLOURS[origin]) / max(COLOURS[origin])
        assert np.abs(hue - wanted).max() < 0.12, (origin, shown)
        button.click()
        np.testing.assert_array_equal(middle(page), before, "and as it was, when it is not wanted any more")


def test_what_was_all_measured_has_no_button_for_it(page: Page, site: Site) -> None:
    show(page, site, "measured", coloured(PICTURES[1]))
    expect(page.locator("#backdrop")).to_be_visible()
    expect(page.locator("#origin")).to_be_hidden()


def test_a_thing_without_colours_shows_its_form(page: Page, site: Site) -> None:
    mesh = cube()
    show(page, site, "bare", to_glb(Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces), None), "meshopt"))
    await_frames(page)
    picture = pixels(stage(page)).astype(int)
    thing = picture[np.ptp(picture, axis=2) > 12]  # clay is warmer than what is behind it
    assert 0.1 * picture[..., 0].size < len(thing)
    darkest, brightest = np.quantile(thing.mean(axis=1), (0.05, 0.95))
    assert brightest - darkest > 60, "its faces are told apart by their light alone"
    assert brightest < 235, "and none is burnt out"


def test_it_throws_a_shadow_where_it_stands_and_less_when_lifted(page: Page, site: Site) -> None:
    publish(box("Red box", RED), site.store, key="standing")
    page.goto(f"{site.url}/view/standing")
    await_data(page, loaded="2 1 0")
    page.wait_for_function("() => Number(document.body.dataset.geometries) >= 4")
    standing = darkest_grey(page)
    assert standing > 20
    page.get_by_role("button", name="Move", exact=True).click()
    page.locator("#stage").focus()
    for _ in range(4):
        page.keyboard.press("PageUp")
    assert darkest_grey(page) < standing / 2


def test_a_shadow_that_takes_long_is_drawn_as_soon_as_it_is_ready(page: Page, site: Site) -> None:
    """Nothing else asks for a frame by then: nobody touches the page."""
    publish(box("Red box", RED), site.store, key="slow")
    page.add_init_script(_LONG_PAUSES)
    page.goto(f"{site.url}/view/slow")
    await_data(page, loaded="2 1 0", geometries="4")
    assert darkest_grey(page) > 20


def darkest_grey(page: Page) -> int:
    """How much darker than the plain background the darkest pixel is that has no colour of its own."""
    await_frames(page)
    picture = pixels(stage(page)).astype(int)
    grey = picture[np.ptp(picture, axis=2) < 12]
    return int(picture[0, 0].sum() - grey.sum(axis=1).min()) // 3


def test_the_backdrop_is_chosen_and_remembered(page: Page, site: Site) -> None:
    publish(box("Red box", RED), site.store, key="standing")
    page.goto(f"{site.url}/view/standing")
    await_data(page, backdrop="light", loaded="2 1 0")
    bright = pixels(page.screenshot())[2, 2].sum()
    page.get_by_role("button", name="Background").click()
    await_data(page, backdrop="dark")
    expect(page.locator("#notice")).to_have_text("Background: dark studio.")
    dark = pixels(page.screenshot())[2, 2].sum()
    assert dark < bright / 3
    page.reload()
    await_data(page, backdrop="dark", loaded="2 1 0")
    page.evaluate("localStorage.setItem('capture2vr:backdrop', 'pink')")
    page.reload()
    await_data(page, backdrop="light")


def test_a_dark_device_gets_the_dark_studio(browser: Browser, site: Site) -> None:
    publish(box("Red box", RED), site.store, key="standing")
    with without_a_past(browser) as context:
        page = context.new_page()
        page.emulate_media(color_scheme="dark")
        page.goto(f"{site.url}/view/standing")
        await_data(page, backdrop="dark")
