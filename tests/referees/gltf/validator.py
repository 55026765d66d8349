"""Khronos' glTF validator, installed once per lock file into a cache outside the checkout."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.npm_packages import installed
from tests.support.patience import HANG_S

_HERE = Path(__file__).parent


@dataclass(frozen=True)
class Verdict:
    """How many issues of each severity a file has, and what they say."""

    errors: int
    warnings: int
    infos: int
    hints: int
    messages: tuple[str, ...]


class Validator:
    """`Validator()(a, b)` judges files. Skips (fails in CI) where node or the package cannot be had."""

    def __init__(self) -> None:
        self._folder = installed("gltf", _HERE, what="the glTF validator")

    def __call__(self, *files: Path) -> list[Verdict]:
        command = ["node", _HERE / "validate.mjs", *files]
        done = subprocess.run(command, cwd=self._folder, capture_output=True, text=True, check=True, timeout=HANG_S)
        return [Verdict(**{**verdict, "messages": tuple(verdict["messages"])}) for verdict in json.loads(done.stdout)]


@pytest.fixture(scope="session")
def validator() -> Validator:
    """Khronos' judgement of .glb files."""
    return Validator()
