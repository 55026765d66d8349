"""/v1/assets/{key}/notes: who may pin, change, remove and read notes, and what a note may be."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import httpx
import pytest

from capture2vr.gateway.access.caller import Scope
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.catalogue.visibility import Visibility
from capture2vr.storage.local import LocalStore
from tests.support.bundles import bundle
from tests.support.in_process_gateway import gateway, memory
from tests.support.tenants import bearer, make_key, publish_for, two_tenants

NOTES = "/v1/assets/dress/notes"
NOTE = {"text": '<img src=x onerror="alert(1)">\nTwo lines', "at": [0.5, 1, 2], "normal": [0, 2, 0]}
UNKNOWN = "note_" + "0" * 16


async def test_notes_are_pinned_read_changed_and_removed(tmp_path: Path) -> None:
    store = memory()
    publish(bundle(), store, key="dress")
    async with gateway(tmp_path / "gw", store) as client:
        answer = await client.post(NOTES, json=NOTE)
        assert answer.status_code == 201, answer.text
        note = answer.json()
        expected = {
            "text": NOTE["text"],
            "at": [0.5, 1, 2],
            "normal": [0, 1, 0],
            "author": "",
            "version": 1,
            "frame": 1,
        }
        assert {name: note[name] for name in expected} == expected
        assert (await client.get(NOTES)).json() == {"key": "dress", "version": 1, "notes": [note]}
        assert "notes" not in (await client.get("/v1/assets/dress")).json(), "clients of the entry need not know them"
        assert "notes" not in (await client.get("/v1/assets/dress/versions/1")).json()
        changed = (await client.patch(f"{NOTES}/{note['id']}", json={"text": "Clean"})).json()
        assert (changed["text"], changed["at"], bool(changed["edited"])) == ("Clean", [0.5, 1, 2], True)
        assert (await client.delete(f"{NOTES}/{note['id']}")).status_code == 204
        assert (await client.get(NOTES)).json()["notes"] == []
        assert (await client.delete(f"{NOTES}/{note['id']}")).json()["code"] == "NOTE_UNKNOWN"


@pytest.mark.parametrize(
    ("path", "body", "code"),
    [
        (NOTES, NOTE | {"text": "a" * 501}, "REQUEST_INVALID"),
        (NOTES, NOTE | {"text": " \n"}, "NOTE_REFUSED"),
        (NOTES, NOTE | {"text": "a\u202eb"}, "NOTE_REFUSED"),
        (NOTES, NOTE | {"at": [0, 1]}, "REQUEST_INVALID"),
        (NOTES, NOTE | {"at": [0, 1, "nan"]}, "REQUEST_INVALID"),
        (NOTES, NOTE | {"at": [0, 1, 1e400]}, "REQUEST_INVALID"),
        (NOTES, NOTE | {"at": [0, 1, 90]}, "NOTE_REFUSED"),
        (NOTES, NOTE | {"normal": [0, 0, 0]}, "NOTE_REFUSED"),
        (NOTES, NOTE | {"author": "Eve"}, "REQUEST_INVALID"),
        ("/v1/assets/shoe/notes", NOTE, "ASSET_UNKNOWN"),
        ("/v1/assets/.shoe/notes", NOTE, "KEY_INVALID"),
    ],
)
async def test_what_is_no_note_is_refused(tmp_path: Path, path: str, body: dict[str, Any], code: str) -> None:
    store = memory()
    publish(bundle(), store, key="dress")
    async with gateway(tmp_path / "gw", store) as client:
        headers = {"Content-Type": "application/json"}
        answer = await client.post(
            path,
            content=httpx.Request("POST", "http://a", json=_finite(body)).content.replace(b'"HUGE"', b"1e400"),
            headers=headers,
        )
        assert answer.json()["code"] == code
        assert (await client.get(NOTES)).json()["notes"] == []
        for bad in (UNKNOWN, "note_x"):
            answer = await client.patch(f"{NOTES}/{bad}", json={"text": "a"})
            assert answer.json()["code"] in ("NOTE_UNKNOWN", "REQUEST_INVALID")


def _finite(body: dict[str, Any]) -> dict[str, Any]:
    """A body that JSON can say; "HUGE" stands for a number that is none."""
    return {**body, "at": ["HUGE" if value == float("inf") else value for value in body["at"]]}


async def test_requests_at_once_lose_nothing(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "store")
    publish(bundle(), store, key="dress")
    async with gateway(tmp_path / "gw", store) as client:
        answers = await asyncio.gather(*[client.post(NOTES, json=NOTE | {"text": f"note {each}"}) for each in range(6)])
        assert [each.status_code for each in answers] == [201] * 6
        found = {each["text"] for each in (await client.get(NOTES)).json()["notes"]}
    assert found == {f"note {each}" for each in range(6)}


async def test_who_manages_it_pins_and_who_may_read_it_reads(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "store")
    publish_for(store, "ada", "dress", visibility=Visibility.PRIVATE)
    reader = make_key(tmp_path / "gw", "ada", {Scope.READ}, label="Reader")
    async with two_tenants(tmp_path, store) as site:
        assert (await site.anonymous.post(NOTES, json=NOTE)).status_code == 401
        assert (await site.bob.post(NOTES, json=NOTE)).status_code == 404
        refused = await site.anonymous.post(NOTES, json=NOTE, headers=bearer(reader))
        assert (refused.status_code, refused.json()["code"]) == (403, "SCOPE_MISSING")
        note = (await site.ada.post(NOTES, json=NOTE)).json()
        listed = (await site.anonymous.get(NOTES, headers=bearer(reader))).json()["notes"]
        assert listed == [note]
        params = {"tenant": "ada"}
        assert (await site.anonymous.get(NOTES, params=params)).status_code == 401
        link = (await site.ada.post("/v1/shares", json={"asset": "dress"})).json()["url"].rpartition("/")[2]
        visitor = {"Authorization": f"Share {link}"}
        seen = (await site.anonymous.get(NOTES, params=params, headers=visitor)).json()["notes"]
        assert seen == [note | {"author": ""}], "a visitor is not told who wrote it"
        for method, path in (("POST", NOTES), ("PATCH", f"{NOTES}/{note['id']}"), ("DELETE", f"{NOTES}/{note['id']}")):
            body = NOTE if method == "POST" else {"text": "Mine"}
            answer = await site.anonymous.request(method, path, json=body, params=params, headers=visitor)
            assert answer.status_code in (401, 403), method
        assert (await site.ada.get(NOTES)).json()["notes"] == [note]


async def test_the_author_is_the_keys_label(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "store")
    publish_for(store, "ada", "dress")
    phone = make_key(tmp_path / "gw", "ada", {Scope.READ, Scope.MANAGE}, label="Ada's phone")
    async with two_tenants(tmp_path, store) as site:
        answer = await site.anonymous.post(NOTES, json=NOTE, headers=bearer(phone))
        assert answer.json()["author"] == "Ada's phone"
