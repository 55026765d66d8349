"""Other web sites make no requests here through a visitor's browser: their names and their forms are refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from starlette.datastructures import Headers

from capture2vr.gateway.app import create_app
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.same_site import SiteRules
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.memory import MemoryStore
from tests.support.bundles import bundle
from tests.support.in_process_gateway import answering, gateway, memory

RULES = SiteRules({"vr.example"}, ("https://app.example",))
LABEL = st.from_regex(r"[a-z][a-z0-9]{0,8}", fullmatch=True)
PORT = st.sampled_from(["", ":80", ":8080", ":443"])


def refusal(rules: SiteRules, method: str = "GET", **headers: str) -> str:
    """The problem's code, "" where there is none."""
    try:
        rules.check(method, Headers({name.replace("_", "-"): value for name, value in headers.items()}))
    except Problem as problem:
        return problem.code
    return ""


@given(st.lists(LABEL, min_size=2, max_size=4), PORT)
def test_a_name_of_the_internet_is_refused_unless_it_is_ours(labels: list[str], port: str) -> None:
    name = ".".join([*labels, "example"])
    assert refusal(RULES, host=name + port) == "HOST_UNKNOWN"
    assert refusal(SiteRules({name}, ()), host=name.upper() + port) == ""
    assert refusal(SiteRules({"*"}, ()), host=name + port) == ""


@given(LABEL, st.sampled_from("\u3002\uff0e\uff61% "), LABEL)
def test_what_may_be_read_as_a_dot_elsewhere_makes_no_local_name(label: str, dot: str, other: str) -> None:
    with pytest.raises(Problem, match="host"):
        RULES.check("GET", Headers(raw=[(b"host", f"{label}{dot}{other}".encode())]))


@given(st.ip_addresses(), LABEL, PORT)
def test_addresses_and_local_names_are_nobodys_on_the_internet(address: object, label: str, port: str) -> None:
    shown = f"[{address}]" if ":" in str(address) else str(address)
    for host in (shown, label, f"{label}.local", "vr.example", "localhost"):
        assert refusal(RULES, host=host + port) == ""


@pytest.mark.parametrize(
    ("headers", "code"),
    [
        ({"sec_fetch_site": "cross-site", "origin": "https://evil.example"}, "CROSS_SITE"),
        ({"sec_fetch_site": "same-site", "origin": "http://10.0.0.1:99"}, "CROSS_SITE"),
        ({"sec_fetch_site": "cross-site"}, "CROSS_SITE"),
        ({"origin": "null"}, "CROSS_SITE"),
        ({"origin": "http://10.0.0.1:99"}, "CROSS_SITE"),
        ({"origin": "https://vr.example.evil.example"}, "CROSS_SITE"),
        ({"sec_fetch_site": "same-origin", "origin": "http://10.0.0.1"}, ""),
        ({"sec_fetch_site": "none"}, ""),
        ({"origin": "http://10.0.0.1"}, ""),
        ({"sec_fetch_site": "cross-site", "origin": "https://app.example"}, ""),
        ({}, ""),
    ],
)
def test_only_own_pages_named_sites_and_programs_change_things(headers: dict[str, str], code: str) -> None:
    for method in ("POST", "PUT", "PATCH", "DELETE"):
        assert refusal(RULES, method, host="10.0.0.1", **headers) == code
    assert refusal(RULES, "GET", host="10.0.0.1", **headers) == ""


async def test_a_form_of_another_site_removes_nothing_and_stores_nothing(tmp_path: Path) -> None:
    store = memory()
    publish(bundle(), store, key="dress", job="job_1")
    elsewhere = {"Origin": "https://evil.example", "Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}
    async with gateway(tmp_path / "gw", store) as client:
        removed = await client.post("/v1/assets/dress/remove", headers=elsewhere)
        stored = await client.post("/v1/captures", headers=elsewhere, files={"files": ("a.xyz", b"0 0 0\n1 1 1\n")})
        rebound = await client.get("/v1/assets/dress", headers={"Host": "evil.example"})
        own = await client.post("/v1/assets/dress/remove", headers={"Sec-Fetch-Site": "same-origin"})
    assert [(each.status_code, each.json()["code"]) for each in (removed, stored, rebound)] == [
        (403, "CROSS_SITE"),
        (403, "CROSS_SITE"),
        (421, "HOST_UNKNOWN"),
    ]
    assert "evil.example/" not in rebound.text
    assert own.status_code == 200
    assert read_entry(store, "dress").removed
    assert not store.list("captures/", limit=1)


async def test_answers_stay_in_this_site_unless_any_may_read_them(tmp_path: Path) -> None:
    store = memory()
    publish(bundle(), store, key="dress", job="job_1")
    async with gateway(tmp_path / "gw", store) as client:
        page, jobs, asset, viewer = [
            await client.get(path) for path in ("/", "/v1/jobs", "/v1/assets/dress", "/view/dress")
        ]
    for answer, policy in ((page, "same-origin"), (jobs, "same-origin"), (asset, "cross-origin")):
        assert answer.headers["cross-origin-resource-policy"] == policy
        assert answer.headers["cross-origin-opener-policy"] == "same-origin"
        assert "microphone=()" in answer.headers["permissions-policy"]
        assert "strict-transport-security" not in answer.headers, "without TLS it means nothing"
    assert "camera=(self)" in page.headers["permissions-policy"], "the capture page photographs"
    for answer in (jobs, asset, viewer):
        assert "camera=()" in answer.headers["permissions-policy"]


async def test_behind_tls_browsers_stay_with_it(tmp_path: Path) -> None:
    settings = GatewaySettings(data_dir=tmp_path, workers=(), public_url="https://vr.example")
    async with answering(create_app(settings, MemoryStore())) as client:
        answer = await client.get("http://vr.example/livez")
        assert answer.headers["strict-transport-security"] == "max-age=31536000"
