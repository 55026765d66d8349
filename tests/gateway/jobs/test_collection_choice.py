"""A collection per user: what an upload or a job names, where an asset then stands, and who may take it away."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.jobs.collection_choice import choose_collection, require_collection
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import publish
from tests.support.bundles import bundle, listed
from tests.support.in_process_gateway import Making, capture, ended, gateway, job_when, memory, start, worker

HOSTILE = [
    "a/b",
    "..",
    "../a",
    ".a",
    "-a",
    "a b",
    "ä",
    "Алла",
    "👟",
    "a\n",
    "a\0",
    "a\\b",
    "%2e%2e",
    "x" * 101,
    "x" * 300,
]
PLY = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n"


async def test_a_job_tells_where_its_asset_stands(tmp_path: Path) -> None:
    store = memory()
    async with worker(Making(store), tmp_path / "edge") as port, gateway(tmp_path / "gw", store, port) as client:
        named = await start(client, capture(store), "shoe", collection="ada")
        plain = await start(client, capture(store), "boot")
        asked = (await client.get(f"/v1/jobs/{named}")).json()
        hers, ours = await ended(client, named), await ended(client, plain)
        place = (await client.get(hers["links"]["place"])).json()
        row = listed(store, "ada")["shoe"]
        assert asked["collection"] == hers["collection"] == hers["asset"]["collection"] == "ada"
        assert hers["links"]["collection"] == "/v1/collections/ada"
        assert (ours["collection"], ours["links"]["place"]) == ("default", "/v1/collections/default/assets/boot")
        assert (place["collection"], place["asset"]["key"], place["asset"]["version"]) == ("ada", "shoe", row.version)
        assert place["asset"]["manifest"].endswith(row.manifest_name)
        assert "/collections/ada/shard." in place["shard"]
    assert (list(listed(store, "ada")), list(listed(store))) == (["shoe"], ["boot"])


async def test_what_nobody_named_is_known_once_it_is_published(tmp_path: Path, unused_tcp_port: int) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store, unused_tcp_port) as client:
        found = (await client.get(f"/v1/jobs/{await start(client, capture(store))}")).json()
    assert (found["collection"], found["links"]["collection"], found["links"]["place"]) == ("", "", "")


@pytest.mark.slow
async def test_a_restart_and_a_new_attempt_keep_the_collection(tmp_path: Path) -> None:
    """The gateway restarts while the worker is gone: the next worker hears of the collection from the job's row."""
    store = memory()
    first, second = Making(store), Making(store)
    async with worker(first, tmp_path / "first") as port, gateway(tmp_path / "gw", store, port) as client:
        job = await start(client, capture(store, wait=True), "shoe", collection="ada")
        await job_when(client, job, lambda found: found["fraction"] > 0)
    second.release.set()
    async with worker(second, tmp_path / "second") as port, gateway(tmp_path / "gw", store, port) as client:
        done = await ended(client, job)
    assert (done["state"], done["collection"], second.runs) == ("SUCCEEDED", "ada", [job])
    assert read_entry(store, "shoe").collections == ["ada"]


async def test_jobs_of_an_older_gateway_are_read(tmp_path: Path, unused_tcp_port: int) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store, unused_tcp_port) as client:
        job = await start(client, capture(store), collection="ada")
    with sqlite3.connect(tmp_path / "gw" / "gateway.db") as database:
        database.execute('UPDATE jobs SET "order" = json_remove("order", \'$.collection\')')
    async with gateway(tmp_path / "gw", store, unused_tcp_port) as client:
        assert (await client.get(f"/v1/jobs/{job}")).json()["collection"] == ""


