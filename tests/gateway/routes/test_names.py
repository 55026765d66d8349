"""PATCH /v1/assets/{key}: who may change the names of an asset, what they may be, and what a job gives it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from capture2vr.storage.catalogue.entry import read_entry
from capture2vr.storage.catalogue.publish import publish
from capture2vr.storage.local import LocalStore
from tests.gateway.routes.test_repeat_job import stored_order
from tests.support.bundles import bundle
from tests.support.in_process_gateway import capture, gateway, memory
from tests.support.tenants import publish_for, two_tenants

DRESS = "/v1/assets/dress"


async def test_names_are_changed_found_and_kept(tmp_path: Path) -> None:
    store = memory()
    publish(bundle(), store, key="dress")
    async with gateway(tmp_path / "gw", store) as client:
        markup = '<img src=x onerror="alert(1)">'
        answer = await client.patch(DRESS, json={"label": markup, "labels": ["summer", "Summer"]})
        assert answer.status_code == 200, answer.text
        assert (answer.json()["label"], answer.json()["labels"]) == (markup, ["summer"])
        found = (await client.get("/v1/collections/default/assets", params={"label": "SUMMER"})).json()["assets"]
        assert [(each["key"], each["label"]) for each in found] == [("dress", markup)]
        (summary,) = (await client.get("/v1/assets")).json()["assets"]
        assert summary["labels"] == ["summer"]
        answer = await client.patch(DRESS, json={"label": "", "description": "Wool.\nGrey."})
        assert (answer.json()["label"], answer.json()["description"]) == ("dress", "Wool.\nGrey.")
        entry = (await client.get(DRESS)).json()
        assert (entry["label"], entry["description"], entry["labels"]) == ("", "Wool.\nGrey.", ["summer"])


@pytest.mark.parametrize(
    ("path", "body", "code"),
    [
        (DRESS, {"label": "a" * 300}, "REQUEST_INVALID"),
        (DRESS, {"labels": ["a"] * 21}, "REQUEST_INVALID"),
        (DRESS, {"labels": [""]}, "REQUEST_INVALID"),
        (DRESS, {"label": "a\r\nb"}, "REQUEST_INVALID"),
        (DRESS, {"name": "a"}, "REQUEST_INVALID"),
        ("/v1/assets/shoe", {"label": "a"}, "ASSET_UNKNOWN"),
        ("/v1/assets/.shoe", {"label": "a"}, "KEY_INVALID"),
    ],
)
async def test_what_is_no_name_is_refused(tmp_path: Path, path: str, body: dict[str, Any], code: str) -> None:
    store = memory()
    publish(bundle(), store, key="dress")
    async with gateway(tmp_path / "gw", store) as client:
        answer = await client.patch(path, json=body)
        assert answer.json()["code"] == code
    assert read_entry(store, "dress").names.label == "Dress"


async def test_only_who_manages_it_names_it(tmp_path: Path) -> None:
    store = LocalStore(tmp_path / "store")
    publish_for(store, "ada", "dress")
    async with two_tenants(tmp_path, store) as site:
        assert (await site.anonymous.patch(DRESS, json={"label": "Mine"})).status_code == 401
        assert (await site.bob.patch(DRESS, json={"label": "Mine"})).status_code == 404
        assert (await site.ada.patch(DRESS, json={"label": "Mine"})).json()["label"] == "Mine"


async def test_a_job_carries_names_and_one_again_has_those_of_now(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        body = {"capture": capture(store), "asset_key": "dress", "label": "Dress", "labels": ["summer"]}
        first = (await client.post("/v1/jobs", json=body | {"description": "Wool."})).json()
        publish(bundle(label="Gown", labels=["winter"]), store, key="dress")
        again = (await client.post(first["links"]["again"], json={"cut": "scene"})).json()
        bad = await client.post("/v1/jobs", json=body | {"labels": ["a" * 51]})
        assert (bad.status_code, bad.json()["code"]) == (422, "REQUEST_INVALID")
    orders = [stored_order(tmp_path / "gw", each["id"]).options.names for each in (first, again)]
    assert [(each.label, each.description, each.labels) for each in orders] == [
        ("Dress", "Wool.", ("summer",)),
        ("Gown", "", ("winter",)),
    ]
