"""A scene in tiles in the viewer: fine where one looks, coarse elsewhere, and never a hole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import BrowserContext, Page, expect

from capture2vr.edge.geodesy.place_on_earth import asset_to_earth
from capture2vr.storage.catalogue.publish import publish
from tests.support.headsets import Hand, enter, wear
from tests.support.pages import await_data
from tests.support.screenshots import await_frames, drawn, stage
from tests.support.sites import Site
from tests.support.tilesets import hill_bundle, hills

pytestmark = pytest.mark.browser
KEY = "hills"
START_M = float(hills(np.array(0.0), np.array(0.0)))
"""Height of the ground where a wearer begins."""


@pytest.fixture(scope="module", autouse=True)
def published(site: Site) -> None:
    """Hills of 12 m in 1 + 4 + 16 + 64 tiles, whose place on earth the pages leave alone."""
    to_earth = asset_to_earth("EPSG:32632", np.array([691_607.0, 5_334_760.0, 520.0]), np.eye(4))
    publish(hill_bundle(levels=4, to_earth=to_earth)[0], site.store, key=KEY)


def _until(page: Page, condition: str) -> None:
    page.wait_for_function(f"() => {{ const data = document.body?.dataset ?? {{}}; return {condition}; }}")


@pytest.mark.essential
def test_tiles_replace_the_whole_and_become_finer_near_by(page: Page, site: Site) -> None:
    finest: list[str] = []
    page.on("request", lambda request: finest.append(request.url) if "/tile-3-" in request.url else None)
    page.goto(f"{site.url}/view/{KEY}")
    _until(page, "Number(data.tiles) > 0")
    assert drawn(stage(page)) > 0.05
    page.wait_for_load_state("networkidle")
    assert not finest, "from afar nobody sees them"
    assert page.evaluate("document.body.dataset.loaded") == "2", "finer levels of the whole are not needed"

    page.mouse.move(160, 240)
    with page.expect_request("**/tile-3-*"):
        page.mouse.wheel(0, -6_000)
    page.wait_for_load_state("networkidle")
    assert len(finest) < 64, "what is not in view is not loaded"
    await_frames(page)
    assert drawn(stage(page)) > 0.3
    expect(page.locator("#said")).to_contain_text("85 tiles")


def test_a_tile_comes_over_the_network_once(page: Page, site: Site) -> None:
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url) if "/tile-" in request.url else None)
    page.goto(f"{site.url}/view/{KEY}")
    _until(page, "Number(data.tiles) > 0")
    page.wait_for_load_state("networkidle")
    assert asked
    assert len(asked) == len(set(asked))
    first = len(asked)

    page.reload()
    _until(page, "Number(data.tiles) > 0")
    page.wait_for_load_state("networkidle")

    assert not set(asked[first:]) & set(asked[:first]), "what the device has is not asked for again"


def test_without_one_of_its_tiles_the_coarser_one_stays(page: Page, site: Site) -> None:
    page.route("**/tile-1-0-0.*", lambda route: route.fulfill(status=404, body="gone"))
    page.goto(f"{site.url}/view/{KEY}")

    expect(page.locator("#notice")).to_contain_text("tile-1-0-0.glb could not be loaded")
    _until(page, "data.tiles === '1'")

    await_frames(page)
    assert drawn(stage(page)) > 0.05


def test_without_its_list_of_tiles_the_whole_is_shown(page: Page, site: Site) -> None:
    page.route("**/tileset.*.json", lambda route: route.fulfill(status=404, body="gone"))
    page.goto(f"{site.url}/view/{KEY}")

    expect(page.locator("#notice")).to_contain_text("tileset.json could not be loaded")

    await_data(page, loaded="2 1 0")
    await_frames(page)
    assert drawn(stage(page)) > 0.05


@pytest.fixture
def walker(context: BrowserContext, iwer: Path, page: Page, site: Site) -> Page:
    """The hills around a wearer who stands at the origin, once their tiles are there."""
    wear(context, iwer)
    page.goto(f"{site.url}/view/{KEY}")
    _until(page, "Number(data.tiles) > 0")
    enter(page)
    return page


def _scene(page: Page) -> tuple[float, ...]:
    """Where the scene is in the wearer's room."""
    return tuple(map(float, page.evaluate("document.body.dataset.placed").split()))


def test_who_enters_a_large_scene_stands_inside_and_walks_by_thumbstick(walker: Page) -> None:
    assert _scene(walker) == (0, pytest.approx(-START_M, abs=0.02), 0), "on the hills' middle, not in them"
    before = _scene(walker)
    Hand(walker, "left").stick(0, -1, 20)
    _, y, z = _scene(walker)
    assert y == before[1]
    assert z > 0.05, "who goes ahead has the scene come towards them"
    Hand(walker, "right").stick(1, 0, 5)
    assert walker.evaluate("document.body.dataset.tiles") != "0"
    assert drawn(stage(walker)) > 0.2


def test_a_trigger_on_the_ground_goes_there(walker: Page) -> None:
    right = Hand(walker, "right")
    right.move(0.2, 1.5, 0, down=40)
    right.press()
    right.release()

    x, y, z = _scene(walker)

    # What the wearer now stands on is what the ray hit: it was on the ray, and is the ground's height.
    assert x == pytest.approx(-0.2, abs=0.02)
    ahead = z
    assert 0.3 < ahead < 3
    assert -y == pytest.approx(START_M + 1.5 - ahead * np.tan(np.radians(40)), abs=0.05)
    assert -y == pytest.approx(float(hills(np.array(0.2), np.array(-ahead))), abs=0.1)


def test_a_place_in_the_sky_is_none_to_go_to(walker: Page) -> None:
    right = Hand(walker, "right")
    right.move(0.2, 1.5, 0, down=-30)
    before = _scene(walker)
    right.press()
    right.release()
    assert _scene(walker) == before


def test_the_right_stick_forward_shows_the_place_and_goes_there_when_let_go(walker: Page) -> None:
    right = Hand(walker, "right")
    right.move(0.0, 1.5, 0, down=50)
    right.stick(0, -1, 10)
    x, y, z = _scene(walker)
    assert x == pytest.approx(0, abs=0.02)
    assert y < 0
    assert z > 0.3
