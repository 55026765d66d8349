from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Barrier

import numpy as np
import pytest
import torch

from capture2vr.edge.arrays import Floats
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.field import device
from capture2vr.edge.field.device import find_device, own_stream
from capture2vr.edge.paper_field.network_config import NetworkConfig
from capture2vr.edge.paper_field.network_fit import fit_network
from capture2vr.edge.preset import load_preset
from tests.support import surfaces

_FIND = """
import sys
from capture2vr.edge.field.device import find_device
find_device("auto")
print("torch" in sys.modules)
"""


@pytest.mark.skipif(
    any(Path(file).exists() for file in device._DRIVER_FILES), reason="there is a GPU's driver, which torch has to see"
)
def test_auto_loads_no_torch_where_no_driver_is() -> None:
    done = subprocess.run([sys.executable, "-c", _FIND], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_auto_asks_torch_where_a_driver_may_be(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked = []
    monkeypatch.setattr(torch.cuda, "is_available", lambda: asked.append(True) or False)
    monkeypatch.setattr(device, "_DRIVER_FILES", (str(tmp_path / "none"), str(tmp_path)))
    assert find_device("auto").name == "cpu"
    assert asked


@pytest.mark.parametrize("wanted", ["cuda:99", "gpu", "cuda:"])
def test_absent_device(wanted: str) -> None:
    with pytest.raises(EdgeError, match=wanted):
        find_device(wanted)


def test_jobs_at_the_same_time_have_a_stream_each_and_later_ones_use_them_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: list[str] = []
    entered: list[int] = []
    both = Barrier(2)

    def new_stream(of: str) -> int:
        made.append(of)
        return len(made)

    @contextmanager
    def enter(stream: int) -> Iterator[None]:
        entered.append(stream)
        yield

    monkeypatch.setattr(torch.cuda, "Stream", new_stream)
    monkeypatch.setattr(torch.cuda, "stream", enter)
    monkeypatch.setattr(device, "_idle_streams", {})

    def job(number: int) -> None:
        with own_stream("cuda:1"):
            both.wait(30)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(job, range(2)))
    assert sorted(entered) == [1, 2]
    with pytest.raises(ValueError, match="the job failed"), own_stream("cuda:1"):
        raise ValueError("the job failed")
    with own_stream("cuda:1"), own_stream("cpu"):
        assert made == ["cuda:1"] * 2
    with own_stream("cuda:0"):
        assert made == ["cuda:1"] * 2 + ["cuda:0"]


@pytest.mark.gpu
def test_a_job_in_its_own_stream_trains_the_same_field_as_alone() -> None:
    if not torch.cuda.is_available():
        pytest.skip("there is no CUDA device")
    points = surfaces.sampled(surfaces.hemisphere(), 1_000)
    config = load_preset("paper").fit
    assert isinstance(config, NetworkConfig)
    config = replace(config, steps=60, warm_start=0, batch=256, pool=20_000)
    where: list[int] = []

    def job(number: int) -> Floats:
        with own_stream("cuda:0"):
            where.append(torch.cuda.current_stream().cuda_stream)
            *_, last = fit_network(points, replace(config, seed=number), device="cuda:0")
            return last.field(points)[0]

    alone = [job(number) for number in range(4)]
    where.clear()
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(job, range(4)))
    assert len(set(where)) == 4
    assert torch.cuda.default_stream().cuda_stream not in where
    for each, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(each, other)
