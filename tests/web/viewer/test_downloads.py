"""The panel that downloads a thing for other programs: by keyboard, waiting while it is made, saying what cannot be."""

from __future__ import annotations

import io
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from playwright.sync_api import Page, Route, expect

from capture2vr.cli.up import Stack
from capture2vr.edge.arrays import Floats
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.catalogue.signing import NO_KEYS
from capture2vr.storage.local import LocalStore
from tests.support.pages import await_data, open_panel
from tests.support.patience import HANG_S
from tests.support.screenshots import await_frames, difference, drawn, stage
from tests.support.sites import Site, gateway_at

pytestmark = pytest.mark.browser


def test_a_file_is_made_and_saved_by_keyboard(page: Page, stack: Stack, bundle: Bundle, tmp_path: Path) -> None:
    publish(bundle, LocalStore(stack.store_root), key="bowl")
    page.goto(f"{stack.url}/view/bowl")
    await_data(page, loaded="2 1 0")
    page.locator("#downloads summary").press("Enter")
    await_data(page, downloads="10")
    button = page.get_by_role("button", name="STL")
    expect(button).to_have_accessible_description(
        "For 3D printing: every triangle, no colours. Millimetres, Z up, as slicers expect."
    )
    first = []

    def not_at_once(route: Route) -> None:
        if first:
            route.continue_()
        else:
            first.append(route)
            route.fulfill(status=202, headers={"Retry-After": "0"}, json={"format": "stl", "file": "bowl.stl"})

    page.route("**/download?format=stl", not_at_once)
    with page.expect_download() as saving:
        button.press("Enter")
    assert saving.value.suggested_filename == "bowl.stl"
    saving.value.save_as(tmp_path / "bowl.stl")
    full = trimesh.load(io.BytesIO(bundle.files["mesh.ply"]), file_type="ply")
    assert len(trimesh.load(tmp_path / "bowl.stl").faces) == len(full.faces)
    expect(page.locator("#downloads-said")).to_have_text("bowl.stl is being saved.")


def test_what_cannot_be_made_now_is_said(page: Page, bundle: Bundle, tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "store")
    publish(bundle, store, key="bowl")
    with gateway_at(tmp_path, store, NO_KEYS, "127.0.0.1:9") as url:
        page.goto(f"{url}/view/bowl")
        await_data(page, loaded="2 1 0")
        open_panel(page, "Download")
        await_data(page, downloads="10")
        panel, shown = page.locator("#downloads").bounding_box(), page.viewport_size
        assert panel is not None
        assert shown is not None
        assert panel["y"] >= 0
        assert panel["y"] + panel["height"] <= shown["height"], "all of it can be scrolled to"
        page.get_by_role("button", name="GLB", exact=True).click()
        expect(page.locator("#downloads-trouble")).to_have_text(
            "No worker is there to make the file. Try again in a moment."
        )
        expect(page.get_by_role("button", name="GLB", exact=True)).to_be_enabled()


def test_a_list_that_does_not_come_is_asked_for_at_the_next_opening(page: Page, site: Site, bundle: Bundle) -> None:
    publish(bundle, site.store, key="bowl")
    page.goto(f"{site.url}/view/bowl")
    await_data(page, loaded="2 1 0")
    page.route("**/downloads", lambda route: route.abort(), times=1)
    page.get_by_text("Download", exact=True).click()
    expect(page.locator("#downloads-trouble")).to_contain_text("The server cannot be reached.")
    page.get_by_text("Download", exact=True).click()
    open_panel(page, "Download")
    await_data(page, downloads="10")
    expect(page.locator("#downloads-trouble")).to_be_hidden()


def test_splats_are_shown_in_place_of_the_mesh(page: Page, stack: Stack, bundle: Bundle) -> None:
    publish(bundle, LocalStore(stack.store_root), key="bowl")
    faults: list[str] = []
    page.on("console", lambda message: faults.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.goto(f"{stack.url}/view/bowl")
    await_data(page, loaded="2 1 0")
    open_panel(page, "Download")
    await_data(page, downloads="10")
    mesh = stage(page)
    button = page.get_by_role("button", name="Show them here")
    button.click()
    await_data(page, splats="shown")
    expect(button).to_have_attribute("aria-pressed", "true")
    await_picture(page, lambda picture: drawn(picture) > 0.8 * drawn(mesh))
    splats = stage(page)
    assert difference(mesh, splats) > 0.001, "it is another picture"
    (mine, of_mesh), (theirs, of_splats) = colours(mesh), colours(splats)
    assert of_splats == pytest.approx(of_mesh, rel=0.1)
    assert np.abs(mine - theirs).max() < 12
    button.click()
    await_data(page, splats="hidden")
    await_picture(page, lambda picture: difference(picture, mesh) < 0.001)
    assert faults == []


def colours(png: bytes) -> tuple[Floats, float]:
    """Mean colour (3,) of what is drawn, and its share of the picture."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(float)
    thing = np.abs(pixels - pixels[0, 0]).max(axis=2) > 12
    return pixels[thing].mean(axis=0), float(thing.mean())


def await_picture(page: Page, is_it: Callable[[bytes], bool]) -> None:
    """Until the canvas shows what is asked for: splats are sorted in a worker before they are drawn."""
    until = time.monotonic() + HANG_S
    while not is_it(stage(page)):
        assert time.monotonic() < until, "it was never drawn"
        await_frames(page)
