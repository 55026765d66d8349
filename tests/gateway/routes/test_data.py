"""Data in people's hands: deleted for good with a receipt, exported, kept only so long, and an audit log of it all."""

from __future__ import annotations

import asyncio
import io
import json
import time
import zipfile
from pathlib import Path
from typing import Any

import httpx
import pytest
import sqlalchemy as sa

from capture2vr.gateway.access.store import AccessStore
from capture2vr.gateway.database.database import open_engine
from capture2vr.gateway.records.audit_log import AuditStore
from capture2vr.gateway.records.tenant_data import DAY_S, TenantData
from capture2vr.gateway.search import indexes
from capture2vr.storage.catalogue.verify import verify
from capture2vr.storage.local import LocalStore
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import Store, list_all
from capture2vr.storage.tenant_store import store_of_tenant
from tests.support.in_process_gateway import ended, gateway, memory, start, until
from tests.support.network.receivers import receiver
from tests.support.tenants import make_key, publish_for, two_tenants

_HEAD = b"ply\nformat ascii 1.0\nelement vertex 1\n" + b"".join(b"property float %c\n" % axis for axis in b"xyz")
CLOUD = _HEAD + b"end_header\n1 2 3\n"


async def upload(client: httpx.AsyncClient) -> str:
    answer = await client.post("/v1/captures", files={"files": ("a.ply", CLOUD)})
    assert answer.status_code == 201, answer.text
    return str(answer.json()["capture"])


def code(answer: httpx.Response) -> tuple[int, str]:
    return answer.status_code, answer.json()["code"]


def names(store: Store) -> list[str]:
    return [head.name for head in list_all(store, "")]


async def test_a_deleted_asset_is_gone_and_its_receipt_says_what_went(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "store")
    async with receiver() as got, two_tenants(tmp_path, store, webhook_private=True) as site:
        for tenant in ("ada", "bob"):
            publish_for(store, tenant, "dress")
            publish_for(store, tenant, "shoe")
        await site.ada.post("/v1/webhooks", json={"url": got.url, "events": ["asset.deleted"]})
        entry = (await site.ada.get("/v1/assets/dress")).json()
        receipt = (await site.ada.delete("/v1/assets/dress")).json()
        assert receipt["what"] == "asset dress"
        for file in entry["files"]:
            assert file["name"] in receipt["objects"]
            assert any(url.endswith(file["name"]) for url in receipt["purge"]), "a CDN must forget it"
            assert (await site.ada.get(file["url"])).status_code == 404
        assert receipt["bytes"] >= sum(file["bytes"] for file in entry["files"])
        assert code(await site.ada.get("/v1/assets/dress")) == (404, "ASSET_UNKNOWN")
        assert code(await site.ada.post("/v1/assets/dress/restore")) == (404, "ASSET_UNKNOWN")
        assert [row["key"] for row in (await site.ada.get("/v1/assets")).json()["assets"]] == ["shoe"]
        assert not [name for name in names(store_of_tenant(store, "ada")) if "dress" in name]
        assert (await site.bob.get("/v1/assets/dress")).status_code == 200
        assert code(await site.ada.delete("/v1/assets/dress")) == (404, "ASSET_UNKNOWN")
        assert (await site.ada.get("/v1/deletions")).json()["deletions"] == [receipt]
        assert (await site.bob.get("/v1/deletions")).json()["deletions"] == []
        assert (await site.operator.get("/v1/deletions", params={"tenant": "*"})).json()["deletions"] == [receipt]
        await got.wait(1)
        assert got.documents[0]["data"] == {"deletion": receipt["id"], "key": "dress"}


