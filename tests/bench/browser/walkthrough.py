"""A new user's way through the product on a phone-sized page: each step with a picture that is to be looked at.

The product runs as a user starts it, and asks for keys. One logs in, captures fruit by photos, crops it, turns it,
gives it a size, names and shares it, and places it with two other things in a scene. Its link is opened in an emulated
Quest 3 and on another phone that is logged in nowhere.
"""

from __future__ import annotations

import io
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import httpx
from PIL import Image, ImageDraw, ImageFont
from playwright.sync_api import Browser, Page, sync_playwright

from capture2vr.cli.progress import StageBar
from capture2vr.cli.up import Stack, run_stack
from capture2vr.client.jobs import follow
from capture2vr.client.upload import upload
from capture2vr.gateway.access.caller import ALL_SCOPES, Scope
from tests.bench.data_files import PICTURES, data_file
from tests.support.chromium import launch
from tests.support.headsets import Hand, enter, frames, wear
from tests.support.npm_packages import installed
from tests.support.pages import open_panel
from tests.support.repository import ROOT
from tests.support.tenants import bearer, make_key
from tests.web.conftest import PHONE, without_a_past

_PICTURE = PICTURES / "walkthrough.jpg"
_WEB = ROOT / "tests" / "web"
_PATIENCE_MS = 900_000  # of a whole job
_OTHERS = {"dress": "dress/dress-v17k-f34k.obj", "truck": "milktruck"}
_COLUMNS, _WIDTH, _CAPTION = 6, 300, 34  # of the sheet: pictures beside each other, pixels of one, of its caption


@dataclass(slots=True)
class _Way:
    """The steps so far: their captions with their pictures, and a row of the table for each."""

    began: float = field(default_factory=time.perf_counter)
    pictures: list[tuple[str, bytes]] = field(default_factory=list)

    def take(self, page: Page, step: str, said: str = "") -> None:
        """Take a picture of the page, and print the row."""
        self.pictures.append((step, page.screenshot()))
        text = page.locator(said).inner_text() if said else ""
        print(f"| {len(self.pictures)}. {step} | {time.perf_counter() - self.began:.0f} | {text} |", flush=True)


def main(arguments: list[str]) -> None:
    """Print the table, and keep the pictures as results/pictures/walkthrough.jpg."""
    print("| step | after s | what the page says |\n|---|---|---|")
    way = _Way()
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        key = make_key(Path(folder) / "gateway", "ada", ALL_SCOPES - {Scope.OPERATE})
        with run_stack("127.0.0.1", 0, Path(folder)) as stack:
            browser = launch(playwright)
            with without_a_past(browser, PHONE, has_touch=True) as context:
                page = context.new_page()
                page.set_default_timeout(_PATIENCE_MS)
                for step in (_log_in, _capture, _edit, _name, _share):
                    step(page, stack.url, way, key)
                _make_others(stack, key)
                link = _place(page, stack.url, way)
            _wear(browser, link, way)
            _visit(browser, link, way)
            browser.close()
    _sheet(way.pictures).save(_PICTURE, quality=70)


_Step = Callable[[Page, str, _Way, str], None]


def _log_in(page: Page, url: str, way: _Way, key: str) -> None:
    page.goto(url)  # which leads to the login
    page.get_by_label("Access key").fill(key)
    way.take(page, "Log in")
    page.get_by_role("button", name="Log in with the key").click()
    page.wait_for_url(f"{url}/")


def _capture(page: Page, url: str, way: _Way, key: str) -> None:
    way.take(page, "Capture page")
    photos = sorted(data_file("photos_fruit/images").iterdir())
    page.locator("#files").set_input_files(photos)
    page.locator(f"body[data-looked='{len(photos)}']").wait_for()
    way.take(page, "Photos are looked at", "#advice")
    page.locator("#name").fill("fruit")
    page.get_by_role("button", name="Send").click()
    page.locator("body[data-state=working]").wait_for()
    way.take(page, "A job", "#doing")
    page.locator("body[data-preview]").wait_for()
    page.locator("#ready").scroll_into_view_if_needed()
    way.take(page, "Preview", "#ready")
    page.locator("body[data-state=done]").wait_for()
    way.take(page, "Refined", "#ready")


def _edit(page: Page, url: str, way: _Way, key: str) -> None:
    page.goto(f"{url}/edit/fruit")
    page.locator("body[data-state=ready]").wait_for()
    page.get_by_label("Keep only what is inside a box").check()
    for side, share in (("Left", 0.12), ("Right", 0.88)):
        slider = page.locator("#box-sides label", has_text=side).locator("input")
        slider.evaluate("(input, at) => { input.value = at; input.dispatchEvent(new Event('input')); }", share)
    page.wait_for_timeout(1000)  # for the picture alone
    way.take(page, "Crop", "#said")
    page.get_by_role("tab", name="Upright").click()
    for _ in range(3):
        page.get_by_role("button", name="Turn left").click()
    page.wait_for_timeout(1000)
    way.take(page, "Turn", "#said")
    page.get_by_role("tab", name="Size").click()
    page.get_by_role("button", name="Choose two points").click()
    for x in (145, 245):
        page.locator("#stage").click(position={"x": x, "y": 230})
        page.wait_for_timeout(500)
    page.get_by_label("in centimetres").fill("5")
    way.take(page, "True size", "#said")
    page.get_by_role("button", name="Save as a new version").click()
    page.locator("body[data-state=ready]:not([data-version='1']):not([data-version='2'])").wait_for()
    page.wait_for_timeout(1000)
    way.take(page, "A new version", "#said")


