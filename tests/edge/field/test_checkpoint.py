"""A killed fit goes on where it was; a file that is not its own does not disturb it."""

from __future__ import annotations

import logging
import os
import resource
import signal
import subprocess
import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch

from capture2vr.edge.arrays import Floats
from capture2vr.edge.field import checkpoint as checkpoints
from capture2vr.edge.field.local import local_field
from capture2vr.edge.paper_field.network_config import Densify, NetworkConfig
from capture2vr.edge.paper_field.network_fit import fit_network
from tests.support import surfaces
from tests.support.repository import ROOT

POINTS = surfaces.sampled(surfaces.disk(), 300)
HELD_OUT = surfaces.sampled(surfaces.disk(), 50, seed=1)
CONFIG = NetworkConfig(steps=60, warm_start=10, batch=64, pool=1_500, patience=1_000)
CONFIG = replace(CONFIG, densify=Densify(steps=10, batch=96, field_below=1.0, farthest=0.1))


@pytest.fixture(autouse=True)
def _write_every_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoints, "SECONDS", 0.0)


def fitted(path: Path | None, config: NetworkConfig = CONFIG, stop_at: int | None = None) -> tuple[Floats, list[int]]:
    """The field's distances at the points, and the numbers of the steps that ran."""
    numbers: list[int] = []
    steps = fit_network(POINTS, config, base=local_field(POINTS), held_out=HELD_OUT, checkpoint=path)
    for step in steps:
        if step.losses:
            numbers.append(step.number)
        if step.number == stop_at:
            steps.close()
    return step.field(POINTS)[0], numbers


@pytest.fixture(scope="module")
def straight() -> Floats:
    return fitted(None)[0]


@pytest.mark.slow
@pytest.mark.parametrize("stop_at", [7, 50, 75])
def test_a_resumed_fit_is_the_uninterrupted_one(stop_at: int, straight: Floats, tmp_path: Path) -> None:
    path = tmp_path / "fit"
    fitted(path, stop_at=stop_at)
    resumed, numbers = fitted(path)
    assert numbers == list(range(stop_at + 1, 81))
    np.testing.assert_array_equal(resumed, straight)


@pytest.mark.slow
def test_a_finished_fit_resumes_to_its_end_at_once(straight: Floats, tmp_path: Path) -> None:
    path = tmp_path / "fit"
    fitted(path)
    resumed, numbers = fitted(path)
    assert numbers == [80]
    np.testing.assert_array_equal(resumed, straight)


@pytest.mark.slow
def test_how_often_it_is_written_changes_nothing(
    straight: Floats, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoints, "SECONDS", 1e9)
    np.testing.assert_array_equal(fitted(tmp_path / "fit")[0], straight)
    assert not (tmp_path / "fit").exists()


def test_a_folder_that_an_older_lease_took_along_is_made_again(tmp_path: Path) -> None:
    path = tmp_path / "job_1" / "2.checkpoint"
    checkpoints.save(path, {"done": 3}, "mark")
    assert checkpoints.load(path, "mark", torch.device("cpu")) == {"done": 3}


def test_a_full_disk_is_an_error_of_the_system_and_the_old_file_stays(tmp_path: Path) -> None:
    path = tmp_path / "fit"
    checkpoints.save(path, {"done": 3}, "mark")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))  # a file that reaches it cannot grow, as on a full disk
    try:
        with pytest.raises(OSError, match="too large"):
            checkpoints.save(path, {"weights": torch.zeros(100_000)}, "mark")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert checkpoints.load(path, "mark", torch.device("cpu")) == {"done": 3}
    assert [each.name for each in tmp_path.iterdir()] == ["fit"]


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 torn", b"\x80\x02.", None])
def test_a_broken_file_is_reported_and_replaced(
    content: bytes | None, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "fit"
    fitted(path, stop_at=5)
    path.write_bytes(path.read_bytes()[:-200] if content is None else content)
    with caplog.at_level(logging.WARNING):
        assert fitted(path, stop_at=3)[1] == [1, 2, 3]
    assert "starts from the beginning" in caplog.text
    assert fitted(path, stop_at=5)[1] == [4, 5]


def test_a_file_of_another_fit_is_ignored(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "fit"
    fitted(path, stop_at=5)
    with caplog.at_level(logging.WARNING):
        assert fitted(path, replace(CONFIG, seed=1), stop_at=1)[1] == [1]
    assert "other points or settings" in caplog.text


def test_a_checkpoint_runs_no_code(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    import torch

    torch.save({"fingerprint": "x", "done": Path}, tmp_path / "fit")
    assert checkpoints.load(tmp_path / "fit", "x", torch.device("cpu")) is None
    assert "starts from the beginning" in caplog.text


_CHILD = """
import sys
from pathlib import Path
from capture2vr.edge.field import checkpoint
from tests.edge.field.test_checkpoint import CONFIG, HELD_OUT, POINTS, fit_network, local_field
checkpoint.SECONDS = 0.05
for step in fit_network(POINTS, CONFIG, base=local_field(POINTS), held_out=HELD_OUT, checkpoint=Path(sys.argv[1])):
    print(step.number, flush=True)
"""


@pytest.mark.slow
def test_kill_9_in_mid_fit(straight: Floats, tmp_path: Path) -> None:
    path = tmp_path / "fit"
    child = subprocess.Popen([sys.executable, "-c", _CHILD, path], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert child.stdout is not None
    with child, child.stdout:
        for line in islice(child.stdout, 500):
            if int(line) == 20:
                break
        os.kill(child.pid, signal.SIGKILL)
    assert child.returncode == -signal.SIGKILL
    resumed, numbers = fitted(path)
    assert 1 < numbers[0] < 80
    np.testing.assert_allclose(resumed, straight, atol=1e-6)
