"""The command line with the product's own dependencies alone, in an environment of nothing but a path."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from capture2vr.cli.up import free_port
from tests.support.clouds import write_ply
from tests.support.fresh_process import run_fresh

pytestmark = pytest.mark.slow

MAIN = "from capture2vr.cli.main import main; main()"
# And what it loaded: PyTorch's compiler takes a second and 80 MB, and is of no use to a field.
TRAIN = """
import sys
from capture2vr.cli.main import main
try:
    main()
finally:
    assert "torch" in sys.modules and "torch._dynamo" not in sys.modules
"""
EXTRAS = ("gateway", "edge", "storage")


@pytest.mark.parametrize("command", ["doctor", "presets", "version"])
def test_a_command_needs_no_package_of_the_tests(command: str, tmp_path: Path) -> None:
    # Not the default gateway: who tests beside us may have one there, which is just starting.
    nowhere = ("--gateway", f"http://127.0.0.1:{free_port()}") if command == "doctor" else ()
    run_fresh(MAIN, command, *nowhere, extras=EXTRAS, cwd=tmp_path)


def test_a_field_is_trained_and_a_bundle_made(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    xyz = rng.normal(size=(400, 3))
    xyz *= [0.2, 1, 0.2] / np.linalg.norm(xyz, axis=1, keepdims=True)  # a rod: it covers little of the pictures
    scan = write_ply(tmp_path / "rod.ply", xyz, rng.integers(0, 255, (400, 3)))
    arguments = ("run", scan, "-o", tmp_path / "out", "--preset", "standard", "--resolution", "32")
    run_fresh(TRAIN, *arguments, extras=EXTRAS, cwd=tmp_path)
    assert (tmp_path / "out" / "refined.png").is_file()