def _name(page: Page, url: str, way: _Way, key: str) -> None:
    page.goto(f"{url}/view/fruit")
    page.locator("body[data-loaded]").wait_for()
    page.wait_for_timeout(3000)  # finer levels come
    way.take(page, "View", "#said")
    open_panel(page, "Name it")
    page.get_by_label("Name", exact=True).fill("Fruit on a plate")
    page.get_by_label("Tags, with commas").fill("kitchen, still life")
    page.locator("#names").get_by_role("button", name="Save").click()
    page.locator("#names-saved", has_text="Saved.").wait_for()
    way.take(page, "Name and label", "#names-saved")
    open_panel(page, "Name it")


def _share(page: Page, url: str, way: _Way, key: str) -> None:
    open_panel(page, "Share")
    page.get_by_role("button", name="Make a link").click()
    image = page.locator("#links img")
    image.wait_for()
    image.evaluate("each => each.decode()")
    image.scroll_into_view_if_needed()
    way.take(page, "Share", "#links p")


def _make_others(stack: Stack, key: str) -> None:
    """Two other things, as an engineer pushes them."""
    with httpx.Client(base_url=stack.url, headers=bearer(key), timeout=600, trust_env=False) as client:
        for name, path in _OTHERS.items():
            with StageBar() as bar:
                capture = upload(client, data_file(path), bar)
            order = {"capture": capture["capture"], "asset_key": name, "preset": "draft", "longest_m": 0.5}
            job = client.post("/v1/jobs", json=order).raise_for_status().json()
            for state in follow(client, job["id"]):
                job = state
            print(f"<!-- {name}: {job['state']} -->", flush=True)


def _place(page: Page, url: str, way: _Way) -> str:
    """The link of a scene of three things."""
    page.goto(f"{url}/browse/default")
    page.locator("body[data-state=shown]").wait_for()
    for key in ("fruit", *_OTHERS):
        page.locator(f"[data-key={key}]").get_by_role("checkbox").check()
    page.wait_for_timeout(1000)
    way.take(page, "Choose three", "#count")
    page.get_by_role("link", name="Open together").click()
    _await_things(page, 3)
    page.get_by_role("button", name="truck", exact=True).click()
    page.locator("#stage").focus()
    for _ in range(4):
        page.keyboard.press("ArrowUp")
    open_panel(page, "Scene")
    page.get_by_label("Name of the scene").fill("On the table")
    page.locator("#scene").get_by_role("button", name="Save").click()
    page.wait_for_url("**/scene/scn_*")
    _await_things(page, 3)
    way.take(page, "A scene", "#said")
    open_panel(page, "Share")
    page.get_by_role("button", name="Make a link").click()
    page.locator("#links a").wait_for()
    return str(page.locator("#links a").get_attribute("href"))


def _wear(browser: Browser, link: str, way: _Way) -> None:
    """The same scene in a Quest 3, whose wearer takes a thing up."""
    emulator = installed("iwer", _WEB, what="the WebXR emulator") / "node_modules" / "iwer" / "build" / "iwer.min.js"
    with without_a_past(browser, {"width": 1000, "height": 500}) as context:
        wear(context, emulator)
        page = context.new_page()
        page.set_default_timeout(_PATIENCE_MS)
        page.goto(link)
        _await_things(page, 3)
        enter(page)
        frames(page, 10)
        way.take(page, "Quest 3")
        hand = Hand(page, "right")
        hand.move(0.3, 1.2, -0.4)
        frames(page, 10)
        way.take(page, "A hand in it")


def _visit(browser: Browser, link: str, way: _Way) -> None:
    """The same scene on a phone that is logged in nowhere, and whose browser prefers German."""
    with without_a_past(browser, PHONE, has_touch=True, locale="de-DE") as context:
        page = context.new_page()
        page.set_default_timeout(_PATIENCE_MS)
        page.goto(link)
        _await_things(page, 3)
        way.take(page, "Opened from the link", "#said")


def _await_things(page: Page, count: int) -> None:
    page.wait_for_function("count => document.body.dataset.loaded?.split('; ').length === count", arg=count)
    page.wait_for_timeout(3000)  # finer levels come


def _sheet(pictures: list[tuple[str, bytes]]) -> Image.Image:
    """All pictures with their captions, row by row."""
    height = _WIDTH * PHONE["height"] // PHONE["width"] + _CAPTION
    rows = -(-len(pictures) // _COLUMNS)
    sheet = Image.new("RGB", (_COLUMNS * (_WIDTH + 10), rows * (height + 10)), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(18)
    for place, (caption, png) in enumerate(pictures):
        x, y = place % _COLUMNS * (_WIDTH + 10), place // _COLUMNS * (height + 10)
        draw.text((x + 4, y + 4), f"{place + 1}. {caption}", "black", font)
        with Image.open(io.BytesIO(png)) as picture:
            size = (_WIDTH, _WIDTH * picture.height // picture.width)
            sheet.paste(picture.convert("RGB").resize(size), (x, y + _CAPTION))
    return sheet
