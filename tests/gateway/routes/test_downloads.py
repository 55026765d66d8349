"""GET /v1/assets/{key}/downloads and /download: found, made once, waited for, and refused with a sentence."""

from __future__ import annotations

import asyncio
import io
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import httpx
import pytest
import trimesh

from capture2vr.edge.arrays import Tick
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.jobs.make_download import make_download
from capture2vr.gateway.dispatch import downloads as module
from capture2vr.storage.bundle import Bundle
from capture2vr.storage.catalogue.downloads import DownloadOrder, StoredDownload
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.local import LocalStore
from capture2vr.storage.store import Store
from capture2vr.storage.tenant_store import store_of_tenant
from tests.support.downloadable import SHEET, SLATE, downloadable
from tests.support.in_process_gateway import gateway, memory, until, worker
from tests.support.tenants import two_tenants
from tests.support.tilesets import hill_bundle
from tests.support.workers.scripted_work import Making


class Converting(Making):
    """Work that really converts, once it is let go."""

    def __init__(self, store: Store) -> None:
        super().__init__(store)
        self.store = store
        self.go = threading.Event()
        self.go.set()
        self.made: list[str] = []

    def make_download(self, tenant: str, order: DownloadOrder, scratch: Path, tick: Tick) -> StoredDownload:
        self.made.append(f"{tenant} {order.format.name}")
        while not self.go.wait(0.02):
            tick(0.0)
        if order.key == "huge":
            raise EdgeError("DOWNLOAD_TOO_LARGE", "it needs too much memory", hints=("take another format",))
        return make_download(store_of_tenant(self.store, tenant), order, scratch, tick)


@asynccontextmanager
async def converting(folder: Path, store: Store) -> AsyncIterator[tuple[httpx.AsyncClient, Converting]]:
    """A gateway of this store with a worker, and the worker's work."""
    work = Converting(store)
    async with worker(work, folder / "scratch") as port, gateway(folder / "gw", store, port) as client:
        yield client, work


async def test_the_formats_are_listed(tmp_path: Path) -> None:
    store = memory()
    publish(downloadable(), store, key="sheet", job="job_1")
    async with gateway(tmp_path, store) as client:
        answer = await client.get("/v1/assets/sheet/downloads")
        listed = answer.json()["downloads"]
        meshes, splats = ["glb", "glb-meshopt", "obj", "ply", "stl", "usdz"], ["splats-spz", "splats-glb"]
        assert [each["format"] for each in listed] == meshes + splats
        assert (listed[2]["file"], listed[2]["bytes"]) == ("sheet-obj.zip", None)
        assert listed[2]["url"] == "/v1/assets/sheet/download?format=obj"
        assert answer.headers["cache-control"] == "no-cache"
        publish(hill_bundle(levels=1)[0], store, key="hills")
        hills = (await client.get("/v1/assets/hills/downloads")).json()["downloads"]
        assert [each["file"] for each in hills if each["format"] == "3d-tiles"] == ["hills-3d-tiles.zip"]
        assert (await client.get("/v1/assets/nobody/downloads")).json()["code"] == "ASSET_UNKNOWN"


@pytest.mark.essential
@pytest.mark.slow
async def test_a_file_is_made_when_it_is_asked_for_and_served_as_all_files_are(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "store")
    publish(downloadable(), store, key="sheet", job="job_1")
    async with converting(tmp_path, store) as (client, work):
        url = "/v1/assets/sheet/download?format=stl"
        answer = await client.get(url)
        assert (answer.status_code, answer.headers["cache-control"]) == (307, "no-cache")
        file = answer.headers["location"]
        whole = await client.get(file)
        assert (whole.status_code, whole.headers["content-type"]) == (200, "model/stl")
        part = await client.get(file, headers={"Range": "bytes=80-83"})
        assert (part.status_code, part.content) == (206, whole.content[80:84])
        known = await client.get(file, headers={"If-None-Match": whole.headers["etag"]})
        assert known.status_code == 304
        head = await client.head(url)
        assert (head.status_code, head.headers["content-length"]) == (200, str(len(whole.content)))
        assert head.headers["etag"] == whole.headers["etag"]
        assert (await client.get(url)).headers["location"] == file
        assert work.made == ["default stl"], "it is made once"
        (stl,) = [
            each for each in (await client.get("/v1/assets/sheet/downloads")).json()["downloads"] if each["bytes"]
        ]
        assert (stl["format"], stl["bytes"]) == ("stl", len(whole.content))


