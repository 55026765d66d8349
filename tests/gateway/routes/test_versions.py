"""Versions of an asset over HTTP: each is read with its files' URLs, and the one before undoes an edit."""

from __future__ import annotations

from pathlib import Path

from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.local import LocalStore
from capture2vr.storage.memory import MemoryStore
from tests.support.bundles import bundle
from tests.support.in_process_gateway import gateway


async def test_undo_is_the_version_before(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "store")  # whose files the gateway serves
    for number in (1, 2):
        publish(bundle("refined", content=f"{number}"), store, key="dress", job=f"job_{number}")
    async with gateway(tmp_path / "gw", store) as client:
        asset = "/v1/assets/dress"
        now = (await client.get(asset)).json()
        earlier = (await client.get(f"{asset}/versions/1")).json()
        assert [each["version"] for each in now["versions"]] == [1, 2]
        assert earlier["version"] == 1
        file = await client.get(earlier["lods"][0]["url"])
        assert file.content == b"lod0.glb refined 1"

        undone = await client.post(f"{asset}/versions/1/restore")
        assert (undone.status_code, undone.json()["version"], undone.json()["restored"]) == (200, 3, 1)
        assert (await client.get(asset)).json()["lods"] == earlier["lods"]
        redone = await client.post(f"{asset}/versions/2/restore")
        assert redone.json()["version"] == 4
        assert (await client.get(asset)).json()["lods"] == now["lods"]


async def test_what_there_is_not_has_a_name(tmp_path: Path) -> None:
    store = MemoryStore()
    publish(bundle(), store, key="dress")
    async with gateway(tmp_path / "gw", store) as client:
        for path, code in {
            "dress/versions/9": "VERSION_UNKNOWN",
            "coat/versions/1": "ASSET_UNKNOWN",
            ".coat/versions/1": "KEY_INVALID",
            "dress/versions/0": "REQUEST_INVALID",
            "dress/versions/x": "REQUEST_INVALID",
        }.items():
            assert (await client.get(f"/v1/assets/{path}")).json()["code"] == code
            answer = await client.post(f"/v1/assets/{path}/restore")
            assert answer.json()["code"] == code
            assert answer.json()["hints"]
