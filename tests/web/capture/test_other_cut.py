"""What a capture left open: one tap runs the stored capture again, with the other cut or with the answer."""

from __future__ import annotations

import json
import re
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Locator, Page, Request, expect

from capture2vr.cli.up import Stack
from tests.support.pages import await_data
from tests.support.sites import Site

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


def send(page: Page, stack: Stack, file: Path) -> None:
    page.goto(stack.url)
    with page.expect_file_chooser() as chooser:
        page.get_by_text("Choose files").click()
    chooser.value.set_files(file)
    page.locator("#preset").select_option("quick")
    page.get_by_role("button", name="Send").click()
    await_data(page, state="done")


def test_a_question_is_answered_by_a_button(page: Page, stack: Stack, tmp_path: Path) -> None:
    """A table in millimetres that names no unit was scaled to a metre."""
    ball = np.random.default_rng(0).normal(size=(4_000, 3))
    ball *= 15_000 / np.linalg.norm(ball, axis=1, keepdims=True)
    np.savetxt(tmp_path / "tank.xyz", ball, fmt="%.1f")
    send(page, stack, tmp_path / "tank.xyz")
    question = page.locator("#questions")
    expect(question).to_contain_text("in an unknown unit")
    expect(page.locator("#warnings")).not_to_contain_text("in an unknown unit")
    first = page.url
    question.get_by_role("button", name="They are millimetres").click()
    page.wait_for_url(lambda url: "#job=" in url and url != first)
    await_data(page, state="done")
    assert size_m(stack, "tank") == pytest.approx(30, rel=0.05)
    expect(question).to_be_hidden()


def marks(rows: Locator) -> list[str]:
    return rows.locator("th").all_inner_texts()


def test_columns_are_picked_by_their_numbers(page: Page, stack: Stack, tmp_path: Path) -> None:
    ball = np.random.default_rng(0).normal(size=(4_000, 3))
    ball *= 0.1 / np.linalg.norm(ball, axis=1, keepdims=True)
    np.savetxt(tmp_path / "counted.xyz", np.c_[np.linspace(0.013, 1.9, 4_000), ball], fmt="%.9f")
    send(page, stack, tmp_path / "counted.xyz")
    question, first = page.locator("#questions"), page.url
    expect(question).to_contain_text("counts the points")
    rows = page.get_by_role("region", name="The first rows of the table")
    expect(rows.locator("tr")).to_have_count(5)
    assert marks(rows) == ["1x", "2y", "3z", "4"]
    for axis, column in (("x", "2"), ("y", "3"), ("z", "4")):
        page.get_by_label(f"Column of {axis}").fill(column)
    assert marks(rows) == ["1", "2x", "3y", "4z"]
    page.get_by_label("Column of z").fill("")
    question.get_by_role("button", name="These columns").click()
    assert page.url == first, "a field without a number is not sent"
    page.get_by_label("Column of z").fill("4")
    question.get_by_role("button", name="These columns").click()
    page.wait_for_url(lambda url: "#job=" in url and url != first)
    await_data(page, state="done")
    assert size_m(stack, "counted") == pytest.approx(0.2, abs=0.01)


def test_a_hostile_table_is_shown_as_text_and_its_colours_stay(page: Page, site: Site) -> None:
    hostile = "<img src=x onerror=alert(1)>"
    values = {"columns": "x=2,y=3,z=4,r=1,g=5,b=6", "numbers": [1, 2, 3, 4, 5, 6], "rows": [[hostile] * 6]}
    told = {"code": "columns_taken", "text": "?", "text_i18n": {"code": "columns_taken", "values": values}}
    page.goto(site.url)
    page.evaluate(SHOW, {**told, "answers": [{"text": "These columns", "options": {"columns": ""}}]})
    assert page.locator("#questions td").all_inner_texts() == [hostile] * 6
    assert page.locator("#questions img").count() == 0
    assert sent_by(page) == "x=2,y=3,z=4,r=1,g=5,b=6"
    page.get_by_label("Column of x").fill("5")
    assert sent_by(page) == "x=5,y=3,z=4", "a column is not a coordinate and a colour"


SHOW = """async (question) => {
    const { showQuestions } = await import('/web/capture/run-again.js');
    showQuestions({ id: 'job', questions: [question], links: { again: '/v1/again' } });
    for (let each = document.getElementById('questions'); each; each = each.parentElement) each.hidden = false;
}"""


def sent_by(page: Page) -> str:
    """The columns that the question's button asks for."""
    with page.expect_request("**/v1/again") as request:
        page.get_by_role("button", name="These columns").click()
    return str(request.value.post_data_json["columns"])
