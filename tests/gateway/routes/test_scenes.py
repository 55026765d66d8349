"""Scenes over HTTP: saved by one device and read by another, versions in ETags, limits, and share links of a scene."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from capture2vr.gateway.access.caller import Scope
from capture2vr.storage.local import LocalStore
from capture2vr.storage.scenes.scene_documents import scene_name
from capture2vr.storage.tenant_store import store_of_tenant
from tests.gateway.routes.test_access import code_of
from tests.support.in_process_gateway import gateway, memory
from tests.support.tenants import TwoTenants, bearer, make_key, publish_for, two_tenants

DRESS = {"id": "a", "asset": "dress", "position_m": [0, 0, -1.5], "rotation": [0, 0.6, 0, 0.8], "scale": 2}
GONE = {"id": "b", "asset": "gone", "position_m": [1, 0, 0]}


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[TwoTenants]:
    """Ada has a dress and a letter."""
    store = LocalStore(tmp_path / "store")
    for key in ("dress", "letter"):
        publish_for(store, "ada", key)
    async with two_tenants(tmp_path, store) as site:
        yield site


async def save(client: httpx.AsyncClient, *items: dict[str, Any], name: str = "Living room") -> dict[str, Any]:
    answer = await client.post("/v1/scenes", json={"name": name, "items": items})
    assert answer.status_code == 201, answer.text
    made = dict(answer.json())
    assert answer.headers["location"] == f"/v1/scenes/{made['id']}"
    assert answer.headers["etag"] == '"1"'
    return made


async def replace(client: httpx.AsyncClient, scene: str, version: int, *items: dict[str, Any]) -> httpx.Response:
    body = {"name": "Room", "items": items}
    return await client.put(f"/v1/scenes/{scene}", json=body, headers={"If-Match": f'"{version}"'})


async def test_a_scene_is_saved_read_listed_replaced_and_deleted(site: TwoTenants) -> None:
    made = await save(site.ada, DRESS, GONE)
    path = f"/v1/scenes/{made['id']}"
    answer = await site.ada.get(path)
    assert answer.json() == made
    assert (made["version"], made["view"]) == (1, f"/scene/{made['id']}?tenant=ada")
    assert (made["may_place"], made["may_save"]) == (True, True)
    assert made["items"][0] == DRESS
    assert made["items"][1] == {**GONE, "rotation": [0, 0, 0, 1], "scale": 1}
    assert (await site.ada.get(path, headers={"If-None-Match": '"1"'})).status_code == 304
    changed = await replace(site.ada, made["id"], 1, GONE)
    assert (changed.status_code, changed.headers["etag"], changed.json()["version"]) == (200, '"2"', 2)
    other = await save(site.ada, name="Wardrobe")
    page = (await site.ada.get("/v1/scenes", params={"limit": 1})).json()
    following = (await site.ada.get("/v1/scenes", params={"after": page["next"]})).json()
    listed = {each["id"]: (each["name"], each["things"], each["version"]) for each in page["scenes"]}
    listed |= {each["id"]: (each["name"], each["things"], each["version"]) for each in following["scenes"]}
    assert listed == {made["id"]: ("Room", 1, 2), other["id"]: ("Wardrobe", 0, 1)}
    assert (len(page["scenes"]), following["next"]) == (1, None)
    assert (await site.ada.delete(path)).status_code == 204
    for method in ("GET", "DELETE"):
        assert await code_of(await site.ada.request(method, path)) == (404, "SCENE_UNKNOWN")
    assert await code_of(await replace(site.ada, made["id"], 2)) == (404, "SCENE_UNKNOWN")


async def test_who_saves_what_somebody_else_has_changed_is_told_and_overwrites_nothing(site: TwoTenants) -> None:
    made = await save(site.ada, DRESS)
    assert (await replace(site.ada, made["id"], 1, DRESS, GONE)).status_code == 200
    late = await replace(site.ada, made["id"], 1)
    assert await code_of(late) == (412, "SCENE_CHANGED")
    assert late.headers["etag"] == '"2"'
    assert "version 2" in late.json()["detail"]
    assert len((await site.ada.get(f"/v1/scenes/{made['id']}")).json()["items"]) == 2
    for header in ({}, {"If-Match": "*"}, {"If-Match": '"0"'}, {"If-Match": 'W/"1"'}):
        answer = await site.ada.put(f"/v1/scenes/{made['id']}", json={"name": "x"}, headers=header)
        assert await code_of(answer) == (428, "SCENE_VERSION_MISSING")


async def test_only_who_manages_saves_and_only_who_reads_reads(site: TwoTenants, tmp_path: Path) -> None:
    made = await save(site.ada, DRESS)
    path = f"/v1/scenes/{made['id']}"
    reader = bearer(make_key(tmp_path / "gw", "ada", {Scope.READ}))
    found = (await site.anonymous.get(path, headers=reader)).json()
    assert (found["may_place"], found["may_save"]) == (True, False)
    for method, where in (("POST", "/v1/scenes"), ("PUT", path), ("DELETE", path)):
        body = None if method == "DELETE" else {"name": "x"}
        answer = await site.anonymous.request(method, where, json=body, headers=reader)
        assert await code_of(answer) == (403, "SCOPE_MISSING"), method
        assert (await site.anonymous.request(method, where, json=body)).status_code == 401
    capturing = bearer(make_key(tmp_path / "gw", "ada", {Scope.CAPTURE}))
    assert (await site.anonymous.get(path, headers=capturing)).status_code == 403


async def test_a_scenes_link_opens_the_scene_and_its_assets_alone(site: TwoTenants) -> None:
    made = await save(site.ada, DRESS)
    scene, of_ada = f"/v1/scenes/{made['id']}", {"tenant": "ada"}
    share = (await site.ada.post("/v1/shares", json={"scene": made["id"]})).json()
    token = share["url"].rpartition("/")[2]
    assert (await site.anonymous.get("/v1/assets/dress", params=of_ada)).status_code == 401
    opened = (await site.anonymous.post("/v1/shares/open", json={"token": token})).json()
    assert (opened["kind"], opened["view"]) == ("scene", f"/scene/{made['id']}?tenant=ada")
    found = (await site.anonymous.get(scene, params=of_ada)).json()
    assert (found["may_place"], found["may_save"], len(found["items"])) == (False, False, 1)
    entry = (await site.anonymous.get("/v1/assets/dress", params=of_ada)).json()
    assert entry["may_place"] is False
    assert (await site.anonymous.get(entry["files"][0]["url"])).status_code == 200
    for path in ("/v1/assets/letter", "/v1/collections/default"):
        assert (await site.anonymous.get(path, params=of_ada)).status_code == 401, "nothing else"
    assert (await site.anonymous.get("/v1/scenes")).status_code == 401
    letter = {"id": "b", "asset": "letter", "position_m": [1, 0, 0]}
    await replace(site.ada, made["id"], 1, letter)
    assert (await site.anonymous.get("/v1/assets/letter", params=of_ada)).status_code == 200, "what stands in it now"
    assert (await site.anonymous.get("/v1/assets/dress", params=of_ada)).status_code == 401
    of_scene = {"scene": made["id"]}
    assert [each["id"] for each in (await site.ada.get("/v1/shares", params=of_scene)).json()["shares"]] == [
        share["id"]
    ]
    await site.ada.delete(scene)
    (ended,) = (await site.ada.get("/v1/shares", params=of_scene)).json()["shares"]
    assert ended["ended"] == "revoked"
    assert (await site.anonymous.get("/v1/assets/letter", params=of_ada)).status_code == 401


NO_SCENES: list[dict[str, str]] = [{}, {"scene": "scn_" + "0" * 24}, {"scene": "../x"}, {"scene": "x", "asset": "y"}]


@pytest.mark.parametrize("body", NO_SCENES)
async def test_a_scene_that_there_is_not_is_not_shared(site: TwoTenants, body: dict[str, str]) -> None:
    assert (await site.ada.post("/v1/shares", json=body)).status_code in (404, 422)


async def test_a_damaged_document_is_a_fault_that_says_so(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "store")
    async with two_tenants(tmp_path, store) as site:
        made = await save(site.ada, DRESS)
        store_of_tenant(store, "ada").put(scene_name(made["id"]), b"[]", content_type="application/json")
        assert await code_of(await site.ada.get(f"/v1/scenes/{made['id']}")) == (503, "SCENE_DAMAGED")
        assert await code_of(await replace(site.ada, made["id"], 1)) == (503, "SCENE_DAMAGED")
        assert (await site.ada.delete(f"/v1/scenes/{made['id']}")).status_code == 204


async def test_a_scenes_page_is_served_to_anybody_and_no_other_is(tmp_path: Path) -> None:
    async with gateway(tmp_path / "gw", memory()) as client:
        page = await client.get("/scene/scn_" + "0" * 24)
        assert (page.status_code, page.headers["content-type"]) == (200, "text/html; charset=utf-8")
        assert await code_of(await client.get("/scene/x")) == (404, "SCENE_INVALID")
