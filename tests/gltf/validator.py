"""Khronos' glTF validator, installed once per lock file into a cache outside the checkout."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.conftest import missing

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
        if shutil.which("node") is None or shutil.which("npm") is None:
            missing("node, to run the glTF validator")
        lock = hashlib.sha256((_HERE / "package-lock.json").read_bytes()).hexdigest()[:16]
        cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
        self._folder = cache / "capture2vr" / f"gltf-{lock}"
        if not (self._folder / "node_modules").is_dir():
            self._install()

    def __call__(self, *files: Path) -> list[Verdict]:
        command = ["node", _HERE / "validate.mjs", *files]
        done = subprocess.run(command, cwd=self._folder, capture_output=True, text=True, check=True, timeout=120)
        return [Verdict(**{**verdict, "messages": tuple(verdict["messages"])}) for verdict in json.loads(done.stdout)]

    def _install(self) -> None:
        scratch = self._folder.with_name(f"{self._folder.name}.{os.getpid()}")
        scratch.mkdir(parents=True)
        for name in ("package.json", "package-lock.json"):
            shutil.copy(_HERE / name, scratch)
        command = ["npm", "ci", "--no-audit", "--no-fund", "--ignore-scripts"]
        done = subprocess.run(command, cwd=scratch, capture_output=True, text=True, timeout=120)
        if done.returncode != 0:
            shutil.rmtree(scratch)
            missing(f"npm package gltf-validator ({done.stderr.strip().splitlines()[-1:]})")
        try:
            scratch.rename(self._folder)
        except OSError:  # another test run was faster, and its copy is as good
            shutil.rmtree(scratch)


@pytest.fixture(scope="session")
def validator() -> Validator:
    """Khronos' judgement of .glb files."""
    return Validator()
