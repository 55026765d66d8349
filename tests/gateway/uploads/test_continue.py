"""POST /v1/captures?continues=: photos are added to those of an earlier capture, which stays as it is."""

from __future__ import annotations

import io
from pathlib import Path

import httpx
import numpy as np
import pytest
from PIL import Image

from capture2vr.process.archives import unpack
from capture2vr.storage.memory import MemoryStore
from capture2vr.storage.store import Store, list_all
from capture2vr.storage.tenant_store import store_of_tenant
from tests.support.in_process_gateway import gateway, memory
from tests.support.photos import private_pictures
from tests.support.tenants import two_tenants
from tests.support.tus import cloud, created, finish, patch


def photo(seed: int) -> bytes:
    """A small JPEG, another for each seed."""
    rgb = np.random.default_rng(seed).integers(0, 256, (24, 32, 3), np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(rgb).save(buffer, "JPEG")
    return buffer.getvalue()


async def send(client: httpx.AsyncClient, files: dict[str, bytes], continues: str = "") -> httpx.Response:
    parts = [("files", (name, content, "application/octet-stream")) for name, content in files.items()]
    return await client.post("/v1/captures", files=parts, params={"continues": continues} if continues else None)


def stored(store: Store, capture: str, folder: Path) -> dict[str, bytes]:
    """The files of a stored capture."""
    store.fetch(f"captures/{capture}.zip", folder / f"{capture}.zip")
    files = unpack(folder / f"{capture}.zip", folder / capture)
    return {file.relative_to(folder / capture).as_posix(): file.read_bytes() for file in files}


async def test_a_new_capture_has_the_photos_of_both_and_the_earlier_one_stays(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        first = (await send(client, {"walk/1.jpg": photo(1), "walk/2.jpg": photo(2)})).json()
        before = store.get(f"captures/{first['capture']}.zip")
        answer = await send(client, {"2.jpg": photo(3), "IMG.jpg": photo(4), "walk": photo(5)}, first["capture"])
        receipt = answer.json()
        assert answer.status_code == 201, receipt
        assert (receipt["continues"], first["continues"]) == (first["capture"], "")
        assert receipt["capture"] != first["capture"]
        assert store.get(f"captures/{first['capture']}.zip") == before
        files = stored(store, receipt["capture"], tmp_path)
        photos = {number: Image.open(io.BytesIO(photo(number))).tobytes() for number in range(1, 6)}
        shown = {name: Image.open(io.BytesIO(content)).tobytes() for name, content in files.items()}
        assert set(shown.values()) == set(photos.values())
        assert shown["1.jpg"] == photos[1], "the earlier ones keep their names"
        assert shown["2.jpg"] == photos[2]
        assert {file["file"] for file in receipt["files"]} == set(files)
        again = (await send(client, {"1.jpg": photo(6)}, receipt["capture"])).json()
        assert len(again["files"]) == 6


async def test_a_resumable_upload_continues_a_capture_too_and_once(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        first = (await send(client, {"1.jpg": photo(1)})).json()["capture"]
        upload = await created(client, len(photo(2)), filename="2.jpg", filetype="image/jpeg")
        await patch(client, upload, 0, photo(2))
        one, two = [await finish(client, upload, continues=first) for _ in range(2)]
        assert one.json() == two.json()
        assert {file["file"] for file in one.json()["files"]} == {"1.jpg", "2.jpg"}


@pytest.mark.parametrize(
    ("earlier", "added", "file"),
    [
        ({"scan.ply": cloud(200)}, {"1.jpg": photo(1)}, "scan.ply"),
        ({"1.jpg": photo(1), "transforms.json": b"{}"}, {"2.jpg": photo(2)}, "transforms.json"),
        ({"1.jpg": photo(1)}, {"scan.ply": cloud(200)}, "scan.ply"),
        ({"1.jpg": photo(1)}, {"walk.mp4": private_pictures.film()}, "walk.mp4"),
    ],
)
async def test_only_photos_are_added_to_photos(
    tmp_path: Path, earlier: dict[str, bytes], added: dict[str, bytes], file: str
) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        first = (await send(client, earlier)).json()["capture"]
        before = names(store)
        answer = await send(client, added, first)
        document = answer.json()
        assert (answer.status_code, document["code"], document["file"]) == (422, "CAPTURE_NOT_PHOTOS", file)
        assert names(store) == before


def names(store: MemoryStore) -> list[str]:
    return [head.name for head in list_all(store, "")]


async def test_the_limits_hold_for_both_together(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store, max_files=3) as client:
        first = (await send(client, {"1.jpg": photo(1), "2.jpg": photo(2)})).json()["capture"]
        answer = await send(client, {"3.jpg": photo(3), "4.jpg": photo(4)}, first)
        assert (answer.status_code, answer.json()["code"]) == (413, "UPLOAD_TOO_MANY_FILES")
    most = 2 * len(photo(1))
    async with gateway(tmp_path / "other", store, max_upload_bytes=most) as client:
        answer = await send(client, {"3.jpg": photo(3)}, first)
        assert (answer.status_code, answer.json()["code"]) == (413, "UPLOAD_TOO_LARGE")


async def test_another_tenants_capture_is_as_one_that_does_not_exist(tmp_path: Path) -> None:
    store = memory()
    async with two_tenants(tmp_path, store) as site:
        first = (await send(site.ada, {"1.jpg": photo(1)})).json()["capture"]
        order = {"capture": first, "asset_key": "dress"}
        job = (await site.ada.post("/v1/jobs", json=order)).json()
        own = (await send(site.bob, {"1.jpg": photo(2)})).json()["capture"]
        his = (await site.bob.post("/v1/jobs", json={"capture": own, "asset_key": "dress"})).json()
        before = store.get(f"tenants/ada/captures/{first}.zip")
        for capture in (first, "cap_nothing"):
            uploaded = await send(site.bob, {"2.jpg": photo(3)}, capture)
            again = await site.bob.post(his["links"]["again"], json={"capture": capture})
            for answer in (uploaded, again):
                assert (answer.status_code, answer.json()["code"]) == (404, "CAPTURE_UNKNOWN")
                assert answer.json()["detail"] == f"there is no capture '{capture}'"
        assert (await site.bob.post(job["links"]["again"], json={"capture": own})).status_code == 404
        assert store.get(f"tenants/ada/captures/{first}.zip") == before
        assert len([name for name in names(store_of_tenant(store, "bob")) if name.endswith(".zip")]) == 1


async def test_the_next_version_has_the_options_of_the_last_but_not_its_edits(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        first = (await send(client, {"1.jpg": photo(1)})).json()["capture"]
        order = {
            "capture": first,
            "asset_key": "dress",
            "label": "Dress",
            "preset": "draft",
            "box": [0.1, 0.1, 0.9, 0.9],
            "edits": {"up": [0, 1, 0], "fill": "all"},
        }
        job = (await client.post("/v1/jobs", json=order)).json()
        more = (await send(client, {"2.jpg": photo(2)}, first)).json()["capture"]
        again = (await client.post(job["links"]["again"], json={"capture": more, "cut": "scene"})).json()
        kept = ("asset_key", "label", "preset", "collection")
        assert [again[name] for name in kept] == [job[name] for name in kept]
        assert (again["capture"], again["cut"], again["edits"]) == (more, "scene", {"schema": 1})
        edited = await client.post(job["links"]["again"], json={"capture": more, "edits": {"up": [0, 0, 1]}})
        assert edited.json()["edits"]["up"] == [0, 0, 1]