async def test_an_asset_is_not_deleted_while_a_job_may_publish_it(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        publish_for(store, "default", "dress")
        job = await start(client, await upload(client))
        before = {name: store.get(name) for name in names(store)}
        refused = await client.delete("/v1/assets/dress")
        assert code(refused) == (409, "ASSET_IN_USE")
        assert job in refused.json()["detail"]
        assert code(await client.post("/v1/deletions", json={"tenant": "default"})) == (409, "DATA_IN_USE")
        assert {name: store.get(name) for name in names(store)} == before, "nothing half done"
        await client.post(f"/v1/jobs/{job}/cancel")
        await ended(client, job)
        assert (await client.delete("/v1/assets/dress")).status_code == 200


async def test_everything_of_one_tenant_goes_and_the_other_feels_nothing(tmp_path: Path) -> None:
    store = memory()
    async with two_tenants(tmp_path, store) as site:
        for tenant, client in (("ada", site.ada), ("bob", site.bob)):
            publish_for(store, tenant, "dress")
            job = await start(client, await upload(client), "new")
            await client.post(f"/v1/jobs/{job}/cancel")
            await ended(client, job)
        bobs = {name: store.get(name) for name in names(store) if name.startswith("tenants/bob/")}
        assert code(await site.ada.post("/v1/deletions", json={"tenant": "bob"})) == (422, "TENANT_MISMATCH")
        answer = await site.ada.post("/v1/deletions", json={"tenant": "ada"})
        assert answer.status_code == 201
        receipt = answer.json()
        assert len(receipt["jobs"]) == 1
        assert receipt["kept"] == ["collections/default/index.json", "collections/default/root.json"]
        assert names(store_of_tenant(store, "ada")) == receipt["kept"]
        assert not any(line.faults for line in verify(lambda name: [store.get(f"tenants/ada/{name}")], "default", ()))
        for path, field in (("captures", "captures"), ("jobs", "jobs"), ("assets", "assets")):
            assert (await site.ada.get(f"/v1/{path}")).json()[field] == []
        assert (await site.ada.get("/v1/usage")).json()["stored_bytes"] < 1000
        assert {name: store.get(name) for name in names(store) if name.startswith("tenants/bob/")} == bobs
        assert len((await site.bob.get("/v1/jobs")).json()["jobs"]) == 1
        await upload(site.ada)  # and can begin anew


@pytest.mark.slow
async def test_what_finds_a_tenants_assets_goes_with_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(indexes, "SCANNED_ROWS", 0)
    store = memory()
    async with two_tenants(tmp_path, store) as site:
        for tenant, client in (("ada", site.ada), ("bob", site.bob)):
            publish_for(store, tenant, "dress")
            assert (await client.get("/v1/collections/default/assets?label=dress")).json()["assets"] != []

        async def has_files(count: int) -> bool:
            return len(list((tmp_path / "gw" / "search").glob("*.db"))) == count

        await until(lambda: has_files(2))
        assert (await site.ada.post("/v1/deletions", json={"tenant": "ada"})).status_code == 201
        await until(lambda: has_files(1))


async def test_the_export_has_everything_and_nothing_of_others(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "store")
    async with two_tenants(tmp_path, store) as site:
        for tenant, client in (("ada", site.ada), ("bob", site.bob), ("default", site.operator)):
            publish_for(store, tenant, "dress")
            if tenant != "default":
                await upload(client)
        large = bytes(9 << 20)
        own = store_of_tenant(store, "ada")
        own.put("captures/cap_large.zip", large, content_type="application/zip")
        job = await start(site.ada, "cap_large", "new")
        answer = await site.ada.get("/v1/export")
        assert answer.headers["content-disposition"] == 'attachment; filename="capture2vr-ada.zip"'
        with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
            assert archive.testzip() is None
            assert sorted(archive.namelist()) == sorted([*names(own), "jobs.json"])
            assert all(archive.read(name) == own.get(name) for name in names(own))
            (told,) = json.loads(archive.read("jobs.json"))["jobs"]
            assert (told["id"], told["order"]["capture"]) == (job, "cap_large")
        assert code(await site.operator.get("/v1/export")) == (403, "SCOPE_MISSING")


async def test_the_default_tenants_export_leaves_the_others_out(tmp_path: Path) -> None:
    store = memory()
    for tenant in ("default", "ada"):
        publish_for(store, tenant, "dress")
    async with gateway(tmp_path / "gw", store) as client, client.stream("GET", "/v1/export") as answer:
        content = b"".join([block async for block in answer.aiter_bytes()])
    assert not [name for name in zipfile.ZipFile(io.BytesIO(content)).namelist() if name.startswith("tenants/")]


@pytest.fixture
def data(monkeypatch: pytest.MonkeyPatch) -> list[TenantData]:
    """What deletes by retention in the gateway of this test, which leaves the hour to the test."""
    found: list[TenantData] = []

    async def wait(self: TenantData) -> None:
        found.append(self)
        await asyncio.Event().wait()

    monkeypatch.setattr(TenantData, "keep_retention", wait)
    return found


async def test_retention(tmp_path: Path, data: list[TenantData]) -> None:
    store = memory()
    async with two_tenants(tmp_path, store) as site:
        own = {"captures_days": 0, "removed_assets_days": 0, "jobs_days": 90}
        assert (await site.ada.get("/v1/retention")).json() == own
        kept = {"captures_days": 30, "removed_assets_days": 10, "jobs_days": 20}
        assert (await site.ada.put("/v1/retention", json=kept)).json() == kept
        assert (await site.ada.put("/v1/retention", json={"captures_days": -1})).status_code == 422
        for tenant, client in (("ada", site.ada), ("bob", site.bob)):
            await upload(client)
            for key in ("dress", "shoe"):
                publish_for(store, tenant, key)
            await client.post("/v1/assets/dress/remove")
            job = await start(client, await upload(client), "new")
            await client.post(f"/v1/jobs/{job}/cancel")
            await ended(client, job)
        assert (await site.bob.put("/v1/retention", json={"jobs_days": 0})).json() == {**own, "jobs_days": 0}
        before = await everything(site.bob)
        found = []
        for days in (9, 11, 19, 21, 29, 31):
            await data[0].apply_retention(time.time() + days * DAY_S)
            found.append(await everything(site.ada))
        assert found[0] == before
        assert found[1] == {**before, "deleted": ["asset dress"]}
        assert found[3] == {**before, "jobs": 0, "deleted": ["asset dress", "ended jobs"]}
        assert (found[2], found[4]) == (found[1], found[3])
        assert (found[5]["captures"], found[5]["jobs"], found[5]["assets"]) == (0, 0, ["shoe"])
        assert (await site.ada.post("/v1/assets/dress/restore")).status_code == 404
        assert await everything(site.bob) == before
        assert (await site.bob.post("/v1/assets/dress/restore")).status_code == 200


async def test_jobs_go_after_the_days_of_the_service_without_a_receipt(tmp_path: Path, data: list[TenantData]) -> None:
    async with two_tenants(tmp_path, memory()) as site:
        job = await start(site.ada, await upload(site.ada))
        await site.ada.post(f"/v1/jobs/{job}/cancel")
        await ended(site.ada, job)
        await site.ada.put("/v1/retention", json={"captures_days": 1000})
        for days, count in ((89, 1), (91, 0)):
            await data[0].apply_retention(time.time() + days * DAY_S)
            found = await everything(site.ada)
            assert (found["jobs"], found["deleted"], found["captures"]) == (count, [], 1)


async def everything(client: httpx.AsyncClient) -> dict[str, Any]:
    """Counts of what a tenant has, and what was deleted."""
    return {
        "captures": len((await client.get("/v1/captures")).json()["captures"]),
        "jobs": len((await client.get("/v1/jobs")).json()["jobs"]),
        "assets": [row["key"] for row in (await client.get("/v1/assets")).json()["assets"]],
        "deleted": sorted(each["what"] for each in (await client.get("/v1/deletions")).json()["deletions"]),
    }


async def test_a_capture_that_a_job_needs_outlives_its_time(tmp_path: Path, data: list[TenantData]) -> None:
    async with two_tenants(tmp_path, memory()) as site:
        await site.ada.put("/v1/retention", json={"captures_days": 1})
        job = await start(site.ada, await upload(site.ada))
        await data[0].apply_retention(time.time() + 2 * DAY_S)
        assert (await everything(site.ada))["captures"] == 1
        await site.ada.post(f"/v1/jobs/{job}/cancel")
        await ended(site.ada, job)
        await data[0].apply_retention(time.time() + 2 * DAY_S)
        assert (await everything(site.ada))["captures"] == 0


class _TwoGateways(MemoryStore):
    """A store on which another gateway deletes all captures of the tenant ada while this one deletes her first."""

    def delete(self, name: str) -> None:
        for head in self.list("tenants/ada/captures/") if name.startswith("tenants/ada/") else ():
            super().delete(head.name)
        super().delete(name)


def put_old_capture(store: Store, capture: str) -> None:
    """Store a capture of the year 2020."""
    receipt = {"capture": capture, "created": "2020-01-01T00:00:00Z"}
    store.put(f"captures/{capture}.zip", b"zip", content_type="application/zip")
    store.put(f"captures/{capture}.json", json.dumps(receipt).encode(), content_type="application/json")


async def test_a_capture_that_another_gateway_has_just_deleted_stops_no_retention(tmp_path: Path) -> None:
    """The loop itself runs here, as in a gateway; ada comes first."""
    store = _TwoGateways()
    for tenant, capture in (("ada", "cap_1"), ("ada", "cap_2"), ("bob", "cap_3")):
        put_old_capture(store_of_tenant(store, tenant), capture)
        make_key(tmp_path / "gw", tenant)
    engine = open_engine(f"sqlite:///{tmp_path / 'gw' / 'gateway.db'}")
    for tenant in ("ada", "bob"):
        AccessStore(engine).set_retention(tenant, {"captures_days": 30})
    engine.dispose()
    async with two_tenants(tmp_path, store) as site:

        async def bobs_capture_is_gone() -> bool:
            return (await everything(site.bob))["deleted"] == ["capture cap_3"]

        await until(bobs_capture_is_gone)
        assert (await everything(site.ada))["deleted"] == ["capture cap_1"], "the other's is in the other's receipt"
    assert not names(store_of_tenant(store, "bob"))


async def test_what_cannot_be_deleted_is_named_and_the_rest_goes(
    tmp_path: Path, data: list[TenantData], caplog: pytest.LogCaptureFixture
) -> None:
    store = memory()
    async with two_tenants(tmp_path, store) as site:
        for tenant, client in (("ada", site.ada), ("bob", site.bob)):
            await client.put("/v1/retention", json={"captures_days": 30, "removed_assets_days": 30})
            put_old_capture(store_of_tenant(store, tenant), "cap_1")
            for key in ("dress", "shoe"):
                publish_for(store, tenant, key)
                await client.post(f"/v1/assets/{key}/remove")
        ada = store_of_tenant(store, "ada")
        entry = json.loads(ada.get("catalog/dress.json"))
        ada.put("catalog/dress.json", json.dumps({**entry, "removed": "long ago"}).encode(), content_type="a")
        ada.put("collections/default/root.json", b"{", content_type="application/json")
        await data[0].apply_retention(time.time() + 40 * DAY_S)
        assert (await everything(site.ada))["deleted"] == ["capture cap_1"]
        assert (await everything(site.bob))["deleted"] == ["asset dress", "asset shoe", "capture cap_1"]
    assert "asset dress of ada: kept, because it cannot be read: Invalid isoformat string: 'long ago'" in caplog.text
    assert "asset shoe of ada: could not be deleted, trying again later: collections/default/root.json" in caplog.text


async def audit(client: httpx.AsyncClient, **params: Any) -> list[dict[str, Any]]:
    """All rows that a caller may read, newest first, over pages."""
    rows: list[dict[str, Any]] = []
    before: int | None = 0
    while before is not None:
        page = (await client.get("/v1/audit", params={"before": before, "limit": 2, **params})).json()
        rows += page["records"]
        before = page["next"]
    return rows


async def test_the_audit_log_says_who_did_what_from_where(tmp_path: Path) -> None:
    async with two_tenants(tmp_path, memory()) as site:
        capture = await upload(site.ada)
        await site.bob.delete(f"/v1/captures/{capture}")
        await site.ada.get(f"/v1/captures/{capture}/archive")
        await site.ada.get(f"/v1/captures/{capture}")
        await site.anonymous.post("/v1/session", json={"key": "c2v_ada_" + "x" * 43})
        await site.anonymous.post("/v1/jobs", json={})
        own = (await site.ada.get("/v1/session")).json()["key"]
        answer = await site.ada.delete(f"/v1/captures/{capture}", headers={"X-Request-ID": "abc"})
        assert answer.status_code == 200
        mine = await audit(site.ada)
        assert [(row["method"], row["path"], row["status"]) for row in mine] == [
            ("DELETE", f"/v1/captures/{capture}", 200),
            ("GET", f"/v1/captures/{capture}/archive", 200),
            ("POST", "/v1/captures", 201),
        ]
        assert {(row["tenant"], row["via"], row["key"], row["address"]) for row in mine} == {
            ("ada", "key", own, "127.0.0.1")
        }
        assert mine[0]["request"] == "abc"
        assert [row["status"] for row in await audit(site.bob)] == [404]
        assert code(await site.ada.get("/v1/audit", params={"tenant": "bob"})) == (403, "SCOPE_MISSING")
        everybody = await audit(site.operator, tenant="*")
        assert len(everybody) == 5
        assert [row["via"] for row in everybody if row["path"] == "/v1/session"] == ["anonymous"]
        assert [row["id"] for row in everybody] == sorted((row["id"] for row in everybody), reverse=True)


async def test_a_change_is_in_the_audit_log_and_a_part_of_an_upload_is_not(tmp_path: Path) -> None:
    async with two_tenants(tmp_path, memory()) as site:
        await site.ada.patch("/v1/assets/nothing/notes/n1", json={"text": "A stain"})
        await site.ada.patch("/v1/assets/nothing", json={"label": "Cup"})
        await site.ada.patch("/v1/uploads/upl_1", content=b"part")
        await site.ada.delete("/v1/assets/moving")  # a key like the end of an address of what is not recorded
        recorded = [(row["method"], row["path"]) for row in await audit(site.ada)]
        assert recorded == [
            ("DELETE", "/v1/assets/moving"),
            ("PATCH", "/v1/assets/nothing"),
            ("PATCH", "/v1/assets/nothing/notes/n1"),
        ]


async def test_a_browsers_login_is_recorded_with_its_key(tmp_path: Path) -> None:
    async with two_tenants(tmp_path, memory()) as site:
        secret = site.ada.headers["authorization"].removeprefix("Bearer ")
        await site.anonymous.post("/v1/session", json={"key": secret})
        (row,) = await audit(site.ada)
        assert (row["path"], row["via"], row["status"]) == ("/v1/session", "session", 200)
        assert secret not in json.dumps(await audit(site.operator, tenant="*"))


@pytest.mark.slow
def test_a_row_can_be_neither_changed_nor_deleted(url: str) -> None:
    engine = open_engine(url)
    store = AuditStore(engine)
    store.append(
        {"at": 1.0, "tenant": "ada", "via": "key", "key": "k", "address": "", "request": "r", "method": "POST",
         "path": "/v1/jobs", "status": 202}
    )  # fmt: skip
    before = store.page(tenant=None, before=0, limit=9)
    for change in ("UPDATE audit_log SET status = 200", "DELETE FROM audit_log"):
        with pytest.raises(sa.exc.DBAPIError, match="append-only"), engine.begin() as db:
            db.exec_driver_sql(change)
    assert store.page(tenant="ada", before=0, limit=9) == before
    assert len(before) == 1
    engine.dispose()


async def test_what_was_done_is_answered_though_the_log_fails(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    async with gateway(tmp_path / "gw", memory()) as client:
        engine = open_engine(f"sqlite:///{tmp_path / 'gw' / 'gateway.db'}")
        with engine.begin() as db:
            db.exec_driver_sql("DROP TABLE audit_log")
        engine.dispose()
        await upload(client)
    assert "the audit log has no row of POST /v1/captures" in caplog.text


async def test_deleting_at_once_from_two_sides(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        publish_for(store, "default", "dress")
        answers = await asyncio.gather(*(client.delete("/v1/assets/dress") for _ in range(4)))
        assert {answer.status_code for answer in answers} <= {200, 404}
        assert 200 in {answer.status_code for answer in answers}
        assert not [name for name in names(store) if "dress" in name]
