"""Share links over HTTP: what they open and to whom, passwords, expiry, revocation, counting."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from capture2vr.gateway.access import guesses, shares, sharing
from capture2vr.gateway.access.caller import Scope
from capture2vr.storage.catalogue.visibility import Visibility
from capture2vr.storage.local import LocalStore
from tests.gateway.routes.test_access import code_of
from tests.support.in_process_gateway import gateway, until
from tests.support.tenants import TwoTenants, bearer, make_key, publish_for, two_tenants

OF_ADA = {"tenant": "ada"}
ASSET, OTHER, LIST = "/v1/assets/dress", "/v1/assets/letter", "/v1/collections/default"


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[TwoTenants]:
    """Ada has a dress and a private letter in her default collection, and a cup elsewhere."""
    store = LocalStore(tmp_path / "store")
    publish_for(store, "ada", "dress")
    publish_for(store, "ada", "letter", visibility=Visibility.PRIVATE)
    publish_for(store, "ada", "cup", collection="shelf")
    async with two_tenants(tmp_path, store) as site:
        yield site


async def share(site: TwoTenants, **body: Any) -> dict[str, Any]:
    answer = await site.ada.post("/v1/shares", json={"asset": "dress", **body})
    assert answer.status_code == 201, answer.text
    return dict(answer.json())


def token_of(made: dict[str, Any]) -> str:
    return str(made["url"]).rpartition("/")[2]


async def open_link(client: httpx.AsyncClient, made: dict[str, Any], password: str = "") -> httpx.Response:
    return await client.post("/v1/shares/open", json={"token": token_of(made), "password": password})


async def status(client: httpx.AsyncClient, path: str, **headers: str) -> int:
    return (await client.get(path, params=OF_ADA if path.startswith("/") else None, headers=headers)).status_code


@pytest.mark.slow
async def test_a_link_opens_one_thing_to_somebody_without_a_key(site: TwoTenants) -> None:
    made = await share(site, label="for Bob")
    assert made["url"] == f"{site.url}/s/{token_of(made)}"
    assert (await site.anonymous.get(f"/s/{token_of(made)}")).status_code == 200
    for client, before in ((site.anonymous, 401), (site.bob, 404)):
        assert await status(client, ASSET) == before
        opened = (await open_link(client, made)).json()
        assert opened == {
            "tenant": "ada",
            "kind": "asset",
            "name": "dress",
            "mode": "read",
            "label": "for Bob",
            "view": "/view/dress?tenant=ada",
        }
        entry = (await client.get(ASSET, params=OF_ADA)).json()
        assert (entry["collections"], entry["may_place"]) == ([], False)
        assert await status(client, entry["files"][0]["url"]) == 200
        assert await status(client, f"{ASSET}/qr.svg") == 200
        answer = await client.get(ASSET, params=OF_ADA)
        assert answer.headers["cache-control"] == "private, no-cache"
        assert "access-control-allow-origin" not in answer.headers
        for path in (OTHER, LIST, f"{LIST}/assets", "/v1/assets/cup"):
            assert await status(client, path) == before, "nothing else"
        assert (await client.put(f"{ASSET}/visibility", json={"visibility": "public"})).status_code in (401, 404)
    (found,) = (await site.ada.get("/v1/shares", params={"asset": "dress"})).json()["shares"]
    assert (found["opened"], found["url"], found["has_password"]) == (2, made["url"], False)
    assert (await site.ada.get("/v1/shares", params={"asset": "cup"})).json()["shares"] == []
    assert (await site.ada.get(f"/v1/shares/{made['id']}/qr.svg")).headers["content-type"] == "image/svg+xml"


async def test_a_collections_link_opens_its_list_and_all_in_it(site: TwoTenants) -> None:
    made = await share(site, asset="", collection="default", mode="place")
    assert (await open_link(site.anonymous, made)).json()["view"] == "/browse/default?tenant=ada"
    rows = (await site.anonymous.get(f"{LIST}/assets", params=OF_ADA)).json()["assets"]
    assert [row["key"] for row in rows] == ["dress", "letter"]
    for path in (ASSET, OTHER, rows[0]["manifest"], LIST):
        assert await status(site.anonymous, path) == 200
    entry = (await site.anonymous.get(OTHER, params=OF_ADA)).json()
    assert (entry["collections"], entry["may_place"]) == (["default"], True)
    assert await status(site.anonymous, "/v1/assets/cup") == 401
    await site.ada.put(f"{LIST}/visibility", json={"visibility": "public"})
    assert (await status(site.anonymous, ASSET), await status(site.anonymous, OTHER)) == (200, 401)


async def test_a_revoked_link_opens_nothing_at_once(site: TwoTenants) -> None:
    made = await share(site)
    await open_link(site.anonymous, made)
    file = (await site.anonymous.get(ASSET, params=OF_ADA)).json()["files"][0]["url"]
    ended = (await site.ada.delete(f"/v1/shares/{made['id']}")).json()
    assert ended["ended"] == "revoked"
    for path in (ASSET, file, f"{ASSET}/lod/0"):
        answer = await site.anonymous.get(path, params=OF_ADA if path.startswith("/") else None)
        assert await code_of(answer) == (410, "SHARE_REVOKED")
    assert await code_of(await open_link(site.anonymous, made)) == (410, "SHARE_REVOKED")
    page = await site.anonymous.get(f"/s/{token_of(made)}", headers={"Accept": "text/html"})
    assert (page.status_code, page.headers["content-type"]) == (410, "text/html; charset=utf-8")
    assert await code_of(await site.anonymous.get(f"/s/{token_of(made)}")) == (410, "SHARE_REVOKED")
    again = (await site.ada.delete(f"/v1/shares/{made['id']}")).json()
    assert again["revoked"] == ended["revoked"]
    second = await share(site)
    await open_link(site.anonymous, second)
    assert await status(site.anonymous, ASSET) == 200, "another link of the same thing"


async def test_what_is_deleted_is_shared_no_longer_whatever_comes_under_its_name(
    site: TwoTenants, tmp_path: Path
) -> None:
    made = await share(site)
    assert (await site.ada.delete("/v1/assets/dress")).status_code == 200
    publish_for(LocalStore(tmp_path / "store"), "ada", "dress")
    assert await code_of(await open_link(site.anonymous, made)) == (410, "SHARE_REVOKED")


async def test_a_link_expires(site: TwoTenants, monkeypatch: pytest.MonkeyPatch) -> None:
    made = await share(site, expires_days=1)
    assert (await open_link(site.anonymous, made)).status_code == 200
    later = time.time() + 86_401
    monkeypatch.setattr(sharing.time, "time", lambda: later)
    assert await code_of(await open_link(site.bob, made)) == (410, "SHARE_EXPIRED")
    monkeypatch.undo()
    assert (await share(site, expires_days=None))["expires"] is None


async def test_a_password_is_asked_for_and_is_stored_as_a_hash(site: TwoTenants, tmp_path: Path) -> None:
    made = await share(site, password="open sesame")
    assert made["has_password"]
    assert await code_of(await open_link(site.anonymous, made)) == (401, "SHARE_PASSWORD_MISSING")
    assert await code_of(await open_link(site.anonymous, made, "sesame")) == (401, "SHARE_PASSWORD_WRONG")
    assert await status(site.anonymous, ASSET) == 401
    header = {"Authorization": f"Share {token_of(made)}"}
    answer = await site.anonymous.get(ASSET, params=OF_ADA, headers=header)
    assert await code_of(answer) == (401, "SHARE_PASSWORD_MISSING")
    assert (await open_link(site.anonymous, made, "open sesame")).status_code == 200
    assert await status(site.anonymous, ASSET) == 200
    assert b"sesame" not in (tmp_path / "gw" / "gateway.db").read_bytes()


@pytest.mark.usefixtures("still_limits")
async def test_passwords_cannot_be_guessed_at_will(site: TwoTenants, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guesses, "_OF_NETWORK", guesses.RateLimitItemPerMinute(2))
    made = await share(site, password="open sesame")
    for password in ("a", "b"):
        assert await code_of(await open_link(site.anonymous, made, password)) == (401, "SHARE_PASSWORD_WRONG")
    answer = await open_link(site.anonymous, made, "open sesame")
    assert await code_of(answer) == (429, "PASSWORD_GUESSES_LIMITED")


@pytest.mark.slow
@pytest.mark.usefixtures("still_limits")
async def test_who_guesses_one_password_keeps_nobody_from_the_others(
    site: TwoTenants, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guesses, "_OF_NETWORK", guesses.RateLimitItemPerMinute(99))
    monkeypatch.setattr(guesses, "_OF_SHARE", guesses.RateLimitItemPerMinute(2))
    tried, other = await share(site, password="open sesame"), await share(site, password="open barley")
    for password in ("a", "b"):
        await open_link(site.anonymous, tried, password)
    assert await code_of(await open_link(site.anonymous, tried, "c")) == (429, "PASSWORD_GUESSES_LIMITED")
    assert (await open_link(site.anonymous, other, "open barley")).status_code == 200


async def test_a_program_shows_the_token_in_a_header(site: TwoTenants) -> None:
    made = await share(site)
    good = {"Authorization": f"Share {token_of(made)}"}
    assert await status(site.anonymous, ASSET, **good) == 200
    assert await status(site.anonymous, OTHER, **good) == 401
    assert await code_of(await site.anonymous.get("/v1/jobs", headers=good)) == (401, "KEY_MALFORMED")
    await site.ada.delete(f"/v1/shares/{made['id']}")
    answer = await site.anonymous.get(ASSET, params=OF_ADA, headers=good)
    assert await code_of(answer) == (401, "SHARE_REVOKED")


@pytest.mark.parametrize("change", ["signature", "id", "cut", "nonsense"])
async def test_an_altered_token_or_cookie_opens_nothing(site: TwoTenants, change: str) -> None:
    made = await share(site)
    token = token_of(made)
    told, _, signature = token.rpartition(".")
    other = (await share(site))["id"]
    bad = {
        # Its first letter: two bits of the last one are no part of the signature.
        "signature": f"{told}.{'A' if signature[0] != 'A' else 'B'}{signature[1:]}",
        "id": token.replace(made["id"], other),
        "cut": token[:-3],
        "nonsense": "\N{SNOWMAN}",
    }[change]
    assert await code_of(await site.anonymous.post("/v1/shares/open", json={"token": bad})) == (404, "SHARE_UNKNOWN")
    assert (await site.anonymous.get(f"/s/{bad}")).status_code == 404
    cookie = {"Cookie": f"c2v_share_{made['id']}={bad if bad.isascii() else 'x'}"}
    assert await code_of(await site.anonymous.get(ASSET, params=OF_ADA, headers=cookie)) == (401, "KEY_MISSING")


async def test_another_gateway_follows_within_seconds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sharing, "CACHE_S", 0.1)
    store = LocalStore(tmp_path / "store")
    publish_for(store, "ada", "dress")
    secret = make_key(tmp_path / "gw", "ada", {Scope.MANAGE})
    database = f"sqlite:///{tmp_path / 'gw' / 'gateway.db'}"
    async with (
        gateway(tmp_path / "gw", store) as one,
        gateway(tmp_path / "two", store, database_url=database) as two,
    ):
        made = (await one.post("/v1/shares", json={"asset": "dress"}, headers=bearer(secret))).json()
        await open_link(two, made)
        assert await status(two, ASSET) == 200
        await one.delete(f"/v1/shares/{made['id']}", headers=bearer(secret))

        async def is_refused() -> bool:
            return await status(two, ASSET) == 410

        await until(is_refused)


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ({"asset": "nothing"}, (404, "ASSET_UNKNOWN")),
        ({"asset": "../x"}, (404, "ASSET_UNKNOWN")),
        ({"asset": "", "collection": "nothing"}, (404, "COLLECTION_UNKNOWN")),
        ({"collection": "default"}, (422, "REQUEST_INVALID")),
        ({"asset": ""}, (422, "REQUEST_INVALID")),
        ({"mode": "write"}, (422, "REQUEST_INVALID")),
        ({"expires_days": 0}, (422, "REQUEST_INVALID")),
        ({"label": "a\x00b"}, (422, "REQUEST_INVALID")),
    ],
)
async def test_bad_requests_are_told_why(site: TwoTenants, body: dict[str, Any], code: tuple[int, str]) -> None:
    assert await code_of(await site.ada.post("/v1/shares", json={"asset": "dress", **body})) == code


async def test_shares_are_listed_in_pages(site: TwoTenants) -> None:
    made = [(await share(site))["id"] for _ in range(3)]
    first = (await site.ada.get("/v1/shares", params={"limit": 2})).json()
    second = (await site.ada.get("/v1/shares", params={"limit": 2, "after": first["next"]})).json()
    assert [each["id"] for each in (*first["shares"], *second["shares"])] == sorted(made)
    assert second["next"] is None


def test_a_password_is_told_from_others() -> None:
    stored = shares._hashed("a")
    assert stored != shares._hashed("a"), "each has a salt of its own"
