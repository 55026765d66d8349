"""A thing that was cut too closely: the page says so, and one tap runs the stored capture again with the other cut."""

from __future__ import annotations

import json
import re
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, Request, expect

from capture2vr.cli.up import Stack
from tests.support.pages import await_data

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cloud: a ball of 20 cm on a table of a metre, and half a metre beside it another one with fewer points."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(5_000, 3))
    balls = 0.1 * direction / np.linalg.norm(direction, axis=1, keepdims=True) + [0, 0.1, 0]
    balls[3_000:] += [0.35, 0, 0]
    table = np.column_stack([rng.uniform(-0.5, 0.5, 6_000), np.zeros(6_000), rng.uniform(-0.5, 0.5, 6_000)])
    xyz = np.concatenate([balls, table]) + rng.normal(0, 5e-4, (11_000, 3))
    path = tmp_path_factory.mktemp("captures") / "two_balls.ply"
    header = ["ply", "format ascii 1.0", f"element vertex {len(xyz)}", *(f"property float {axis}" for axis in "xyz")]
    path.write_text("\n".join([*header, "end_header", *(" ".join(map(str, each)) for each in xyz.round(5))]) + "\n")
    return path


def size_m(stack: Stack, key: str) -> float:
    with urllib.request.urlopen(f"{stack.url}/v1/assets/{key}") as answer:
        return max(json.load(answer)["size_m"])


def test_one_tap_gives_the_other_cut_without_an_upload(page: Page, stack: Stack, pair: Path) -> None:
    uploads: list[str] = []

    def note(request: Request) -> None:
        uploads.extend([request.url] if request.method == "POST" and request.url.endswith("/v1/captures") else [])

    page.on("request", note)
    page.goto(stack.url)
    with page.expect_file_chooser() as chooser:
        page.get_by_text("Choose files").click()
    chooser.value.set_files(pair)
    page.locator("#preset").select_option("quick")
    page.locator("#cut").select_option("object")
    page.get_by_role("button", name="Send").click()
    await_data(page, state="done")
    first = page.url
    expect(page.locator("#warnings")).to_contain_text("beside the object was removed, which has 67% as many points")
    assert size_m(stack, "two-balls") == pytest.approx(0.2, abs=0.02)

    offer = page.get_by_role("button", name="Keep everything that was seen")
    offer.click()
    page.wait_for_url(lambda url: "#job=" in url and url != first)
    await_data(page, state="done")
    expect(page.get_by_role("button", name="Keep only the object in the middle")).to_be_visible()
    expect(page.locator("body")).to_have_attribute("data-preview", re.compile(r"\d+"))
    assert len(uploads) == 1, "the capture is stored, and is not sent twice"
    assert size_m(stack, "two-balls") > 0.9
