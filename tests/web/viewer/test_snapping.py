"""What a hand lets go of near a floor or a wall comes to stand there; what it lets go of elsewhere stays."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserContext, Page

from capture2vr.storage.catalogue.publish import publish
from tests.support.headsets import Hand, enter, furnish, wear
from tests.support.pages import await_data
from tests.support.sites import Site
from tests.support.things import RED, box
from tests.web.conftest import without_a_past
from tests.web.viewer.test_moving import MIDDLE, moved, near

pytestmark = pytest.mark.browser

# The cube of 0.4 m stands 1.5 m ahead on a floor of its own, a metre above the wearer's.
TABLE, WALL = ("table", (0.0, 0.75, -1.5)), ("wall", (0.0, 1.0, -2.0))


@pytest.fixture(scope="module")
def viewer(site: Site) -> str:
    """The address of a red cube."""
    publish(box("Cube", RED), site.store, key="snapped")
    return f"{site.url}/view/snapped"


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    with without_a_past(browser, {"width": 480, "height": 300}) as context:
        yield context


def test_what_is_nearly_upright_and_nearly_on_the_floor_stands_on_it(
    context: BrowserContext, iwer: Path, page: Page, viewer: str
) -> None:
    wear(context, iwer)
    page.goto(viewer)
    await_data(page, loaded="2 1 0")
    enter(page)
    x, y, z = MIDDLE
    hand = Hand(page, "right")
    hand.move(x, y, z)
    hand.press("squeeze")
    hand.move(x + 0.3, y + 0.04, z, down=8)
    hand.release("squeeze")
    assert moved(page)[1] == 0, "4 cm above it, and tilted by 8 degrees"
    assert page.evaluate("localStorage.getItem('capture2vr:placed')").count(",0,0,0,1,1]") == 1, "it is upright"

    hand.move(x + 0.3, y, z)
    hand.press("squeeze")
    hand.move(x + 0.3, y + 0.1, z)
    hand.release("squeeze")
    assert moved(page)[1] == pytest.approx(0.1, abs=0.01), "10 cm above it is meant"


def test_in_a_furnished_room_it_stands_on_the_table_and_against_the_wall(
    context: BrowserContext, iwer: Path, page: Page, viewer: str
) -> None:
    wear(context, iwer)
    furnish(context, [TABLE, WALL])
    page.goto(viewer)
    await_data(page, loaded="2 1 0")
    enter(page, "AR")
    await_data(page, planes="2")
    x, y, z = MIDDLE
    hand = Hand(page, "right")
    hand.move(x, y, z)
    hand.press("squeeze")
    hand.move(x + 0.1, y - 0.22, z - 0.2)  # 3 cm above the table, and 10 cm before the wall
    hand.release("squeeze")
    assert moved(page) == near(0.1, -0.25, -0.3, 1)
