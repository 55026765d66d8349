"""`capture2vr push --continue KEY`: photos are added to an asset's capture, and its next version is made."""

from __future__ import annotations

import threading
import time
import zipfile
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from capture2vr.cli.main import app
from capture2vr.cli.remote.push import continue_capture
from capture2vr.errors import BadInput
from capture2vr.storage.catalogue.publish import publish
from tests.support.gateway_process import GatewayProcess, running
from tests.support.patience import PATIENCE_S
from tests.support.things import RED, box


def photos(folder: Path, *names: str) -> Path:
    """A folder with photos of these names."""
    folder.mkdir()
    for number, name in enumerate(names):
        rgb = np.random.default_rng(number).integers(0, 256, (24, 32, 3), np.uint8)
        Image.fromarray(rgb).save(folder / name)
    return folder


def jobs(gateway: GatewayProcess) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = httpx.get(f"{gateway.url}/v1/jobs").json()["jobs"]
    return found


def await_job(gateway: GatewayProcess, count: int) -> dict[str, Any]:
    """The newest of so many jobs."""
    deadline = time.monotonic() + PATIENCE_S
    while len(found := jobs(gateway)) < count:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return found[0]


@pytest.mark.slow
def test_the_next_job_has_the_key_and_the_photos_of_both(tmp_path: Path) -> None:
    with running(tmp_path / "gateway") as gateway:
        with (photos(tmp_path / "first", "1.jpg", "2.jpg") / "1.jpg").open("rb") as file:
            first = httpx.post(f"{gateway.url}/v1/captures", files=[("files", ("1.jpg", file))]).json()
        order = {"capture": first["capture"], "asset_key": "dress", "label": "Dress", "cut": "object"}
        job = httpx.post(f"{gateway.url}/v1/jobs", json=order).json()
        publish(box("Dress", RED), gateway.store, key="dress", job=job["id"])
        more, failures = photos(tmp_path / "more", "1.jpg", "9.jpg"), []

        def push() -> None:
            try:
                continue_capture(more, gateway.url, key="dress", cut=None, edits=None)
            except BadInput as failure:
                failures.append(str(failure))

        pushing = threading.Thread(target=push)
        pushing.start()
        again = await_job(gateway, 2)
        assert (again["asset_key"], again["label"], again["cut"]) == ("dress", "Dress", "object")
        gateway.store.fetch(f"captures/{again['capture']}.zip", tmp_path / "stored.zip")
        with zipfile.ZipFile(tmp_path / "stored.zip") as archive:
            assert archive.namelist() == ["1-2.jpg", "1.jpg", "9.jpg"]
        httpx.post(f"{gateway.url}{again['links']['cancel']}")
        pushing.join(PATIENCE_S)
        assert failures == ["the job ended in state CANCELLED"]


@pytest.mark.slow
def test_an_asset_without_a_job_and_one_that_does_not_exist_are_said(tmp_path: Path) -> None:
    more = photos(tmp_path / "more", "1.jpg")
    with running(tmp_path / "gateway") as gateway:
        publish(box("Dress", RED), gateway.store, key="dress")
        with pytest.raises(BadInput, match="dress: no job of this gateway has made it"):
            continue_capture(more, gateway.url, key="dress", cut=None, edits=None)
        with pytest.raises(BadInput, match="nothing"):
            continue_capture(more, gateway.url, key="nothing", cut=None, edits=None)
        assert gateway.captures() == []


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "--key for a new capture, or --continue"),
        (["--key", "a", "--continue", "b"], "--key for a new capture, or --continue"),
        (["--continue", "b", "--preset", "fine", "--label", "B"], "the earlier job says preset, label"),
    ],
)
def test_options_that_do_not_go_together_are_refused(tmp_path: Path, options: list[str], words: str) -> None:
    found = CliRunner().invoke(app, ["push", str(tmp_path), *options])
    assert isinstance(found.exception, BadInput)
    assert words in str(found.exception)
