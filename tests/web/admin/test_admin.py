"""The operator's page in the browser: it shows what the API says, sets limits and revokes keys."""

from __future__ import annotations

import re
from collections.abc import Iterator

import httpx
import pytest
from playwright.sync_api import Browser, Page, expect

from capture2vr.gateway.access.caller import ALL_SCOPES, Scope
from capture2vr.storage.catalogue.signing import NO_KEYS
from tests.support.pages import await_data
from tests.support.sites import Site, site_at
from tests.support.tenants import bearer, make_key, publish_for
from tests.web.conftest import PHONE, without_a_past

pytestmark = pytest.mark.browser

TENANTS = [f"tenant-{number:02}" for number in range(25)]  # more than a page of the table


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Site, str, str]]:
    """A gateway with many tenants and a worker that is silent; the keys of an operator and of a tenant."""
    folder = tmp_path_factory.mktemp("service")
    operator = make_key(folder / "data", "default", {Scope.OPERATE}, label="operator")
    for tenant in TENANTS:
        make_key(folder / "data", tenant, {Scope.READ})
    ada = make_key(folder / "data", "ada", ALL_SCOPES - {Scope.OPERATE}, label="Ada's <b>phone</b>")
    with site_at(folder, NO_KEYS, "127.0.0.1:9") as site:
        publish_for(site.store, "ada", "dress")
        yield site, operator, ada


@pytest.fixture
def page(browser: Browser, service: tuple[Site, str, str]) -> Iterator[Page]:
    """The page, as an operator sees it."""
    site, operator, _ = service
    with without_a_past(browser, {"width": 1280, "height": 1600}) as context:
        context.request.post(f"{site.url}/v1/session", data={"key": operator})
        page = context.new_page()
        page.goto(f"{site.url}/admin")
        await_data(page, state="complete")
        yield page


def rows(page: Page, table: str) -> list[list[str]]:
    cells: list[list[str]] = page.locator(f"#{table} tbody").evaluate(
        "body => [...body.rows].map((row) => [...row.cells].map((cell) => cell.textContent))"
    )
    return cells


@pytest.mark.essential
def test_every_figure_is_the_apis(page: Page, service: tuple[Site, str, str]) -> None:
    site, operator, _ = service
    with httpx.Client(base_url=site.url, headers=bearer(operator)) as client:
        told = client.get("/v1/service").json()
        used = client.get("/v1/tenants/ada/usage").json()
        changes = client.get("/v1/audit", params={"tenant": "*"}).json()["records"]
    assert told["ready"] is False, "no worker answers"
    expect(page.locator("#said")).to_have_text(f"Version {told['version']}, not ready.")
    assert [row[0] for row in rows(page, "workers")] == told["silent_workers"] == ["127.0.0.1:9"]
    assert {row[0]: row[1] for row in rows(page, "checks")} == {
        "Store": "good", "Database": "good", "Disk space": "good", "Workers": "bad",
    }  # fmt: skip
    assert {row[0]: int(row[1]) for row in rows(page, "queue")} == {k.lower(): v for k, v in told["jobs"].items()}
    assert [row[0] for row in rows(page, "disks")] == [disk["holds"] for disk in told["disks"]]
    assert rows(page, "failures") == [["none"]]
    (ada,) = [row for row in rows(page, "tenants") if row[0] == "ada"]
    assert ada[2:4] == ["0", "0"]
    assert ada[4] == f"{used['stored_bytes'] / 1000:.1f} kB"
    assert len(rows(page, "audit")) == min(20, len(changes))
    assert rows(page, "audit")[0][4] == "POST /v1/session"


def test_pages_of_tenants_and_names_that_are_markup(page: Page) -> None:
    assert len(rows(page, "tenants")) == 20
    page.get_by_role("button", name="More tenants").click()
    expect(page.get_by_role("button", name="More tenants")).to_be_hidden()
    assert [row[0] for row in rows(page, "tenants")] == ["ada", "default", *TENANTS]
    page.get_by_role("button", name="More keys").click()
    expect(page.locator("#keys td", has_text="Ada's <b>phone</b>")).to_have_count(1)