@pytest.mark.slow
async def test_an_earlier_version_is_made_as_it_was(tmp_path: Path) -> None:
    store, one, two = LocalStore(tmp_path / "store"), downloadable(SLATE), downloadable()
    for number, each in enumerate((one, two), 1):
        publish(each, store, key="sheet", job=f"job_{number}")
    async with converting(tmp_path, store) as (client, work):
        now = (await client.get("/v1/assets/sheet/downloads")).json()
        earlier = (await client.get("/v1/assets/sheet/downloads?version=1")).json()
        assert (now["version"], earlier["version"]) == (2, 1)
        glb = earlier["downloads"][0]
        assert (glb["file"], glb["url"]) == ("sheet-v1.glb", "/v1/assets/sheet/download?format=glb&version=1")
        files = {}
        for name, url in (("now", now["downloads"][0]["url"]), ("earlier", glb["url"])):
            answer = await client.get(url, follow_redirects=True)
            files[name] = len(trimesh.load(io.BytesIO(answer.content), file_type="glb").to_mesh().faces)
        assert files == {"now": len(SHEET.faces), "earlier": len(SLATE.faces)}
        assert (await client.get(glb["url"])).headers["cache-control"] == "private, no-store"
        await client.get(f"{now['downloads'][0]['url']}&version=2")
        assert work.made == ["default glb", "default glb"], "each version is made once, however it is asked for"
        assert (await client.get("/v1/assets/sheet/downloads?version=1")).json()["downloads"][0]["bytes"]

        known = (await client.get("/v1/assets/sheet/versions/9")).json()
        for path in ("downloads?version=9", "download?format=glb&version=9"):
            problem = (await client.get(f"/v1/assets/sheet/{path}")).json()
            same = ("status", "code", "detail", "hints")
            assert [problem[each] for each in same] == [known[each] for each in same]
        await client.post("/v1/assets/sheet/remove")
        assert (await client.get(glb["url"])).json()["code"] == "ASSET_REMOVED"


async def test_earlier_versions_are_for_the_own_tenant(tmp_path: Path) -> None:
    store = memory()
    for number in (1, 2):
        bundle = replace(downloadable(), manifest={**downloadable().manifest, "label": f"{number}"})
        publish(bundle, store_of_tenant(store, "ada"), key="shown", job=f"job_{number}", visibility="public")
    async with two_tenants(tmp_path, store) as site:
        for path in ("downloads?tenant=ada", "download?format=glb&tenant=ada"):
            for reader in (site.anonymous, site.bob):
                for version in (1, 9):
                    problem = (await reader.get(f"/v1/assets/shown/{path}&version={version}")).json()
                    assert problem["code"] == "VERSION_UNKNOWN"
                    assert "2" not in problem["detail"].replace(str(version), ""), "not how many there are"
        assert (await site.bob.get("/v1/assets/shown/downloads?tenant=ada&version=2")).json()["version"] == 2
        assert (await site.ada.get("/v1/assets/shown/downloads?version=1")).json()["version"] == 1


