"""usd-core, the library that defines the format, installed outside the checkout: what it reads in a .usdz file."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture2vr.edge.arrays import Floats, Ints
from tests.support.npm_packages import wheels
from tests.support.patience import HANG_S

_HERE = Path(__file__).parent


@dataclass(frozen=True)
class Reading:
    """One file.

    faults   what the validators said
    points   (V,3), normals (V,3), corners (F,3), st (n,2)
    picture  the bytes of the base colour's texture, or b""
    other    the rest, by name
    """

    faults: Sequence[str]
    points: Floats
    normals: Floats
    corners: Ints
    st: Floats
    picture: bytes
    other: dict[str, Any]


class UsdCore:
    """`UsdCore()(a, b)` reads files. Skips (fails in CI) where the package cannot be had."""

    def __init__(self) -> None:
        self._folder = wheels("usd", _HERE / "requirements.txt", what="usd-core")

    def __call__(self, *files: Path) -> list[Reading]:
        done = subprocess.run(
            [sys.executable, _HERE / "read.py", *files],
            env=os.environ | {"PYTHONPATH": str(self._folder)},
            capture_output=True,
            text=True,
            timeout=HANG_S,
        )
        assert done.returncode == 0, done.stderr[-2000:]
        return [_reading(told) for told in json.loads(done.stdout)]


def _reading(told: dict[str, Any]) -> Reading:
    return Reading(
        told.pop("faults"),
        np.array(told.pop("points")).reshape(-1, 3),
        np.array(told.pop("normals")).reshape(-1, 3),
        np.array(told.pop("corners")).reshape(-1, 3),
        np.array(told.pop("st")).reshape(-1, 2),
        bytes.fromhex(told.pop("picture")),
        told,
    )


@pytest.fixture(scope="session")
def usd_core() -> UsdCore:
    """usd-core's reading of .usdz files."""
    return UsdCore()
