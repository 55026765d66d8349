"""/v1/collections: the signed index as it stands, search, removal and restoration."""

from __future__ import annotations

import asyncio
import base64
import json
import sqlite3
from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, closing
from pathlib import Path

import httpx
import pytest

from capture2vr.gateway.app import create_app
from capture2vr.gateway.routes import collections
from capture2vr.gateway.search import indexes
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.storage.catalogue.commit import forget_retired
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import PublishPolicy, publish
from capture2vr.storage.catalogue.root import index_name, read_index, root_name
from capture2vr.storage.catalogue.signing import Keys, check_signatures, public_key
from capture2vr.storage.catalogue.verify import verify
from capture2vr.storage.local import LocalStore
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import Store
from tests.storage.catalogue.test_signing import ONE, TWO
from tests.support.bundles import Crash, CrashingStore, bundle, listed
from tests.support.in_process_gateway import answering
from tests.support.patience import PATIENCE_S

SIGNED = Keys(signers=(ONE,))
SIGNING = PublishPolicy(SIGNED)
INDEX = index_name("default")
ROOT = root_name("default")


def client(folder: Path, store: Store, keys: Keys = SIGNED) -> AbstractAsyncContextManager[httpx.AsyncClient]:
    """A gateway that has been started."""
    return answering(create_app(GatewaySettings(data_dir=folder / "data", workers=(), open=True), store, keys))


@pytest.fixture
def store() -> MemoryStore:
    """A boot, a shoe and a sofa."""
    store = MemoryStore()
    for key, label, labels in (
        ("boot", "Walking Boot", ["footwear", "Leder"]),
        ("shoe", "Straßenschuh", ["footwear"]),
        ("sofa", "", ["furniture"]),
    ):
        publish(bundle(label=label, labels=labels), store, key=key, policy=SIGNING)
    return store


@pytest.fixture
async def gateway(tmp_path: Path, store: MemoryStore) -> AsyncIterator[httpx.AsyncClient]:
    async with client(tmp_path, store) as gateway:
        yield gateway