def test_limits_are_set(page: Page, service: tuple[Site, str, str]) -> None:
    site, _, ada = service
    page.locator("#limited").select_option("ada")
    page.get_by_label("Jobs at once").fill("3")
    page.get_by_label("Stored bytes").fill("5000000")
    page.get_by_role("button", name="Set the limits").click()
    row = page.locator("#tenants tbody tr", has=page.locator("td", has_text="ada")).first
    expect(row).to_contain_text("3 jobs at once, 5.0 MB stored")
    said = re.compile("^The limits of ada: .*3 jobs at once, 5.0 MB stored.$")
    expect(page.locator("#limits-said")).to_have_text(said)
    limits = httpx.get(f"{site.url}/v1/usage", headers=bearer(ada)).json()["limits"]
    assert (limits["jobs_at_once"], limits["stored_bytes"], limits["jobs_per_day"]) == (3, 5_000_000, 0)
    page.reload()
    page.locator("#limited").select_option("ada")
    expect(page.get_by_label("Jobs at once")).to_have_value("3")
    page.get_by_label("Stored bytes").fill("")
    page.get_by_label("Jobs a day").fill("40")
    page.get_by_role("button", name="Set the limits").click()
    expect(page.locator("#limits-said")).to_contain_text("40 jobs a day")
    told = httpx.get(f"{site.url}/v1/usage", headers=bearer(ada)).json()
    assert told["own_limits"] == {"jobs_at_once": 3, "jobs_per_day": 40}, "the others stay, an empty one is removed"
    page.route("**/v1/tenants/ada/usage", lambda route: route.abort(), times=1)
    page.locator("#limited").select_option(TENANTS[0])
    page.locator("#limited").select_option("ada")
    expect(page.locator("#limits-trouble")).to_contain_text("cannot be reached")
    expect(page.get_by_label("Jobs at once")).to_be_disabled()
    page.get_by_role("button", name="Set the limits").click()
    expect(page.get_by_label("Jobs at once")).to_have_value("3")


def test_what_fails_is_said_beside_it_and_stays(page: Page) -> None:
    page.get_by_label("Jobs a day").fill("2" + "0" * 18)
    page.get_by_role("button", name="Set the limits").click()
    expect(page.locator("#limits-trouble")).to_contain_text("less than or equal to")
    page.route("**/v1/api-keys?*", lambda route: route.abort(), times=1)
    page.get_by_role("button", name="More keys").click()
    expect(page.locator("#keys-trouble")).to_contain_text("cannot be reached")
    with page.expect_response("**/v1/service"):
        pass
    expect(page.locator("#limits-trouble")).to_be_visible()
    page.get_by_role("button", name="More keys").click()
    expect(page.locator("#keys-trouble")).to_be_hidden()


def test_the_page_fills_once_the_server_answers(page: Page) -> None:
    page.clock.install()
    page.route("**/v1/service", lambda route: route.abort(), times=1)
    page.reload()
    await_data(page, state="error", code="OFFLINE")
    page.clock.fast_forward(10_000)
    await_data(page, state="complete")
    assert len(rows(page, "tenants")) == 20


def test_a_key_is_revoked_by_two_presses(page: Page, service: tuple[Site, str, str]) -> None:
    site, operator, _ = service
    made = httpx.post(
        f"{site.url}/v1/api-keys", json={"scopes": ["read"], "tenant": "ada", "label": "lost"}, headers=bearer(operator)
    ).json()
    page.reload()
    await_data(page, state="complete")
    while page.get_by_role("button", name="More keys").is_visible():
        before = len(rows(page, "keys"))
        page.get_by_role("button", name="More keys").click()
        page.wait_for_function("before => document.querySelectorAll('#keys tbody tr').length > before", arg=before)
    row = page.locator("#keys tbody tr", has_text="lost")
    row.get_by_role("button", name="Revoke").click()
    assert httpx.get(f"{site.url}/v1/session", headers=bearer(made["secret"])).status_code == 200
    row.get_by_role("button", name="Revoke for good?").click()
    cell = row.locator("td").last
    expect(cell).to_contain_text("revoked")
    expect(cell).to_be_focused()
    assert len(rows(page, "keys")) > 20, "as many as were shown"
    assert httpx.get(f"{site.url}/v1/session", headers=bearer(made["secret"])).json()["code"] == "KEY_REVOKED"


def test_it_is_for_operators(browser: Browser, service: tuple[Site, str, str]) -> None:
    site, _, ada = service
    with without_a_past(browser, PHONE) as context:
        page = context.new_page()
        page.goto(f"{site.url}/admin")
        page.wait_for_url("**/login?next=%2Fadmin")
        context.request.post(f"{site.url}/v1/session", data={"key": ada})
        page.goto(f"{site.url}/admin")
        await_data(page, state="error", code="SCOPE_MISSING")
        expect(page.locator("#service")).to_be_hidden()
