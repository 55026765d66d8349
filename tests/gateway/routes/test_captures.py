"""Stored captures in their owner's hands: listed, read, downloaded, and deleted for good."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import httpx
import pytest

from capture2vr.gateway.jobs.capture_objects import capture_name, receipt_name
from tests.support.in_process_gateway import gateway, memory

CLOUD = b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n"


async def uploaded(client: httpx.AsyncClient, name: str = "") -> dict[str, Any]:
    files = [("files", ("a.ply", CLOUD, "application/octet-stream"))]
    answer = await client.post("/v1/captures", files=files, data={"name": name})
    assert answer.status_code == 201, answer.text
    receipt: dict[str, Any] = answer.json()
    return receipt


async def listed(client: httpx.AsyncClient, **query: object) -> dict[str, Any]:
    answer = await client.get("/v1/captures", params={name: str(value) for name, value in query.items()})
    assert answer.status_code == 200, answer.text
    page: dict[str, Any] = answer.json()
    return page


async def test_all_are_listed_page_by_page_and_once(tmp_path: Path) -> None:
    async with gateway(tmp_path, memory()) as client:
        sent = [(await uploaded(client, f"number {number}"))["capture"] for number in range(5)]
        found: list[str] = []
        after = ""
        for _ in range(4):
            page = await listed(client, limit=2, after=after)
            found += [each["capture"] for each in page["captures"]]
            if (after := page["next"] or "") == "":
                break
        assert sorted(sent) == found
        assert {each["name"] for each in (await listed(client))["captures"]} == {f"number {n}" for n in range(5)}


async def test_the_receipt_and_the_archive_are_those_of_the_upload(tmp_path: Path) -> None:
    async with gateway(tmp_path, memory()) as client:
        receipt = await uploaded(client)
        (summary,) = (await listed(client))["captures"]
        assert (await client.get(summary["self"])).json() == receipt
        archive = await client.get(summary["archive"])
        assert (archive.status_code, archive.headers["content-type"]) == (200, "application/zip")
        assert archive.headers["cache-control"] == "private, no-store"
        assert len(archive.content) == receipt["bytes"]
        assert zipfile.ZipFile(io.BytesIO(archive.content)).read("a.ply") == CLOUD


async def test_a_deleted_capture_is_gone_and_cannot_be_used(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path, store) as client:
        receipt, other = await uploaded(client), await uploaded(client)
        url = f"/v1/captures/{receipt['capture']}"
        answer = await client.delete(url)
        assert answer.status_code == 200, answer.text
        assert answer.json()["bytes"] > receipt["bytes"]
        assert [each["capture"] for each in (await listed(client))["captures"]] == [other["capture"]]
        for gone in (client.delete(url), client.get(url), client.get(f"{url}/archive")):
            refused = await gone
            assert (refused.status_code, refused.json()["code"]) == (404, "CAPTURE_UNKNOWN")
        refused = await client.post("/v1/jobs", json={"capture": receipt["capture"], "asset_key": "dress"})
        assert (refused.status_code, refused.json()["code"]) == (404, "CAPTURE_UNKNOWN")
        assert [head.name for head in store.list("captures/") if receipt["capture"] in head.name] == []


async def test_a_capture_that_a_job_needs_is_kept(tmp_path: Path) -> None:
    async with gateway(tmp_path, memory()) as client:
        receipt = await uploaded(client)
        job = (await client.post("/v1/jobs", json={"capture": receipt["capture"], "asset_key": "dress"})).json()
        url = f"/v1/captures/{receipt['capture']}"
        refused = await client.delete(url)
        assert (refused.status_code, refused.json()["code"]) == (409, "CAPTURE_IN_USE")
        assert job["id"] in refused.json()["detail"]
        assert (await client.get(url)).status_code == 200
        await client.post(f"/v1/jobs/{job['id']}/cancel")
        assert (await client.delete(url)).status_code == 200


async def test_a_half_deleted_capture_can_be_deleted_again(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path, store) as client:
        capture = (await uploaded(client))["capture"]
        store.delete(capture_name(capture))
        assert [each["capture"] for each in (await listed(client))["captures"]] == [capture]
        assert (await client.delete(f"/v1/captures/{capture}")).status_code == 200
        assert (await listed(client))["captures"] == []


@pytest.mark.slow
@pytest.mark.parametrize("content", [b"{", b"[]", b'{"capture": "cap_other"}', b'{"capture": "ID", "bytes": "x"}'])
async def test_a_damaged_receipt_is_named_and_the_others_are_listed(tmp_path: Path, content: bytes) -> None:
    store = memory()
    async with gateway(tmp_path, store) as client:
        broken, whole = (await uploaded(client))["capture"], (await uploaded(client))["capture"]
        store.put(receipt_name(broken), content.replace(b"ID", broken.encode()), content_type="application/json")
        page = await listed(client)
        assert ([each["capture"] for each in page["captures"]], page["damaged"]) == ([whole], [broken])
        refused = await client.get(f"/v1/captures/{broken}")
        assert (refused.status_code, refused.json()["code"]) == (503, "CAPTURE_DAMAGED")
        assert (await client.delete(f"/v1/captures/{broken}")).status_code == 200


@pytest.mark.parametrize("capture", ["cap_unknown", "-", "_"])
async def test_an_unknown_capture_is_a_404(tmp_path: Path, capture: str) -> None:
    async with gateway(tmp_path, memory()) as client:
        for answer in (await client.get(f"/v1/captures/{capture}"), await client.delete(f"/v1/captures/{capture}")):
            assert (answer.status_code, answer.json()["code"]) == (404, "CAPTURE_UNKNOWN")
