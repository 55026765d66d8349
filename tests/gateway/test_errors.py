"""Every no is a problem document, and none of them tells more than it should."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.gateway.app import create_app
from capture2vr.gateway.errors import Problem
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.storage.memory import MemoryStore
from tests.support.in_process_gateway import capture, gateway, listening, memory

JSON = {"Content-Type": "application/json"}
_SECRET = "/home/somebody/secret-4711"


@pytest.fixture
async def client(tmp_path: Path) -> AsyncIterator[httpx.AsyncClient]:
    async with gateway(tmp_path / "gw", memory()) as found:
        yield found


def problem(answer: httpx.Response) -> tuple[int, str]:
    """Status and code, once the rest is as RFC 9457 and the design ask for."""
    assert answer.headers["content-type"] == "application/problem+json"
    document = answer.json()
    assert document["status"] == answer.status_code
    assert {"type", "title", "detail", "code", "retryable", "hints"} <= document.keys()
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["x-request-id"]
    return answer.status_code, document["code"]


@pytest.mark.slow
async def test_what_the_framework_refuses(client: httpx.AsyncClient) -> None:
    assert problem(await client.get("/nowhere")) == (404, "NOT_FOUND")
    assert problem(await client.get("/web/nowhere.js")) == (404, "NOT_FOUND")
    assert problem(await client.get("/web/../app.py")) == (404, "NOT_FOUND")
    assert problem(await client.delete("/v1/jobs")) == (405, "METHOD_NOT_ALLOWED")
    assert problem(await client.post("/v1/jobs", content=b"{", headers=JSON)) == (422, "REQUEST_INVALID")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "status", "code"),
    [
        ({"asset_key": "dress"}, 422, "REQUEST_INVALID"),
        ({"capture": "cap_1", "asset_key": "dress", "colour": "red"}, 422, "REQUEST_INVALID"),
        ({"capture": "cap_1", "asset_key": "-x"}, 422, "KEY_INVALID"),
        ({"capture": "cap_1", "asset_key": "a/b"}, 422, "KEY_INVALID"),
        ({"capture": "cap_1", "asset_key": "dress", "preset": "nope"}, 422, "PRESET_UNKNOWN"),
        ({"capture": "cap_1", "asset_key": "dress", "preset": "generate"}, 422, "GENERATOR_ABSENT"),
        ({"capture": "cap_2", "asset_key": "dress"}, 404, "CAPTURE_UNKNOWN"),
        ({"capture": "../../etc/passwd", "asset_key": "dress"}, 404, "CAPTURE_UNKNOWN"),
        ({"capture": "", "asset_key": "dress"}, 404, "CAPTURE_UNKNOWN"),
        ({"capture": "cap\u0000", "asset_key": "dress"}, 404, "CAPTURE_UNKNOWN"),
    ],
)
async def test_what_cannot_become_a_job(client: httpx.AsyncClient, body: object, status: int, code: str) -> None:
    assert problem(await client.post("/v1/jobs", json=body)) == (status, code)
    assert (await client.get("/v1/jobs")).json()["jobs"] == []


async def test_an_unknown_preset_is_told_the_known_ones(client: httpx.AsyncClient) -> None:
    answer = await client.post("/v1/jobs", json={"capture": "cap_1", "asset_key": "dress", "preset": "nope"})
    assert "draft" in answer.json()["detail"]


async def test_one_key_one_job(tmp_path: Path) -> None:
    store = memory()
    async with gateway(tmp_path / "gw", store) as client:
        body = {"capture": capture(store), "asset_key": "dress"}
        headers = {"Idempotency-Key": "k-1"}
        first = await client.post("/v1/jobs", json=body, headers=headers)
        again = await client.post("/v1/jobs", json=body, headers=headers)
        assert first.headers["location"] == again.headers["location"] == f"/v1/jobs/{first.json()['id']}"
        other = await client.post("/v1/jobs", json={**body, "cut": "object"}, headers=headers)
        assert problem(other) == (409, "IDEMPOTENCY_CONFLICT")
        assert len((await client.get("/v1/jobs")).json()["jobs"]) == 1


async def test_a_body_that_is_too_large_is_refused_whatever_it_says_of_itself(client: httpx.AsyncClient) -> None:
    async def endless() -> AsyncIterator[bytes]:
        for _ in range(100):
            yield b" " * 4096

    assert problem(await client.post("/v1/jobs", content=b" " * 100_000)) == (413, "REQUEST_TOO_LARGE")
    assert problem(await client.post("/v1/jobs", content=endless())) == (413, "REQUEST_TOO_LARGE")


async def test_our_own_faults_tell_only_a_request_id(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    settings = GatewaySettings(data_dir=tmp_path, open=True)
    async with listening(_faulty(settings), settings) as url, httpx.AsyncClient(base_url=url) as client:
        answer = await client.get("/fault", headers={"X-Request-ID": "req-7"})
    assert problem(answer) == (500, "INTERNAL")
    assert "req-7" in answer.json()["detail"]
    assert _SECRET not in answer.text
    assert any(_SECRET in str(record.exc_info) for record in caplog.records)


async def test_a_request_id_cannot_smuggle(client: httpx.AsyncClient) -> None:
    answer = await client.get("/livez", headers={"X-Request-ID": "a b{}"})
    assert answer.headers["x-request-id"] != "a b{}"


@given(
    st.builds(
        Problem, st.sampled_from([400, 404, 422, 500, 503]), st.text(), st.text(), file=st.text(), stage=st.text()
    )
)
def test_any_problem_is_json(made: Problem) -> None:
    document = json.loads(bytes(made.response().body))
    assert document == made.document()
    assert ("file" in document) == bool(made.file)


def _faulty(settings: GatewaySettings) -> FastAPI:
    app = create_app(settings, MemoryStore())

    @app.get("/fault")
    async def fault() -> None:
        raise RuntimeError(_SECRET)

    return app
