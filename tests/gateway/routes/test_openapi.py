"""The OpenAPI document holds: whatever fits it, or nearly fits it, is answered as it says."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import uvicorn
from hypothesis import HealthCheck, given, settings

from capture2vr.gateway.app import create_app
from capture2vr.gateway.settings import GatewaySettings
from tests.support.in_process_gateway import capture, memory
from tests.support.workers.inspecting_worker import inspecting_worker

if TYPE_CHECKING:  # loaded by the tests alone: it takes seconds
    import schemathesis

_NOT_ASKED = {
    "/v1/jobs/{job}/events",  # waits for the job's end
    "/v1/scenes/{scene}/events",  # has no end
    "/readyz",  # says 503 without a worker, as it should
}


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[object]:
    import schemathesis

    # The bodies of tus are bytes.
    schemathesis.serializer.alias("application/offset+octet-stream", "application/octet-stream")
    store = memory()
    capture(store)
    folder: Path = tmp_path_factory.mktemp("gateway")
    app = create_app(GatewaySettings(data_dir=folder, workers=(inspecting_worker(),)), store)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        server = uvicorn.Server(uvicorn.Config(app, log_config=None, ws="none"))
        thread = threading.Thread(target=server.run, args=([listening],))
        thread.start()
        yield schemathesis.openapi.from_url(f"http://127.0.0.1:{listening.getsockname()[1]}/openapi.json")
        server.should_exit = True
        thread.join()


@pytest.mark.slow
def test_answers_are_as_documented(api: schemathesis.BaseSchema) -> None:
    for result in api.get_all_operations():
        operation = result.ok()
        if operation.path not in _NOT_ASKED:
            _check(operation)


def _check(operation: schemathesis.APIOperation) -> None:
    from schemathesis.checks import not_a_server_error
    from schemathesis.specs.openapi import checks

    # Schemathesis' own pytest plugin does not know this pytest; its strategies need no plugin.
    @settings(max_examples=20, suppress_health_check=list(HealthCheck))
    @given(case=operation.as_strategy())
    def holds(case: schemathesis.Case) -> None:
        case.call_and_validate(
            checks=[
                not_a_server_error,
                checks.status_code_conformance,
                checks.content_type_conformance,
                checks.response_schema_conformance,
            ]
        )

    holds()


def test_no_schema_is_a_tuple(api: schemathesis.BaseSchema) -> None:
    # Many generators of clients, and the one above, do not know `prefixItems`.
    assert "prefixItems" not in json.dumps(api.raw_schema)


def test_every_route_says_what_it_is_for(api: schemathesis.BaseSchema) -> None:
    for path, operations in api.raw_schema["paths"].items():
        for method, operation in operations.items():
            assert operation.get("description"), f"{method} {path}"
