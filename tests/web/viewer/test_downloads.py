"""The panel that downloads a thing for other programs: by keyboard, waiting while it is made, saying what cannot be."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
import trimesh
from playwright.sync_api import Page, Route, expect

from services.cli.up import Stack
from services.storage.bundle import Bundle
from services.storage.catalogue.publish import publish
from services.storage.local import LocalStore
from tests.support.pages import await_data
from tests.support.sites import Site

pytestmark = pytest.mark.browser


def test_a_file_is_made_and_saved_by_keyboard(page: Page, stack: Stack, bundle: Bundle, tmp_path: Path) -> None:
    publish(bundle, LocalStore(stack.store_root), key="bowl")
    page.goto(f"{stack.url}/view/bowl")
    await_data(page, loaded="2 1 0")
    page.locator("#downloads summary").press("Enter")
    await_data(page, downloads="8")
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


def test_what_cannot_be_made_now_is_said(page: Page, site: Site, bundle: Bundle) -> None:
    publish(bundle, site.store, key="bowl")
    page.goto(f"{site.url}/view/bowl")
    await_data(page, loaded="2 1 0")
    page.get_by_text("Download", exact=True).click()
    await_data(page, downloads="8")
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
