"""Large captures are pushed to the end, whoever is killed on the way: the gateway, or the command itself."""

from __future__ import annotations

import hashlib
import os
import random
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import httpx
import pytest

from capture2vr.cli.progress import StageBar
from capture2vr.cli.remote import push
from capture2vr.cli.remote.push import push_capture
from capture2vr.client.upload import upload
from capture2vr.errors import BadInput
from capture2vr.gateway.workers.worker_client import INSPECT_S
from capture2vr.order.job_options import JobOptions
from capture2vr.process.archives import pack
from tests.support.gateway_process import running
from tests.support.patience import PATIENCE_S
from tests.support.repository import ROOT
from tests.support.tus import cloud

_MEGABYTE = 1 << 20
_PUSH = """
import sys, httpx
from pathlib import Path
from capture2vr.cli.progress import StageBar
from capture2vr.client.upload import upload
with httpx.Client(base_url=sys.argv[1]) as client, StageBar() as bar:
    upload(client, Path(sys.argv[2]), bar)
"""


@pytest.fixture
def capture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of 96 MB."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    path = tmp_path / "scan.ply"
    path.write_bytes(cloud(96 * _MEGABYTE))
    return path


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.slow
def test_a_gateway_that_is_killed_again_and_again(tmp_path: Path, capture: Path) -> None:
    with running(tmp_path) as gateway, httpx.Client(base_url=gateway.url) as client, StageBar() as bar:
        receipts: list[Any] = []
        pushing = threading.Thread(target=lambda: receipts.append(upload(client, capture, bar)))
        pushing.start()
        chance = random.Random(0)
        for stored in (1, 3, 6):
            gateway.wait_for_chunks(stored)
            time.sleep(chance.uniform(0, 0.05))
            gateway.restart()
        # Twice more wherever it is by then: it may be making the capture.
        for _ in range(2):
            gateway.wait_until_it_answers()
            time.sleep(chance.uniform(0.1, 0.6))
            if pushing.is_alive():
                gateway.restart()
        pushing.join(3 * PATIENCE_S)
        assert receipts
        assert gateway.the_one_file(tmp_path) == sha256(capture)
        assert [each["capture"] for each in gateway.captures()] == [receipts[0]["capture"]]
        assert gateway.chunks() == 0
        assert list((tmp_path / "state" / "capture2vr" / "uploads").iterdir()) == []


@pytest.mark.essential
@pytest.mark.slow
def test_a_push_that_is_killed_goes_on_when_it_is_started_again(tmp_path: Path, capture: Path) -> None:
    with running(tmp_path) as gateway:
        command = [sys.executable, "-c", _PUSH, gateway.url, str(capture)]
        first = subprocess.Popen(command, cwd=ROOT, env=os.environ, stderr=subprocess.DEVNULL)
        gateway.wait_for_chunks(4)
        first.kill()
        first.wait()
        before = gateway.chunks()
        second = subprocess.run(command, cwd=ROOT, env=os.environ, capture_output=True, text=True, check=True)
        assert "goes on at" in second.stderr
        assert before >= 4
        assert gateway.the_one_file(tmp_path) == sha256(capture)


@pytest.mark.slow
def test_a_push_without_a_folder_for_its_state_is_a_push_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "state").write_text("a file where the folder would be")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    path = tmp_path / "scan.ply"
    path.write_bytes(cloud(20 * _MEGABYTE))
    with running(tmp_path) as gateway, httpx.Client(base_url=gateway.url) as client, StageBar() as bar:
        upload(client, path, bar)
        assert gateway.the_one_file(tmp_path) == sha256(path)
    assert "if this push is cut off, the next one begins anew" in capsys.readouterr().err


@pytest.mark.slow
def test_a_job_that_is_refused_costs_no_second_upload(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    path = tmp_path / "scan.ply"
    path.write_bytes(cloud(20 * _MEGABYTE))
    with running(tmp_path) as gateway:

        def refused(**options: object) -> str:
            with pytest.raises(BadInput) as failure:
                push_capture(path, gateway.url, key="scan", options=JobOptions(**options))
            return str(failure.value)

        assert "there is no preset 'magic'" in refused(preset="magic")
        (capture,) = gateway.captures()
        assert "UPLOADING" in capsys.readouterr().err
        assert "there is no preset 'other'" in refused(preset="other")
        assert gateway.captures() == [capture]
        assert "goes on at 21.0 of 21.0 MB" in capsys.readouterr().err
        # The same bytes as the rest of another capture are another capture.
        with httpx.Client(base_url=gateway.url) as client, StageBar() as bar, pytest.raises(BadInput, match="continue"):
            upload(client, path, bar, continues=capture["capture"])
        httpx.delete(f"{gateway.url}/v1/captures/{capture['capture']}").raise_for_status()
        assert capture["capture"] in refused(preset="other")
        assert "there is no preset 'other'" in refused(preset="other")
        assert len(gateway.captures()) == 1


def test_a_wrong_key_is_told_before_anything_is_sent(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="'a/b' is not a valid asset key"):
        push_capture(tmp_path, "http://127.0.0.1:9", key="a/b")


def test_a_lost_answer_is_asked_for_again_and_the_addresses_that_are_printed_have_one_slash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    job = {"id": "job_1", "asset_key": "scan", "stage": "", "fraction": 1.0, "state": "SUCCEEDED", "elapsed_s": 1}
    job |= {"asset": {"state": "preview"}, "collection": "default", "capture": "cap_1"}

    asked: list[str] = []

    def answer(request: httpx.Request) -> httpx.Response:
        if request.url.path == "/v1/captures":  # a gateway waits for the inspection of a small file, too
            assert request.extensions["timeout"]["read"] > 2 * INSPECT_S
        if request.url.path == "/v1/jobs":
            asked.append(request.headers["Idempotency-Key"])
            if len(asked) < 2:
                raise httpx.ReadError("the gateway restarts")
        return httpx.Response(200, text="") if request.url.path.endswith("/events") else httpx.Response(200, json=job)

    transport = httpx.MockTransport(answer)
    monkeypatch.setattr(push, "open_gateway", lambda url, **_: httpx.Client(base_url=url, transport=transport))
    (tmp_path / "scan.ply").write_bytes(cloud(1000))
    push_capture(tmp_path / "scan.ply", "http://gateway:8080/", key="scan")
    assert capsys.readouterr().err.count("http://gateway:8080/view/scan") == 2
    assert len(asked) == 2
    assert len(set(asked)) == 1


@pytest.mark.slow
def test_what_the_gateway_refuses_is_told_and_deleted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    path = tmp_path / "broken.jpg"
    path.write_bytes(b"\xff\xd8\xff" + bytes(20 * _MEGABYTE))
    pack(path, tmp_path / "broken.zip")
    with running(tmp_path) as gateway, httpx.Client(base_url=gateway.url) as client, StageBar() as bar:
        for source in (path, tmp_path / "broken.zip"):
            with pytest.raises(BadInput, match=r"broken\.jpg"):
                upload(client, source, bar)
            assert gateway.chunks() == 0
        assert gateway.captures() == []
        assert list((tmp_path / "state" / "capture2vr" / "uploads").iterdir()) == []