@pytest.mark.slow
async def test_many_who_ask_at_once_get_one_file(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "store")
    publish(downloadable(), store, key="sheet", job="job_1")
    work = Converting(store)
    async with (
        worker(work, tmp_path / "scratch") as port,
        gateway(tmp_path / "one", store, port) as client,
        gateway(tmp_path / "two", store, port) as other,
    ):
        work.go.clear()
        asked = [each.get("/v1/assets/sheet/download?format=glb") for each in (client, other, client, other)]
        answers = asyncio.gather(*asked)
        await until(lambda: told(bool(work.made)))
        work.go.set()
        assert len({answer.headers["location"].partition("/v1/")[2] for answer in await answers}) == 1
        assert len(work.made) == 1


async def told(value: bool) -> bool:
    return value


@pytest.mark.slow
async def test_who_need_not_wait_asks_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WAIT_S", 0.05)
    store = memory()
    publish(downloadable(), store, key="sheet", job="job_1")
    async with converting(tmp_path, store) as (client, work):
        work.go.clear()
        answer = await client.get("/v1/assets/sheet/download?format=ply")
        assert (answer.status_code, answer.json()) == (202, {"format": "ply", "file": "sheet.ply"})
        assert answer.headers["retry-after"] == "2"
        assert (await client.head("/v1/assets/sheet/download?format=ply")).status_code == 202
        work.go.set()

        async def is_there() -> bool:
            return (await client.get("/v1/assets/sheet/download?format=ply")).status_code == 307

        await until(is_there)
        assert work.made == ["default ply"]


async def test_what_the_asset_cannot_have_is_said_with_what_it_can(tmp_path: Path) -> None:
    store, whole, possible = memory(), downloadable(), "glb, glb-meshopt, obj, usdz, splats-spz, splats-glb"
    small = Bundle("preview", {"lod0.glb": whole.files["lod0.glb"]}, whole.manifest)
    publish(small, store, key="sheet", job="job_1")
    async with gateway(tmp_path, store) as client:
        for wanted, status, code in (("stl", 404, "FORMAT_UNAVAILABLE"), ("exe", 422, "FORMAT_UNKNOWN")):
            answer = await client.get("/v1/assets/sheet/download", params={"format": wanted})
            problem = answer.json()
            assert (answer.status_code, problem["code"]) == (status, code)
            assert problem["detail"].endswith(possible)
            assert problem["hints"] == [f"ask for one of: {possible}"]
        assert (await client.get("/v1/assets/sheet/download")).json()["code"] == "REQUEST_INVALID"


async def test_what_cannot_be_made_is_said(tmp_path: Path) -> None:
    store = memory()
    publish(downloadable(), store, key="huge", job="job_1")
    async with gateway(tmp_path, store) as client:
        answer = await client.get("/v1/assets/huge/download?format=glb")
        assert (answer.status_code, answer.json()["code"]) == (503, "DOWNLOAD_NOT_NOW")
        assert answer.headers["retry-after"]
    async with converting(tmp_path / "with", store) as (client, _):
        answer = await client.get("/v1/assets/huge/download?format=glb")
        assert (answer.status_code, answer.json()["code"]) == (422, "DOWNLOAD_TOO_LARGE")


async def test_who_may_not_read_the_asset_gets_no_download(tmp_path: Path) -> None:
    store = memory()
    for key, visibility in (("sheet", None), ("shown", "public")):
        publish(downloadable(), store_of_tenant(store, "ada"), key=key, job="job_1", visibility=visibility)
    async with two_tenants(tmp_path, store) as site:
        for path in ("downloads", "download?format=glb"):
            url = f"/v1/assets/sheet/{path}"
            assert (await site.anonymous.get(url)).status_code == 401
            joined = f"{url}{'&' if '?' in url else '?'}tenant=ada"
            assert (await site.bob.get(joined)).json()["code"] == "ASSET_UNKNOWN"
        listed = (await site.anonymous.get("/v1/assets/shown/downloads?tenant=ada")).json()["downloads"]
        assert listed[0]["url"] == "/v1/assets/shown/download?format=glb&tenant=ada"
        await site.ada.post("/v1/assets/shown/remove")
        assert (await site.anonymous.get(listed[0]["url"])).json()["code"] == "ASSET_REMOVED"
