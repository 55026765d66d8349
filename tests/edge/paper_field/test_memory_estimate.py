"""What a fit is said to take, against what it takes: each in a process of its own, so that nothing is warm."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from textwrap import dedent

import pytest

from services.edge.field.config import AnchorConfig
from services.edge.paper_field.memory_estimate import fit_memory_bytes
from services.edge.paper_field.network_config import NetworkConfig

ANCHORS = AnchorConfig(steps=2, learning_rate=0.1)
NETWORK = NetworkConfig(steps=2, warm_up=1, batch=5_000, pool=200_000)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("config", "points"), [(ANCHORS, 20_000), (NETWORK, 5_000), (replace(NETWORK, batch=2_000, neighbours=6), 5_000)]
)
def test_a_fit_takes_about_what_is_said(config: AnchorConfig | NetworkConfig, points: int) -> None:
    fit = "fit_anchors" if isinstance(config, AnchorConfig) else "fit_network"
    script = f"""
        from pathlib import Path
        from services.edge.field.anchor_fit import fit_anchors
        from services.edge.field.config import AnchorConfig
        from services.edge.field.local import local_field
        from services.edge.paper_field.network_config import NetworkConfig
        from services.edge.paper_field.network_fit import fit_network
        from tests.support import surfaces

        def kept(name):  # of /proc: VmRSS now, VmHWM at most since it was cleared
            lines = Path("/proc/self/status").read_text().splitlines()
            return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(name))

        xyz = surfaces.sampled(surfaces.pleated_skirt(), {points})
        base = local_field(xyz)
        Path("/proc/self/clear_refs").write_text("5")
        before = kept("VmRSS")
        for step in {fit}(xyz, {config!r}, base=base):
            pass
        print(kept("VmHWM") - before)
    """
    done = subprocess.run([sys.executable, "-c", dedent(script)], capture_output=True, text=True, check=True)
    assert 0.5 < fit_memory_bytes(points, config) / int(done.stdout) < 2


def test_memory_grows_with_the_points_and_a_gpu_holds_more_at_once() -> None:
    for config in (ANCHORS, NETWORK):
        taken = [fit_memory_bytes(points, config) for points in (1_000, 10_000, 100_000)]
        assert taken == sorted(taken)
        assert fit_memory_bytes(10_000, config, "cuda:0") > taken[1]
