"""What a fit is said to take, against what it takes: each in a process of its own, so that nothing is warm."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from textwrap import dedent

import pytest

from capture2vr.edge.field.config import AnchorConfig
from capture2vr.edge.paper_field.memory_estimate import evaluation_bytes, fit_memory_bytes
from capture2vr.edge.paper_field.network_config import NetworkConfig

ANCHORS = AnchorConfig(steps=2, learning_rate=0.1)
NETWORK = NetworkConfig(steps=2, warm_up=1, batch=5_000, pool=200_000)


def bytes_taken(script: str, **environment: str) -> int:
    """The most bytes that `work()` of the script holds beyond what its process held before it."""
    measured = """
        from pathlib import Path

        def kept(name):  # of /proc: VmRSS now, VmHWM at most since it was cleared
            lines = Path("/proc/self/status").read_text().splitlines()
            return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(name))

        Path("/proc/self/clear_refs").write_text("5")
        before = kept("VmRSS")
        work()
        print(kept("VmHWM") - before)
    """
    command = [sys.executable, "-c", dedent(script) + dedent(measured)]
    environment = {**os.environ, **environment}
    return int(subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("config", "points"), [(ANCHORS, 20_000), (NETWORK, 5_000), (replace(NETWORK, batch=2_000, neighbours=6), 5_000)]
)
def test_a_fit_takes_about_what_is_said(config: AnchorConfig | NetworkConfig, points: int) -> None:
    fit = "fit_anchors" if isinstance(config, AnchorConfig) else "fit_network"
    script = f"""
        from capture2vr.edge.field.anchor_fit import fit_anchors
        from capture2vr.edge.field.config import AnchorConfig
        from capture2vr.edge.field.local import local_field
        from capture2vr.edge.paper_field.network_config import NetworkConfig
        from capture2vr.edge.paper_field.network_fit import fit_network
        from tests.support import surfaces

        xyz = surfaces.sampled(surfaces.pleated_skirt(), {points})
        base = local_field(xyz)
        def work():
            for step in {fit}(xyz, {config!r}, base=base):
                pass
    """
    assert 0.5 < fit_memory_bytes(points, config) / bytes_taken(script) < 2


@pytest.mark.slow
@pytest.mark.parametrize("config", [NETWORK, replace(NETWORK, model="mlp")])
def test_what_a_gpu_is_asked_at_once_takes_about_what_is_said(config: NetworkConfig) -> None:
    script = f"""
        import torch
        from capture2vr.edge.paper_field.network_config import GPU_CHUNK, NetworkConfig
        from capture2vr.edge.paper_field.networks import network_of

        network = network_of({config!r})
        with torch.no_grad():
            network.value_and_gradient(torch.rand(100, 3))
        def work():
            with torch.no_grad():
                network.value_and_gradient(torch.rand(GPU_CHUNK, 3))
    """
    # Every freed tensor is given back at once. By default glibc comes to keep those of up to 32 MB, in numbers that
    # vary from run to run by half of what is measured; a GPU's allocator uses them again.
    taken = bytes_taken(script, MALLOC_MMAP_THRESHOLD_=str(1 << 16))
    assert 0.7 < evaluation_bytes(config) / taken < 1.5
    assert fit_memory_bytes(1_000, config, "cuda:0") > taken + fit_memory_bytes(1_000, config)


def test_memory_grows_with_the_points_and_a_gpu_holds_more_at_once() -> None:
    for config in (ANCHORS, NETWORK):
        taken = [fit_memory_bytes(points, config) for points in (1_000, 10_000, 100_000)]
        assert taken == sorted(taken)
        assert fit_memory_bytes(10_000, config, "cuda:0") > taken[1]
