"""The fit as a caller sees it: it learns, repeats, ends, and says what went wrong."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from capture2vr.edge.arrays import Floats
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.field import checkpoint
from capture2vr.edge.field.compute import capture_step, open_device, translate_memory_errors
from capture2vr.edge.field.local import local_field
from capture2vr.edge.field.step import STEPS_BEFORE_CAPTURE, Step
from capture2vr.edge.paper_field.network_config import Densify, NetworkConfig
from capture2vr.edge.paper_field.network_fit import fit_network
from capture2vr.edge.paper_field.network_run import learning_rate
from tests.support import surfaces

POINTS = surfaces.sampled(surfaces.disk(), 400)
QUICK = NetworkConfig(steps=12, batch=128, pool=2_000)


def last(steps: object) -> Step:
    *_, step = steps  # type: ignore[misc]
    return step  # type: ignore[no-any-return, has-type]


def distances(step: Step, queries: Floats = POINTS) -> Floats:
    return step.field(queries)[0]


@pytest.mark.slow
def test_a_short_fit_learns_the_surface_and_which_way_is_away() -> None:
    base = local_field(POINTS)
    config = replace(QUICK, steps=60, warm_start=60, batch=256, pool=8_000, learning_rate=3e-3)
    step = last(fit_network(POINTS, config, base=base))
    assert step.number == step.of == 120
    assert distances(step).mean() < 0.03  # the points lie 0.044 apart
    above = POINTS[np.linalg.norm(POINTS, axis=1) < 0.4] + [0, 0, 0.05]
    f, gradient = step.field(above)
    assert np.abs(f - 0.05).mean() < 0.015
    assert (gradient[:, 2] > 0.9).mean() > 0.9


def test_every_step_says_where_it_stands_and_the_pool_comes_first() -> None:
    steps = list(fit_network(POINTS, QUICK))
    assert [step.number for step in steps if step.losses] == list(range(1, 13))
    assert steps[0].number == 0
    assert not steps[0].losses
    named = {"total", "chamfer", "projection", "orthogonality", "surface", "self_consistency"}
    assert set(steps[-1].losses) == named
    assert set(last(fit_network(POINTS, replace(QUICK, steps=1, far_share=0.05))).losses) == named | {"far"}


def test_a_loss_without_weight_is_not_computed() -> None:
    config = replace(QUICK, projection=0, orthogonality=0, self_consistency=0, far_share=0, surface=0.1, steps=1)
    assert set(last(fit_network(POINTS, config)).losses) == {"total", "chamfer", "surface"}


READINGS: dict[str, NetworkConfig] = {
    "distances of a pair": replace(QUICK, pairs="distance"),
    "the printed sign": replace(QUICK, sign="printed"),
    "log(1/ω) an input": replace(QUICK, certainty="input"),
    "a kernel of 3": replace(QUICK, neighbours=6),
}


@pytest.mark.slow
@pytest.mark.parametrize("config", READINGS.values(), ids=READINGS)
def test_every_reading_of_the_equations_trains_and_goes_on_where_it_was_killed(
    config: NetworkConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoint, "SECONDS", 0.0)
    whole = last(fit_network(POINTS, config))
    assert whole.losses["total"] < next(s for s in fit_network(POINTS, config) if s.losses).losses["total"]
    killed = fit_network(POINTS, config, checkpoint=tmp_path / "fit.pt")
    next(step for step in killed if step.number == 7)
    killed.close()
    steps = list(fit_network(POINTS, config, checkpoint=tmp_path / "fit.pt"))
    assert min(step.number for step in steps if step.losses) == 8
    np.testing.assert_allclose(distances(steps[-1]), distances(whole), atol=1e-6)
    # Another unit of the points draws other anchors: that fit starts anew.
    other = fit_network(POINTS, config, checkpoint=tmp_path / "fit.pt", metres=0.01)
    assert min(step.number for step in islice(other, 40) if step.losses) == 1


def test_a_fit_killed_behind_its_last_step_yields_that_step_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checkpoint, "SECONDS", 0.0)
    whole = last(fit_network(POINTS, QUICK, checkpoint=tmp_path / "fit.pt"))
    again = last(fit_network(POINTS, QUICK, checkpoint=tmp_path / "fit.pt"))
    assert (again.number, again.of, again.losses) == (whole.number, whole.of, whole.losses)
    np.testing.assert_array_equal(distances(again), distances(whole))


@pytest.mark.slow
def test_a_seed_gives_one_field_whatever_other_fits_run_beside_it() -> None:
    expected = distances(last(fit_network(POINTS, QUICK)))
    beside = threading.Thread(target=lambda: last(fit_network(POINTS, replace(QUICK, seed=3))))
    beside.start()
    np.testing.assert_array_equal(distances(last(fit_network(POINTS, QUICK))), expected)
    beside.join()
    assert np.abs(distances(last(fit_network(POINTS, replace(QUICK, seed=1)))) - expected).max() > 1e-4


def test_whoever_stops_iterating_ends_the_fit_and_keeps_the_field() -> None:
    steps = fit_network(POINTS, QUICK)
    field = next(islice(steps, 5, None)).field
    steps.close()
    assert field(POINTS)[0].shape == (400,)


@pytest.mark.slow
def test_patience_ends_a_fit_that_gets_no_better_on_points_it_does_not_see() -> None:
    config = replace(QUICK, steps=1_000, learning_rate=1e-12, patience=50, batch=32, pool=500)
    held_out = surfaces.sampled(surfaces.disk(), 50, seed=1)
    steps = [step for step in fit_network(POINTS, config, held_out=held_out) if step.losses]
    assert steps[-1].number == 100  # the first look is at 50


def test_the_densification_adds_steps_and_a_larger_batch() -> None:
    config = replace(QUICK, steps=4, densify=Densify(steps=3, batch=256, farthest=0.1, field_below=1.0))
    step = last(fit_network(POINTS, config))
    assert step.number == step.of == 7
    assert step.losses["total"] > 0


def test_a_diverging_fit_is_named() -> None:
    with pytest.raises(EdgeError) as raised:
        last(fit_network(POINTS, replace(QUICK, steps=200, learning_rate=1e4)))
    assert raised.value.code == "FIT_DIVERGED"
    assert "preview" in raised.value.hints[0]


def test_too_few_points_are_named_and_bad_arguments_refused() -> None:
    with pytest.raises(EdgeError) as raised:
        next(fit_network(POINTS[:50], QUICK))
    assert raised.value.code == "FIT_TOO_FEW_POINTS"
    with pytest.raises(ValueError, match="not finite"):
        next(fit_network(np.where(POINTS > 0.49, np.nan, POINTS), QUICK))
    with pytest.raises(ValueError, match="base"):
        next(fit_network(POINTS, replace(QUICK, warm_start=5)))
    with pytest.raises(ValueError, match="held-out"):
        next(fit_network(POINTS, replace(QUICK, patience=5)))


def test_a_device_that_is_not_there_is_named() -> None:
    with pytest.raises(EdgeError) as raised:
        open_device("cuda:63")
    assert raised.value.code == "DEVICE_ABSENT"


def test_memory_that_is_not_there_is_named_and_worth_a_retry() -> None:
    def more_than_there_is() -> None:
        torch.empty(1 << 58, dtype=torch.uint8)

    def as_a_gpu_says_it() -> None:
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 9 GiB.")

    for allocate in (more_than_there_is, as_a_gpu_says_it):
        with pytest.raises(EdgeError) as raised, translate_memory_errors("this fit"):
            allocate()
        assert raised.value.code == "GPU_OOM"
        assert raised.value.retryable
        assert raised.value.hints
    with pytest.raises(RuntimeError, match="another"), translate_memory_errors("this fit"):
        raise RuntimeError("another")


def test_the_rate_rises_and_falls_twice() -> None:
    config = NetworkConfig(steps=1_000, warm_start=100, warm_up=1_000, learning_rate=1.0)
    rates = [learning_rate(step, config) for step in range(config.total_steps)]
    assert max(rates) == 1.0
    assert rates[99] < 0.01
    assert rates[100] == 0.01  # a tenth of the steps, where warm_up asks for more
    assert rates[-1] < 1e-5
    assert all(a >= b for a, b in pairwise(rates[200:]))


def test_fits_capture_one_at_a_time_each_on_a_stream_of_its_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    streams, inside = [], []

    @contextmanager
    def capture(graph: object, *, stream: str, capture_error_mode: str) -> Iterator[None]:
        inside.append(stream)
        assert len(inside) == 1
        time.sleep(0.01)
        yield
        inside.pop()

    def stream_of(device: torch.device) -> str:
        streams.append(str(device))
        return f"of {device}"

    monkeypatch.setattr(torch.cuda, "CUDAGraph", lambda: SimpleNamespace(replay="the replay"))
    monkeypatch.setattr(torch.cuda, "graph", capture)
    monkeypatch.setattr(torch.cuda, "Stream", stream_of)
    monkeypatch.setattr(torch.cuda, "stream", nullcontext)
    with ThreadPoolExecutor(4) as pool:
        runs = list(pool.map(lambda _: capture_step(lambda: None, torch.device("cuda:1")), range(4)))
    assert runs == ["the replay"] * 4
    assert streams == ["cuda:1"] * 4


@pytest.mark.gpu
def test_a_captured_fit_repeats_and_its_first_steps_are_those_of_the_cpu() -> None:
    if not torch.cuda.is_available():
        pytest.skip("there is no CUDA device")
    config = replace(QUICK, steps=30, densify=Densify(steps=10, batch=256, farthest=0.1, field_below=1.0))
    first, second = (distances(last(fit_network(POINTS, config, device="cuda"))) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    # Three steps are replayed from the graph. Rounding grows a hundredfold in five steps: weights that differ by 1e-7
    # give distances that differ by 0.2 after twenty.
    short = replace(QUICK, steps=STEPS_BEFORE_CAPTURE + 3)
    on_gpu, on_cpu = (distances(last(fit_network(POINTS, short, device=device))) for device in ("cuda", "cpu"))
    np.testing.assert_allclose(on_gpu, on_cpu, atol=1e-2)
