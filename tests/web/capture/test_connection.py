"""The capture page on a faulty line: every wait ends, and nothing is sent twice."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from capture2vr.cli.up import Stack
from tests.support.lines import Line, line_to
from tests.support.pages import await_data, time_limit_ms
from tests.web.capture.test_page import bowl, choose  # noqa: F401 - a fixture is used by its name

pytestmark = pytest.mark.browser


@pytest.fixture
def line(stack: Stack) -> Iterator[Line]:
    """A line of each test's own."""
    line = line_to(stack.url)
    yield line
    line.mend()
    line.cut()


@pytest.fixture
def page(page: Page) -> Page:
    """A page whose clock can be put forward."""
    page.clock.install()
    return page


def pass_time(page: Page, line: Line, limit: str) -> None:
    """Wait until a request has met the fault, and let the time pass that a page waits then."""
    line.await_fault()
    page.clock.fast_forward(time_limit_ms(limit))


def send(page: Page, line: Line, path: Path, name: str) -> None:
    page.goto(line.url)
    choose(page, path)
    page.locator("#name").fill(name)
    page.get_by_role("button", name="Send").click()


@pytest.mark.parametrize(("path", "limit"), [("/v1/captures", "UPLOAD_CHECK_MS"), ("/v1/jobs$", "NETWORK_SILENCE_MS")])
def test_a_server_that_does_not_answer_is_said_and_what_was_sent_is_not_sent_twice(
    page: Page,
    line: Line,
    bowl: Path,  # noqa: F811
    path: str,
    limit: str,
) -> None:
    line.silence(path)
    send(page, line, bowl, f"unheard {len(path)}")
    pass_time(page, line, limit)
    trouble = page.get_by_role("alert")
    expect(trouble).to_contain_text("The server does not answer.")
    expect(trouble).to_contain_text("Check the connection and try again.")
    line.mend()
    trouble.get_by_role("button", name="Try again").click()
    expect(page.locator("body")).to_have_attribute("data-job", re.compile("."))
    expect(trouble).to_be_hidden()
    assert line.requests.count("/v1/captures") == (2 if path == "/v1/captures" else 1)


def test_a_job_that_is_not_heard_of_any_more_is_said_and_followed_again(
    page: Page,
    line: Line,
    bowl: Path,  # noqa: F811
) -> None:
    line.silence("/events")
    send(page, line, bowl, "silent job")
    pass_time(page, line, "EVENTS_SILENCE_MS")
    lost = page.locator("#lost")
    expect(lost).to_contain_text("The server does not answer. Your job goes on there.")
    line.mend()
    lost.get_by_role("button", name="Try again").click()
    await_data(page, state="done")
    expect(lost).to_be_hidden()


def test_a_reloaded_page_whose_job_does_not_come_says_so(page: Page, line: Line) -> None:
    line.silence("/v1/jobs/")
    page.goto(f"{line.url}/#job=job_0")
    pass_time(page, line, "NETWORK_SILENCE_MS")
    expect(page.get_by_role("alert")).to_contain_text("The server does not answer.")
    line.mend()
    page.get_by_role("button", name="Try again").click()
    expect(page.get_by_role("alert")).not_to_contain_text("does not answer")
    expect(page.get_by_role("alert")).to_contain_text("job_0")


def test_photos_are_looked_at_on_the_page_when_their_worker_never_answers(page: Page, line: Line) -> None:
    line.set_time_limits(PHOTO_WORKER_MS=500)
    page.add_init_script("window.Worker = class { postMessage() {} terminate() {} addEventListener() {} }")
    page.goto(line.url)
    found = page.evaluate(
        """async () => {
            const { queuePhoto } = await import('/web/capture/photo-quality-queue.js');
            const canvas = Object.assign(document.createElement('canvas'), { width: 64, height: 64 });
            const blob = await new Promise((resolve) => canvas.toBlob(resolve, 'image/png'));
            return Boolean(await queuePhoto(new File([blob], 'a.png', { type: 'image/png' })));
        }"""
    )
    assert found
