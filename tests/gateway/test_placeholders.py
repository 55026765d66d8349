"""A gateway that others can reach does not start with a secret that everybody knows."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from capture2vr.storage.settings import PLACEHOLDER_SECRET
from tests.support.patience import HANG_S
from tests.support.repository import ROOT


def start(folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a gateway that ends by itself: it cannot listen, where nothing else keeps it from starting."""
    given = {
        "GATEWAY_DATA_DIR": str(folder / "data"),
        "GATEWAY_HOST": "203.0.113.1",  # an address of documentation, which no machine has
        "STORAGE_KIND": "s3",
        "STORAGE_ENDPOINT": "http://127.0.0.1:9",
        "STORAGE_ACCESS_KEY": "capture2vr",
        "STORAGE_SECRET_KEY": PLACEHOLDER_SECRET,
    }
    command = [sys.executable, "-m", "capture2vr.gateway"]
    environment = {**os.environ, **given, **variables}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=HANG_S)


@pytest.mark.slow
@pytest.mark.parametrize("opened", ["", "true"])
def test_the_placeholder_is_refused_in_public_in_one_sentence(tmp_path: Path, opened: str) -> None:
    ended = start(tmp_path, GATEWAY_PUBLISHED_HOST="0.0.0.0", GATEWAY_OPEN=opened)
    assert ended.returncode == 2
    (line,) = ended.stderr.splitlines()
    assert "STORAGE_SECRET_KEY" in line
    assert "capture2vr deploy init" in line
    assert not (tmp_path / "data").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    "variables",
    [
        {"GATEWAY_PUBLISHED_HOST": "127.0.0.1"},
        {"GATEWAY_PUBLISHED_HOST": "0.0.0.0", "GATEWAY_OPEN": "true", "STORAGE_SECRET_KEY": "9" * 64},
    ],
)
def test_it_is_no_obstacle_on_loopback_and_a_secret_of_ones_own_is_none(
    tmp_path: Path, variables: dict[str, str]
) -> None:
    ended = start(tmp_path, **variables)
    assert ended.returncode == 1
    assert "STORAGE_SECRET_KEY" not in ended.stderr
    assert "cannot start" in ended.stderr
