"""Visibility over HTTP: who reads an asset, its files and its collection, with a key, with another's, with none."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest

from capture2vr.gateway.access import authentication, readers
from capture2vr.gateway.access.caller import Scope
from capture2vr.storage.catalogue.change_entry import set_asset_visibility
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.catalogue.visibility import Visibility
from capture2vr.storage.local import LocalStore
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.tenant_store import store_of_tenant
from tests.gateway.routes.test_access import code_of
from tests.support.bundles import bundle
from tests.support.in_process_gateway import capture, ended, gateway, start, until, worker
from tests.support.tenants import TwoTenants, bearer, make_key, publish_for, two_tenants
from tests.support.workers.scripted_work import Making

PRIVATE, UNLISTED, PUBLIC = Visibility
ASSET, LIST = "/v1/assets/dress", "/v1/collections/default"
OF_ADA = {"tenant": "ada"}


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[TwoTenants]:
    """Ada has a dress in her default collection."""
    store = LocalStore(tmp_path / "store")
    publish_for(store, "ada", "dress")
    async with two_tenants(tmp_path, store) as site:
        yield site


async def make(site: TwoTenants, path: str, visibility: Visibility | None) -> httpx.Response:
    answer = await site.ada.put(f"{path}/visibility", json={"visibility": visibility})
    assert answer.status_code == 200, answer.text
    return answer


async def addresses(site: TwoTenants, *paths: str) -> list[str]:
    """The asset's own addresses, those of its files, and those of the list with its shard."""
    entry = (await site.ada.get(ASSET)).json()
    place = (await site.ada.get(f"{LIST}/assets/dress")).json()
    files = [file["url"] for file in entry["files"]]
    return [*files, entry["manifest"]["url"]] if "files" in paths else [place["shard"]]


async def statuses(client: httpx.AsyncClient, *paths: str) -> set[int]:
    return {(await client.get(path, params=OF_ADA if path.startswith("/") else None)).status_code for path in paths}


OWN = (ASSET, f"{ASSET}/lod/0", f"{ASSET}/qr.svg")
LISTS = (LIST, f"{LIST}/assets", f"{LIST}/assets/dress")


async def test_without_a_visibility_only_its_tenant_reads_a_thing(site: TwoTenants) -> None:
    paths = [*OWN, *LISTS, *(await addresses(site, "files")), *(await addresses(site))]
    assert await statuses(site.anonymous, *paths) == {401}
    assert await statuses(site.bob, *paths) == {404}
    assert await statuses(site.ada, *paths) <= {200, 307}
    for path in (paths[0], paths[-3], LIST):
        answer = await site.ada.get(path)
        assert "access-control-allow-origin" not in answer.headers
        assert answer.headers["cache-control"] == "private, no-cache"
        assert answer.headers["cross-origin-resource-policy"] == "same-origin"


@pytest.mark.parametrize("visibility", [UNLISTED, PUBLIC])
async def test_what_is_open_is_read_by_its_address_and_is_in_no_list(site: TwoTenants, visibility: Visibility) -> None:
    view = (await make(site, ASSET, visibility)).json()
    assert view == {"visibility": visibility, "effective": visibility, "view": "/view/dress?tenant=ada"}
    files = await addresses(site, "files")
    for client in (site.anonymous, site.bob):
        assert await statuses(client, *OWN, *files) <= {200, 307}
        assert await statuses(client, *LISTS, *(await addresses(site))) == (
            {401} if client is site.anonymous else {404}
        )
        answer = await client.get(ASSET, params=OF_ADA)
        cors = answer.headers.get("access-control-allow-origin", "")
        assert cors == ("*" if visibility is PUBLIC else "")
        entry = answer.json()
        assert (entry["collections"], entry["effective_visibility"]) == ([], visibility)
        assert "versions" not in entry, "jobs are nobody's business"
    file = await site.anonymous.get(files[0])
    assert file.headers["cache-control"] == "public, max-age=31536000, immutable"
    assert (await site.bob.get("/v1/assets")).json()["assets"] == []
    await make(site, ASSET, PRIVATE)
    assert await statuses(site.anonymous, *OWN, *files) == {401}, "at once, at the gateway that was asked"
    assert await statuses(site.bob, *OWN, *files) == {404}


async def test_a_public_collection_shows_its_assets_but_those_that_are_not(site: TwoTenants, tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "store")
    publish_for(store, "ada", "letter", visibility=PRIVATE)
    publish_for(store, "ada", "draft", visibility=UNLISTED)
    await make(site, LIST, PUBLIC)
    rows = (await site.anonymous.get(f"{LIST}/assets", params=OF_ADA)).json()["assets"]
    assert [row["key"] for row in rows] == ["dress"]
    assert rows[0]["view"] == "/view/dress?tenant=ada"
    assert (await site.anonymous.get(rows[0]["manifest"])).status_code == 200
    assert (await site.anonymous.get(rows[0]["self"])).json()["collections"] == ["default"]
    for client, status in ((site.anonymous, 401), (site.bob, 404)):
        answers = [await client.get(f"/v1/assets/{key}", params=OF_ADA) for key in ("letter", "draft", "nothing")]
        assert [answer.status_code for answer in answers] == [status, 200, status]
    assert [row["key"] for row in (await site.ada.get("/v1/assets")).json()["assets"]] == ["draft", "dress", "letter"]
    await make(site, LIST, None)
    assert await statuses(site.anonymous, *LISTS, rows[0]["manifest"]) == {401}


