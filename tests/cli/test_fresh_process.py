"""The command line with the product's own dependencies alone, in an environment of nothing but a path."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.clouds import write_ply
from tests.support.fresh_process import run_fresh

pytestmark = pytest.mark.slow

MAIN = "from services.cli.main import main; main()"
EXTRAS = ("gateway", "edge", "storage")


@pytest.mark.parametrize("command", ["doctor", "presets", "version"])
def test_a_command_needs_no_package_of_the_tests(command: str, tmp_path: Path) -> None:
    run_fresh(MAIN, command, extras=EXTRAS, cwd=tmp_path)


def test_a_field_is_trained_and_a_bundle_made(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    xyz = rng.normal(size=(2000, 3))
    xyz /= np.linalg.norm(xyz, axis=1, keepdims=True)
    scan = write_ply(tmp_path / "ball.ply", xyz, rng.integers(0, 255, (2000, 3)))
    arguments = ("run", scan, "-o", tmp_path / "out", "--preset", "standard", "--resolution", "32")
    run_fresh(MAIN, *arguments, extras=EXTRAS, cwd=tmp_path)
    assert (tmp_path / "out" / "refined.png").is_file()
