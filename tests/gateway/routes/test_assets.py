"""GET /v1/assets and /v1/files: what clients find by a key, and how caches and players may ask for it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Any

import httpx
import pytest
import pytest_asyncio

from capture2vr.gateway.app import create_app
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.local import LocalStore
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import IMMUTABLE, Store
from tests.support.bundles import bundle
from tests.support.in_process_gateway import answering

# One gateway answers most tests of the module, so they share its event loop.
pytestmark = pytest.mark.asyncio(loop_scope="module")


def client(tmp_path: Path, store: Store, **settings: Any) -> AbstractAsyncContextManager[httpx.AsyncClient]:
    """A gateway that has been started."""
    return answering(create_app(GatewaySettings(data_dir=tmp_path / "data", workers=(), open=True, **settings), store))


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> LocalStore:
    """For all tests of the module, because every put waits for the disk: they add to it, none changes what is there."""
    store = LocalStore(tmp_path_factory.mktemp("objects"))
    publish(bundle("preview"), store, key="dress", job="job_1")
    publish(bundle("refined"), store, key="dress", job="job_1")
    store.put("captures/cap_1.zip", b"private", content_type="application/zip")
    return store


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def gateway(tmp_path_factory: pytest.TempPathFactory, local: LocalStore) -> AsyncIterator[httpx.AsyncClient]:
    async with client(tmp_path_factory.mktemp("gateway"), local) as gateway:
        yield gateway


async def test_the_entry_tells_where_every_file_is(gateway: httpx.AsyncClient, local: LocalStore) -> None:
    answer = await gateway.get("/v1/assets/dress")
    document = answer.json()
    assert (document["version"], document["state"], document["label"]) == (2, "refined", "Dress")
    assert answer.headers["cache-control"] == "no-cache"
    assert answer.headers["access-control-allow-origin"] == "*"
    for file in [document["manifest"], document["preview"], *document["lods"], *document["files"]]:
        got = await gateway.get(file["url"])
        assert (got.status_code, got.content) == (200, local.get(file["name"]))


async def test_a_known_entry_is_not_sent_again_until_it_changes(tmp_path: Path) -> None:
    store = MemoryStore()
    publish(bundle(), store, key="dress", job="job_1")
    async with client(tmp_path, store) as gateway:
        etag = (await gateway.get("/v1/assets/dress")).headers["etag"]
        for given_tag in (etag, f"W/{etag}", f'"other", {etag}', "*"):
            again = await gateway.get("/v1/assets/dress", headers={"If-None-Match": given_tag})
            assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", etag)
        publish(bundle(content="new"), store, key="dress", job="job_2")
        changed = await gateway.get("/v1/assets/dress", headers={"If-None-Match": etag})
        assert (changed.status_code, changed.json()["version"]) == (200, 2)


async def test_unknown_and_impossible_keys(gateway: httpx.AsyncClient) -> None:
    for path in ("nobody", "nobody/lod/0", "nobody/qr.svg"):
        answer = await gateway.get(f"/v1/assets/{path}")
        assert (answer.status_code, answer.json()["code"]) == (404, "ASSET_UNKNOWN")
    for path in ("-dress", ".dress", "a%20b"):
        answer = await gateway.get(f"/v1/assets/{path}")
        assert (answer.status_code, answer.json()["code"]) == (422, "KEY_INVALID")


async def test_a_level_of_detail_is_elsewhere(gateway: httpx.AsyncClient, local: LocalStore) -> None:
    level = read_entry(local, "dress").document["lods"][1]
    answer = await gateway.get("/v1/assets/dress/lod/1")
    assert (answer.status_code, answer.headers["cache-control"]) == (307, "no-cache")
    assert answer.headers["location"] == f"http://gateway/v1/files/{level['name']}"
    assert (await gateway.get("/v1/assets/dress/lod/7")).json()["code"] == "LOD_UNKNOWN"
    assert (await gateway.get("/v1/assets/dress/lod/x")).status_code == 422


async def test_addresses_are_public_ones_where_there_are_any(tmp_path: Path, local: LocalStore) -> None:
    async with client(tmp_path, local, public_url="https://scan.example/") as behind:
        preview = (await behind.get("/v1/assets/dress")).json()["preview"]
    assert preview["url"].startswith("https://scan.example/v1/files/")
    cdn = LocalStore(local.root, "https://cdn.example/objects")
    async with client(tmp_path, cdn, public_url="https://scan.example/") as through:
        level = await through.get("/v1/assets/dress/lod/0")
    assert level.headers["location"].startswith("https://cdn.example/objects/as")


async def test_assets_are_listed_in_pages(tmp_path: Path) -> None:
    store = MemoryStore()
    async with client(tmp_path, store) as gateway:
        assert (await gateway.get("/v1/assets")).json() == {"assets": [], "next": None, "damaged": []}
        keys = [f"k{n}" for n in range(5)]
        for key in keys:
            publish(bundle(label=""), store, key=key)
        found: list[str] = []
        after = ""
        while after is not None:
            answer = (await gateway.get("/v1/assets", params={"limit": 2, "after": after})).json()
            found += [each["key"] for each in answer["assets"]]
            after = answer["next"]
        assert found == keys
        first = (await gateway.get("/v1/assets")).json()["assets"][0]
        told = [first[name] for name in ("label", "version", "self", "view")]
        assert told == ["k0", 1, "/v1/assets/k0", "/view/k0"]
        for params in ({"limit": 0}, {"limit": 101}, {"after": "../x"}):
            assert (await gateway.get("/v1/assets", params=params)).status_code == 422


async def test_the_qr_code_is_that_of_the_viewer(gateway: httpx.AsyncClient, tmp_path: Path, local: LocalStore) -> None:
    async with client(tmp_path, local, public_url="https://scan.example") as there:
        mine, public = [await each.get("/v1/assets/dress/qr.svg") for each in (gateway, there)]
    assert mine.headers["content-type"] == "image/svg+xml"
    assert b"<svg" in mine.content
    assert mine.content != public.content  # each holds its own address


class TestFiles:
    @pytest.fixture
    def name(self, local: LocalStore) -> str:
        return str(read_entry(local, "dress").document["lods"][0]["name"])

    @pytest.fixture
    def content(self, local: LocalStore, name: str) -> bytes:
        return local.get(name)

    async def test_whole(self, gateway: httpx.AsyncClient, name: str, content: bytes) -> None:
        answer = await gateway.get(f"/v1/files/{name}")
        assert (answer.status_code, answer.content) == (200, content)
        assert answer.headers["content-type"] == "model/gltf-binary"
        assert answer.headers["content-length"] == str(len(content))
        assert answer.headers["cache-control"] == IMMUTABLE
        assert answer.headers["accept-ranges"] == "bytes"
        assert answer.headers["access-control-allow-origin"] == "*"
        assert answer.headers["x-content-type-options"] == "nosniff"

    async def test_head_is_get_without_a_body(self, gateway: httpx.AsyncClient, name: str) -> None:
        get, head = await gateway.get(f"/v1/files/{name}"), await gateway.head(f"/v1/files/{name}")
        assert (head.status_code, head.content) == (200, b"")
        for header in ("etag", "content-length", "content-type", "cache-control"):
            assert head.headers[header] == get.headers[header]

    @pytest.mark.parametrize(("asked", "part"), [("0-3", slice(0, 4)), ("5-", slice(5, None)), ("-4", slice(-4, None))])
    async def test_a_range(
        self, gateway: httpx.AsyncClient, name: str, content: bytes, asked: str, part: slice
    ) -> None:
        answer = await gateway.get(f"/v1/files/{name}", headers={"Range": f"bytes={asked}"})
        assert (answer.status_code, answer.content) == (206, content[part])
        start = range(len(content))[part][0]
        assert answer.headers["content-range"] == f"bytes {start}-{start + len(answer.content) - 1}/{len(content)}"
        assert answer.headers["content-length"] == str(len(answer.content))

    async def test_a_range_beyond_the_end(self, gateway: httpx.AsyncClient, name: str, content: bytes) -> None:
        answer = await gateway.get(f"/v1/files/{name}", headers={"Range": f"bytes={len(content)}-"})
        assert (answer.status_code, answer.json()["code"]) == (416, "RANGE_UNSATISFIABLE")
        assert answer.headers["content-range"] == f"bytes */{len(content)}"

    @pytest.mark.parametrize("asked", ["bytes=0-1,3-4", "bytes=x", "lines=0-1", "bytes=-", "bytes=5-2"])
    async def test_what_is_no_single_range_gives_all(
        self, gateway: httpx.AsyncClient, name: str, content: bytes, asked: str
    ) -> None:
        answer = await gateway.get(f"/v1/files/{name}", headers={"Range": asked})
        assert (answer.status_code, answer.content) == (200, content)

    async def test_if_range(self, gateway: httpx.AsyncClient, name: str, content: bytes) -> None:
        etag = (await gateway.head(f"/v1/files/{name}")).headers["etag"]
        same = await gateway.get(f"/v1/files/{name}", headers={"Range": "bytes=0-1", "If-Range": etag})
        other = await gateway.get(f"/v1/files/{name}", headers={"Range": "bytes=0-1", "If-Range": '"other"'})
        assert (same.status_code, same.content) == (206, content[:2])
        assert (other.status_code, other.content) == (200, content)

    async def test_if_none_match(self, gateway: httpx.AsyncClient, name: str) -> None:
        etag = (await gateway.head(f"/v1/files/{name}")).headers["etag"]
        answer = await gateway.get(f"/v1/files/{name}", headers={"If-None-Match": etag, "Range": "bytes=0-1"})
        assert (answer.status_code, answer.content) == (304, b"")
        assert answer.headers["cache-control"] == IMMUTABLE

    async def test_a_large_file_in_parts_is_the_whole(self, gateway: httpx.AsyncClient, local: LocalStore) -> None:
        content = bytes(range(256)) * 4096
        local.put("assets/dress/big.bin", content, content_type="application/octet-stream")
        url, step = "/v1/files/assets/dress/big.bin", 300_000
        parts = [
            (await gateway.get(url, headers={"Range": f"bytes={start}-{start + step - 1}"})).content
            for start in range(0, len(content), step)
        ]
        assert b"".join(parts) == content
        assert (await gateway.get(url)).content == content

    async def test_a_collection_is_served_and_never_kept(self, gateway: httpx.AsyncClient, local: LocalStore) -> None:
        name = "collections/default/index.json"
        answer = await gateway.get(f"/v1/files/{name}")
        assert answer.content == local.get(name)
        assert answer.headers["cache-control"] == "no-cache"
        etag = {"If-None-Match": answer.headers["etag"]}
        assert (await gateway.get(f"/v1/files/{name}", headers=etag)).status_code == 304

    @pytest.mark.parametrize(
        "path",
        [
            "captures/cap_1.zip",
            "catalog/dress.json",
            "alias/dress/latest.json",
            "assets/../captures/cap_1.zip",
            "assets/%2e%2e/captures/cap_1.zip",
            "assets/..%2fcaptures/cap_1.zip",
            "assets//etc/passwd",
            "assets/dress",
            "assets/dress/",
            "assets/",
            "assets/.meta/x",
            ".meta/assets/dress",
            ".tmp/x",
            "assets/dress/none.glb",
            "assets/%00",
            "%2fetc%2fpasswd",
            "",
        ],
    )
    async def test_nothing_else_is_served(self, gateway: httpx.AsyncClient, path: str) -> None:
        for method in ("GET", "HEAD"):
            answer = await gateway.request(
                method, httpx.URL("http://gateway").copy_with(raw_path=f"/v1/files/{path}".encode())
            )
            assert answer.status_code == 404
            assert b"private" not in answer.content

    async def test_a_store_elsewhere_serves_its_own_files(self, tmp_path: Path) -> None:
        store = MemoryStore()
        publish(bundle(), store, key="dress")
        name = read_entry(store, "dress").document["lods"][0]["name"]
        async with client(tmp_path, store) as gateway:
            assert (await gateway.get(f"/v1/files/{name}")).status_code == 404


@pytest.mark.parametrize("damage", [b"{", b"", b"[]", b"null", b'{"version": 1}', b"\xff\xfe"])
async def test_a_damaged_entry_is_skipped_and_named(damage: bytes, tmp_path: Path) -> None:
    store = MemoryStore()
    for key in ("bag", "dress", "shoe"):
        publish(bundle(), store, key=key, job=f"job_{key}")
    store.put("catalog/dress.json", damage, content_type="application/json")
    async with client(tmp_path, store) as gateway:
        page = (await gateway.get("/v1/assets")).json()
        assert ([each["key"] for each in page["assets"]], page["damaged"]) == (["bag", "shoe"], ["dress"])
        first = (await gateway.get("/v1/assets?limit=1")).json()
        second = (await gateway.get(f"/v1/assets?limit=1&after={first['next']}")).json()
        assert ([each["key"] for each in second["assets"]], second["damaged"]) == (["shoe"], ["dress"])
        alone = await gateway.get("/v1/assets/dress")
        assert (alone.status_code, alone.json()["code"]) == (503, "ENTRY_DAMAGED")


@pytest.mark.slow
@pytest.mark.parametrize("damage", [lambda data: data[:-1], lambda data: b"X" + data[1:], lambda data: b""])
async def test_a_file_that_was_altered_or_cut_is_not_served(damage: Callable[[bytes], bytes], tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "objects")
    publish(bundle(), store, key="dress", job="job_1")
    file = read_entry(store, "dress").document["lods"][0]
    async with client(tmp_path, store) as gateway:
        intact = await gateway.get(f"/v1/files/{file['name']}")
        assert (intact.status_code, intact.headers["cache-control"]) == (200, IMMUTABLE)
        path = store.path(file["name"])
        path.write_bytes(damage(path.read_bytes()))
        for headers in ({}, {"Range": "bytes=0-3"}, {"If-None-Match": intact.headers["etag"]}):
            answer = await gateway.get(f"/v1/files/{file['name']}", headers=headers)
            assert (answer.status_code, answer.json()["code"]) == (503, "FILE_DAMAGED")
            assert "immutable" not in answer.headers["cache-control"]
