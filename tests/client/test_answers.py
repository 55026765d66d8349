"""What a server answers that is no gateway, or one of another version: one line that says what was wrong."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import capture2vr
from capture2vr.cli.main import app
from capture2vr.errors import BadInput, GatewayError
from tests.support import captures

_FIELDS = (
    *(
        "asset",
        "asset_key",
        "assets",
        "base",
        "capture",
        "collection",
        "collections",
        "description",
        "detail",
        "effective",
    ),
    *(
        "elapsed_s",
        "ended",
        "error",
        "expires",
        "files",
        "fraction",
        "grade",
        "has_password",
        "id",
        "jobs",
        "keys",
        "kind",
    ),
    *(
        "label",
        "labels",
        "links",
        "manifest",
        "mode",
        "name",
        "next",
        "notes",
        "opened",
        "preview",
        "preset",
        "removed",
    ),
    *(
        "revoked",
        "scopes",
        "secret",
        "shares",
        "stage",
        "state",
        "tenant",
        "url",
        "version",
        "versions",
        "view",
        "warnings",
    ),
)
ODD: dict[str, Any] = {
    "nothing": {},
    "a list": [],
    "a text": "x",
    "null": None,
    "a number for every field": dict.fromkeys(_FIELDS, 1),
    "null for every field": dict.fromkeys(_FIELDS),
    "a list of numbers for every field": {field: [1] for field in _FIELDS},
    "an object for every field": {field: {} for field in _FIELDS},
    "pages without an end": {field: "x" if field == "next" else [] for field in _FIELDS},
}
COMMANDS = {
    "pull": ("pull", "leaf", "-o", "x"),
    "pull of a collection": ("pull", "leaf", "-o", "x", "--collection", "default"),
    "list": ("ls",),
    "push": ("push", "a.ply", "--key", "leaf"),
    "continue": ("push", "a.ply", "--continue", "leaf"),
    "remove": ("rm", "leaf"),
    "restore": ("restore", "leaf"),
    "keep": ("keep", "leaf"),
    "name": ("name", "leaf", "--label", "Leaf"),
    "notes": ("notes", "leaf"),
    "visibility": ("visibility", "leaf", "public"),
    "download": ("download", "leaf", "--format", "glb"),
    "keys": ("keys", "list"),
    "a new key": ("keys", "create", "--tenant", "ada"),
    "shares": ("shares", "list"),
    "a new share": ("shares", "create", "leaf"),
    "catalogue": ("catalogue", "verify"),
}


class _Answers(BaseHTTPRequestHandler):
    """Answers every request with the bytes that the server has."""

    def _answer(self) -> None:
        self.rfile.read(int(self.headers.get("Content-Length", 0)))
        content = self.server.content  # type: ignore[attr-defined]
        self.send_response(200)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    do_GET = do_POST = do_PUT = do_PATCH = do_DELETE = _answer  # noqa: N815 - as http.server calls them

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@contextmanager
def answering(content: bytes) -> Iterator[str]:
    """A server of these answers; its URL."""
    with ThreadingHTTPServer(("127.0.0.1", 0), _Answers) as server:
        server.content = content  # type: ignore[attr-defined]
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a capture, and an access key."""
    for variable in ("XDG_STATE_HOME", "XDG_CACHE_HOME"):
        monkeypatch.setenv(variable, str(tmp_path / variable))
    monkeypatch.setenv("CAPTURE2VR_KEY", "c2v_ada_x")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.ply").write_bytes(captures.ply_bytes(*captures.sphere()))
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("kind", ODD)
def test_a_command_says_in_a_line_what_was_wrong(kind: str, command: str) -> None:
    with answering(json.dumps(ODD[kind]).encode()) as gateway:
        result = CliRunner().invoke(app, [*COMMANDS[command], "--gateway", gateway])
    # An exit: `catalogue verify` prints what it has found.
    assert isinstance(result.exception, BadInput | SystemExit | None), (result.exception, result.output)
    assert "\n" not in str(result.exception)
    if kind in ("a list", "a text", "null"):
        assert "check the gateway's URL" in str(result.exception)


def test_the_field_that_is_missing_is_named() -> None:
    with answering(b"{}") as gateway:
        result = CliRunner().invoke(app, ["pull", "leaf", "-o", "x", "--gateway", gateway])
    assert "/v1/collections/default?form=tree answered without 'base'" in str(result.exception)


@pytest.mark.parametrize("kind", ODD)
def test_a_client_says_in_a_line_what_was_wrong(kind: str, folder: Path) -> None:
    with answering(json.dumps(ODD[kind]).encode()) as gateway, capture2vr.Client(gateway) as client:
        calls: list[Callable[[], object]] = [
            lambda: client.upload(folder / "a.ply"),
            lambda: client.start("cap_1", "leaf"),
            lambda: client.wait("job_1"),
            lambda: client.cancel("job_1"),
            lambda: list(client.jobs()),
            lambda: list(client.assets()),
            lambda: client.keep("leaf"),
            lambda: client.pull("leaf", folder / "x"),
            lambda: client.download("leaf", "glb", folder),
        ]
        for call in calls:
            with pytest.raises(GatewayError) as refused:
                call()
            assert "\n" not in str(refused.value)


def test_a_document_that_is_nested_too_deeply_is_none_of_a_gateway() -> None:
    with answering(b"[" * 100_000 + b"]" * 100_000) as gateway, capture2vr.Client(gateway) as client:
        assets = client.assets()
        with pytest.raises(GatewayError, match="not as a gateway does"):
            list(assets)