async def test_a_refused_key_reads_what_everybody_may(site: TwoTenants) -> None:
    unknown = bearer("c2v_ada_" + "x" * 43)
    assert await code_of(await site.anonymous.get(ASSET, params=OF_ADA, headers=unknown)) == (401, "KEY_UNKNOWN")
    await make(site, ASSET, PUBLIC)
    assert (await site.anonymous.get(ASSET, params=OF_ADA, headers=unknown)).status_code == 200
    altered = {"Cookie": "c2v_session=altered"}
    assert (await site.anonymous.get(ASSET, params=OF_ADA, headers=altered)).status_code == 200


async def test_a_key_that_may_not_read_is_told_so_of_its_own_tenant(site: TwoTenants, tmp_path: Path) -> None:
    secret = make_key(tmp_path / "gw", "ada", {Scope.CAPTURE})
    answer = await site.anonymous.get(ASSET, headers=bearer(secret))
    assert await code_of(answer) == (403, "SCOPE_MISSING")
    answer = await site.anonymous.put(f"{ASSET}/visibility", json={"visibility": "public"}, headers=bearer(secret))
    assert await code_of(answer) == (403, "SCOPE_MISSING")


async def test_what_another_gateway_or_a_worker_changes_holds_here_soon(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert authentication.CACHE_S <= 30, "with as much at the CDN it is a minute at most"
    monkeypatch.setattr(readers, "CACHE_S", 0.1)
    store = MemoryStore()
    publish_for(store, "ada", "dress", visibility=PUBLIC)
    make_key(tmp_path / "gw", "ada", {Scope.READ})
    async with gateway(tmp_path / "gw", store) as client:
        assert (await client.get(ASSET, params=OF_ADA)).status_code == 200
        set_asset_visibility(store_of_tenant(store, "ada"), "dress", PRIVATE)

        async def is_refused() -> bool:
            return (await client.get(ASSET, params=OF_ADA)).status_code == 401

        await until(is_refused)


async def test_an_open_gateway_shows_all_to_everybody_as_before(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "store")
    publish(bundle(), store, key="dress")
    async with gateway(tmp_path / "gw", store) as client:
        for path in (ASSET, LIST, (await client.get(ASSET)).json()["manifest"]["url"]):
            answer = await client.get(path)
            assert (answer.status_code, answer.headers["access-control-allow-origin"]) == (200, "*")
            assert "private" not in answer.headers["cache-control"]
        secret = make_key(tmp_path / "gw", "default")
        for path in (ASSET, LIST):
            client_with_key = await client.get(path, headers=bearer(secret))
            assert "access-control-allow-origin" not in client_with_key.headers


async def test_an_open_gateway_opens_no_other_tenants_things(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "store")
    publish_for(store, "ada", "dress")
    make_key(tmp_path / "gw", "ada")
    async with gateway(tmp_path / "gw", store, open=True) as client:
        for path, code in ((ASSET, "ASSET_UNKNOWN"), (LIST, "COLLECTION_UNKNOWN")):
            assert await code_of(await client.get(path, params=OF_ADA)) == (404, code)


@pytest.mark.parametrize(
    ("path", "body", "code"),
    [
        (ASSET, {"visibility": "friends"}, (422, "REQUEST_INVALID")),
        (ASSET, {}, (422, "REQUEST_INVALID")),
        ("/v1/assets/.x", {"visibility": "public"}, (422, "KEY_INVALID")),
        ("/v1/assets/nothing", {"visibility": "public"}, (404, "ASSET_UNKNOWN")),
        ("/v1/collections/.x", {"visibility": "public"}, (422, "COLLECTION_INVALID")),
        ("/v1/collections/nothing", {"visibility": "public"}, (404, "COLLECTION_UNKNOWN")),
    ],
)
async def test_bad_requests_are_told_why(
    site: TwoTenants, path: str, body: dict[str, str], code: tuple[int, str]
) -> None:
    assert await code_of(await site.ada.put(f"{path}/visibility", json=body)) == code
    answer = await site.ada.get(ASSET, params={"tenant": "No/Tenant"})
    assert await code_of(answer) == (422, "REQUEST_INVALID")


async def test_a_job_sets_the_visibility_of_its_asset(tmp_path: Path) -> None:
    store = MemoryStore()
    async with worker(Making(store), tmp_path / "scratch") as port, gateway(tmp_path / "gw", store, port) as client:
        job = await start(client, capture(store), visibility="unlisted")
        assert (await ended(client, job))["state"] == "SUCCEEDED"
        assert (await client.get(ASSET)).json()["visibility"] == "unlisted"
        answer = await client.post("/v1/jobs", json={"capture": "cap_1", "asset_key": "a", "visibility": "friends"})
        assert await code_of(answer) == (422, "REQUEST_INVALID")