@pytest.mark.parametrize(("query", "name"), [("", INDEX), ("?form=tree", ROOT)])
async def test_root_and_index_are_what_the_store_has(
    gateway: httpx.AsyncClient, store: MemoryStore, query: str, name: str
) -> None:
    answer = await gateway.get(f"/v1/collections/default{query}")
    told, stored = answer.json(), json.loads(store.get(name))
    assert {**told, "base": ""} == {**stored, "base": ""}
    assert (answer.headers["cache-control"], answer.headers["access-control-allow-origin"]) == ("no-cache", "*")
    assert read_index(answer.content, "default", SIGNED.verification_keys).version == 3
    again = await gateway.get(f"/v1/collections/default{query}", headers={"If-None-Match": answer.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    publish(bundle(), store, key="new", policy=SIGNING)
    changed = await gateway.get(f"/v1/collections/default{query}", headers={"If-None-Match": answer.headers["etag"]})
    assert changed.status_code == 200


async def test_a_client_that_is_too_old_for_a_large_collection_is_told(
    gateway: httpx.AsyncClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(collections, "MOST_FLAT", 2)
    answer = await gateway.get("/v1/collections/default")
    assert (answer.status_code, answer.json()["code"]) == (410, "COLLECTION_LARGE")
    assert (await gateway.get("/v1/collections/default?form=tree")).status_code == 200


async def test_everything_can_be_checked_from_the_index_on(tmp_path: Path) -> None:
    """As a client would: the keys from /v1/keys, the objects below `base`."""
    local = LocalStore(tmp_path / "objects")
    publish(bundle(), local, key="dress", policy=SIGNING)
    async with client(tmp_path, local) as gateway:
        (key,) = (await gateway.get("/v1/keys")).json()["keys"]
        believed = public_key(base64.b64decode(key["ed25519"]))
        assert (believed.id, believed) == (key["key"], ONE.public)
        answer = await gateway.get("/v1/collections/default?form=tree")
        known = {ROOT: answer.content}
        told = answer.json()
        check_signatures("x", told["signed"].encode(), told["signatures"], (believed,))
        for head in [*local.list("assets/"), *local.list("collections/default/shard.")]:
            got = await gateway.get(told["base"] + head.name)
            assert got.status_code == 200
            assert "immutable" in got.headers["cache-control"]
            known[head.name] = got.content
        assert not any(line.faults for line in verify(lambda name: [known[name]], "default", (believed,)))
        assert (await gateway.get(told["base"] + INDEX)).headers["cache-control"] == "no-cache"


async def found(gateway: httpx.AsyncClient, **params: str | int) -> list[str]:
    """Keys, over all pages."""
    keys: list[str] = []
    after: str | None = ""
    while after is not None:
        page = (await gateway.get("/v1/collections/default/assets", params={**params, "after": after})).json()
        keys += [each["key"] for each in page["assets"]]
        after = page["next"]
    return keys


@pytest.mark.parametrize(
    ("label", "keys"),
    [
        ("", ["boot", "shoe", "sofa"]),
        ("BOOT", ["boot"]),
        ("strasse", ["shoe"]),
        ("footwear", ["boot", "shoe"]),
        ("leder", ["boot"]),
        ("foot", []),  # a label counts as a whole
        ("sofa", ["sofa"]),  # without a label the key stands for it
        ("%", []),
        ("nothing", []),
    ],
)
@pytest.mark.parametrize("limit", [1, 2, 100])
async def test_search_by_label(gateway: httpx.AsyncClient, label: str, keys: list[str], limit: int) -> None:
    assert await found(gateway, label=label, limit=limit) == keys


async def test_search_by_state_date_and_size(gateway: httpx.AsyncClient, store: MemoryStore) -> None:
    rows = (await gateway.get("/v1/collections/default/assets")).json()["assets"]
    size = sum(file["bytes"] for file in read_entry(store, "boot").document["files"])
    assert [row["bytes"] for row in rows if row["key"] == "boot"] == [size]
    everything = [row["key"] for row in rows]
    assert await found(gateway, state="preview", since="2020-01-01T00:00:00Z", min_bytes=1) == everything
    assert await found(gateway, since=rows[0]["updated"], until=rows[-1]["updated"], max_bytes=10**9) == everything
    for asked in ({"state": "refined"}, {"until": "2020-01-01T00:00:00+01:00"}, {"max_bytes": 0}, {"min_bytes": 10**9}):
        assert await found(gateway, **asked) == []
    for wrong in ({"since": "2020-01-01"}, {"since": "yesterday"}, {"min_bytes": -1}, {"state": "removed"}):
        assert (await gateway.get("/v1/collections/default/assets", params=wrong)).status_code == 422


async def test_a_shard_that_is_retired_meanwhile_is_looked_up_anew(tmp_path: Path, store: MemoryStore) -> None:
    """The index was read; before its shard is, another version is published and the shard deleted."""

    class Slow(CrashingStore):
        waits = True

        def get(self, name: str, *, start: int = 0, length: int | None = None) -> bytes:
            if "shard" in name and self.waits:
                self.waits = False
                publish(bundle(), store, key="new", policy=SIGNING)
                forget_retired(store, "default", SIGNING.keys)
            return super().get(name, start=start, length=length)

    async with client(tmp_path, Slow(store, -1, after=False)) as gateway:
        assert await found(gateway) == ["boot", "new", "shoe", "sofa"]


async def test_a_large_collection_is_searched_by_an_index_and_what_is_new_is_found_at_once(
    tmp_path: Path, gateway: httpx.AsyncClient, store: MemoryStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(indexes, "SCANNED_ROWS", 1)
    async with asyncio.timeout(PATIENCE_S):
        while not has_index(tmp_path):
            assert await found(gateway, label="footwear") == ["boot", "shoe"]
            await asyncio.sleep(0.02)
    assert await found(gateway, label="footwear", limit=1) == ["boot", "shoe"]
    publish(bundle(label="Pumps", labels=["Footwear"]), store, key="pumps", policy=SIGNING)
    await gateway.post("/v1/assets/boot/remove")
    assert await found(gateway, label="footwear") == ["pumps", "shoe"]


def has_index(folder: Path) -> bool:
    """Whether a gateway has an index with rows in it."""
    for path in (folder / "data" / "search").glob("*.db"):
        with closing(sqlite3.connect(path)) as connection:
            return bool(connection.execute("SELECT value FROM meta WHERE name = 'token' AND value <> ''").fetchall())
    return False


async def test_a_row_leads_to_the_rest(gateway: httpx.AsyncClient, store: MemoryStore) -> None:
    page = (await gateway.get("/v1/collections/default/assets", params={"label": "boot"})).json()
    row, listed_row = page["assets"][0], listed(store)["boot"]
    assert (page["version"], row["state"], row["labels"]) == (3, "preview", ["footwear", "Leder"])
    assert row["manifest"].endswith(listed_row.manifest_name)
    assert row["preview"].endswith(listed_row.preview_name)
    assert (await gateway.get(row["self"])).json()["version"] == row["version"]


@pytest.mark.slow
async def test_removed_is_gone_everywhere_and_restored_is_back(gateway: httpx.AsyncClient, store: MemoryStore) -> None:
    for _ in range(2):
        answer = await gateway.post("/v1/assets/shoe/remove")
        assert (answer.status_code, answer.json()["removed"]) == (200, True)
    for path in ("shoe", "shoe/lod/0", "shoe/qr.svg"):
        gone = await gateway.get(f"/v1/assets/{path}")
        assert (gone.status_code, gone.json()["code"]) == (410, "ASSET_REMOVED")
        assert "restore" in gone.json()["hints"][0]
    assert await found(gateway) == ["boot", "sofa"]
    assert [each["key"] for each in (await gateway.get("/v1/assets")).json()["assets"]] == ["boot", "sofa"]
    assert listed(store, believed=SIGNED.verification_keys)["shoe"].removed
    answer = await gateway.post("/v1/assets/shoe/restore")
    assert (answer.status_code, answer.json()["removed"], answer.json()["version"]) == (200, False, 1)
    assert (await gateway.get("/v1/assets/shoe")).status_code == 200
    assert await found(gateway) == ["boot", "shoe", "sofa"]


async def test_a_new_version_brings_it_back(gateway: httpx.AsyncClient, store: MemoryStore) -> None:
    await gateway.post("/v1/assets/shoe/remove")
    publish(bundle(content="new"), store, key="shoe", policy=SIGNING)
    assert (await gateway.get("/v1/assets/shoe")).json()["version"] == 2
    assert "shoe" in await found(gateway)


async def test_pages_of_assets_skip_what_was_removed(gateway: httpx.AsyncClient) -> None:
    await gateway.post("/v1/assets/boot/remove")
    first = (await gateway.get("/v1/assets", params={"limit": 1})).json()
    assert ([each["key"] for each in first["assets"]], first["next"]) == (["shoe"], "shoe")
    await gateway.post("/v1/assets/sofa/remove")
    second = (await gateway.get("/v1/assets", params={"limit": 1, "after": "shoe"})).json()
    assert second == {"assets": [], "next": None, "damaged": []}


@pytest.mark.parametrize("name", ["-a", ".a", "..%5ca", "a%20b", "%C3%A4", "x" * 150, "%F0%9F%91%9F"])
async def test_impossible_names(gateway: httpx.AsyncClient, name: str) -> None:
    for method, path in (
        ("GET", f"collections/{name}"),
        ("GET", f"collections/{name}/assets"),
        ("POST", f"assets/{name}/remove"),
        ("POST", f"assets/{name}/restore"),
    ):
        url = httpx.URL("http://gateway").copy_with(raw_path=f"/v1/{path}".encode())
        answer = await gateway.request(method, url)
        assert (answer.status_code, answer.json()["code"].split("_")[1]) == (422, "INVALID")


async def test_unknown_names(gateway: httpx.AsyncClient) -> None:
    for path in ("/v1/collections/none", "/v1/collections/none/assets"):
        assert (await gateway.get(path)).json()["code"] == "COLLECTION_UNKNOWN"
    for verb in ("remove", "restore"):
        answer = await gateway.post(f"/v1/assets/none/{verb}")
        assert (answer.status_code, answer.json()["code"]) == (404, "ASSET_UNKNOWN")


async def test_without_the_key_a_signed_collection_is_not_changed(tmp_path: Path, store: MemoryStore) -> None:
    before = store.get(INDEX)
    async with client(tmp_path, store, Keys()) as gateway:
        answer = await gateway.post("/v1/assets/shoe/remove")
    assert (answer.status_code, answer.json()["code"]) == (503, "SIGNING_KEY_MISSING")
    assert "STORAGE_SIGNING_KEY" in answer.json()["hints"][0]
    assert store.get(INDEX) == before


async def test_a_collection_of_a_stranger_is_not_searched(tmp_path: Path, store: MemoryStore) -> None:
    async with client(tmp_path, store, Keys(trusted=(TWO.public,))) as gateway:
        answer = await gateway.get("/v1/collections/default/assets")
    assert (answer.status_code, answer.json()["code"]) == (503, "KEY_UNKNOWN")


@pytest.mark.parametrize("damaged", [b"{", b"[]", b'{"signed": 1, "signatures": []}'])
async def test_a_damaged_index_is_told(gateway: httpx.AsyncClient, store: MemoryStore, damaged: bytes) -> None:
    store.put(ROOT, damaged, content_type="application/json")
    for path in ("", "?form=tree", "/assets"):
        answer = await gateway.get(f"/v1/collections/default{path}")
        assert (answer.status_code, answer.json()["code"]) == (503, "CATALOGUE_TRUNCATED")


async def test_a_store_that_dies_in_mid_publish_leaves_the_last_version(
    gateway: httpx.AsyncClient, store: MemoryStore
) -> None:
    before = (await gateway.get("/v1/collections/default")).content
    for at in (1, 5, 8, 9):
        dying = CrashingStore(store, at, after=False)
        with pytest.raises(Crash):
            publish(bundle(content=f"{at}"), dying, key="shoe", job=f"j{at}", policy=SIGNING)
        assert (await gateway.get("/v1/collections/default")).content == before
        assert await found(gateway) == ["boot", "shoe", "sofa"]
        assert (await gateway.get("/v1/assets/shoe")).status_code == 200