async def test_an_upload_names_a_collection_for_its_jobs(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        receipt = (await _sent(client, collection="ada")).json()
        silent = (await _sent(client)).json()
        assert (receipt["collection"], silent["collection"]) == ("ada", "")
        jobs = [
            (await client.post("/v1/jobs", json={"capture": receipt["capture"], "asset_key": key, **named})).json()
            for key, named in (("a", {}), ("b", {"collection": "bob"}))
        ]
    assert [job["collection"] for job in jobs] == ["ada", "bob"]


async def _sent(client: httpx.AsyncClient, **fields: str) -> httpx.Response:
    return await client.post("/v1/captures", data=fields, files=[("files", ("a.ply", PLY))])


async def test_hostile_names_are_refused_before_anything_is_stored(tmp_path: Path, unused_tcp_port: int) -> None:
    store = memory()
    capture(store)
    before = [head.name for head in store.list("", limit=100)]
    async with gateway(tmp_path / "gw", store, unused_tcp_port) as client:
        for name in HOSTILE:
            body: dict[str, Any] = {"capture": "cap_1", "asset_key": "shoe", "collection": name}
            for answer in (await client.post("/v1/jobs", json=body), await _sent(client, collection=name)):
                assert answer.status_code == 422, name
                assert "collection" in answer.text
        assert (await client.get("/v1/jobs")).json()["jobs"] == []
    assert [head.name for head in store.list("", limit=100)] == before


@given(st.text(max_size=120))
def test_whatever_is_taken_for_a_collection_is_a_plain_name(name: str) -> None:
    try:
        assert require_collection(name, "") == name
    except Problem:
        return
    assert 1 <= len(name) <= 100
    assert name.isascii()
    assert name[0].isalnum()
    assert not set(name) - set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-")


def test_an_asset_stays_where_it_is_and_a_key_is_one_asset() -> None:
    store = memory()
    publish(bundle(), store, key="shoe", collection="ada")
    assert choose_collection(store, named="", capture="cap_1", key="shoe") == "ada"
    assert choose_collection(store, named="ada", capture="cap_1", key="shoe") == "ada"
    with pytest.raises(Problem, match="in collection ada, not in bob") as refused:
        choose_collection(store, named="bob", capture="cap_1", key="shoe")
    assert (refused.value.status, refused.value.code) == (409, "KEY_ELSEWHERE")


async def test_only_the_asset_of_that_collection_is_taken_away(tmp_path: Path, unused_tcp_port: int) -> None:
    store = memory()
    publish(bundle(), store, key="shoe", collection="ada")
    async with gateway(tmp_path / "gw", store, unused_tcp_port) as client:
        for verb, removed in (("remove", True), ("restore", False)):
            other = await client.post(f"/v1/assets/shoe/{verb}", params={"collection": "bob"})
            assert (other.status_code, other.json()["code"]) == (404, "ASSET_UNKNOWN")
            assert read_entry(store, "shoe").removed is not removed
            hers = await client.post(f"/v1/assets/shoe/{verb}", params={"collection": "ada"})
            assert (hers.status_code, hers.json()["removed"]) == (200, removed)
        bad = await client.post("/v1/assets/shoe/remove", params={"collection": "../ada"})
        assert (bad.status_code, bad.json()["code"]) == (422, "COLLECTION_INVALID")
        (row,) = (await client.get("/v1/assets")).json()["assets"]
    assert row["collections"] == ["ada"]


async def test_places_that_are_none(tmp_path: Path, unused_tcp_port: int) -> None:
    store = memory()
    publish(bundle(), store, key="shoe", collection="ada")
    async with gateway(tmp_path / "gw", store, unused_tcp_port) as client:
        for path, status, code in (
            ("bob/assets/shoe", 404, "COLLECTION_UNKNOWN"),
            ("ada/assets/boot", 404, "ASSET_UNKNOWN"),
            ("ada/assets/-", 422, "KEY_INVALID"),
            ("-/assets/shoe", 422, "COLLECTION_INVALID"),
        ):
            answer = await client.get(f"/v1/collections/{path}")
            assert (answer.status_code, answer.json()["code"]) == (status, code)
        await client.post("/v1/assets/shoe/remove")
        gone = await client.get("/v1/collections/ada/assets/shoe")
    assert (gone.status_code, gone.json()["code"]) == (410, "ASSET_REMOVED")
