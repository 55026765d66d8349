"""The product in a process of its own: nothing imported before, no variables, no package that only the tests need."""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from release.distributions import PRODUCT, normalised, required_distributions
from tests.support.patience import HANG_S

BARE_ENVIRONMENT = {"PATH": "/usr/local/bin:/usr/bin:/bin"}

# Finds nothing of what an installation with the same extras would not have.
_HIDE = """
import sys
from importlib.machinery import PathFinder
class _Installed(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.partition(".")[0] in {absent!r} else PathFinder.find_spec(name, path, target)
sys.meta_path[sys.meta_path.index(PathFinder)] = _Installed
"""


def run_fresh(code: str, *arguments: str | Path, extras: Iterable[str], cwd: Path) -> str:
    """What `code` prints in a new interpreter that has the product with `extras` and their dependencies, nothing else.

    Warnings are errors there. Raises AssertionError with what it wrote to stderr.
    """
    hide = _HIDE.format(absent=_modules_beyond(frozenset(extras)))
    command = [sys.executable, "-I", "-W", "error", "-c", hide + code, *map(str, arguments)]
    ended = subprocess.run(command, capture_output=True, text=True, env=BARE_ENVIRONMENT, cwd=cwd, timeout=HANG_S)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


@cache
def _modules_beyond(extras: frozenset[str]) -> set[str]:
    """Top-level modules that are installed here, and would not be with `pip install capture2vr[extras]`."""
    wanted = required_distributions(PRODUCT, extras)
    providers = importlib.metadata.packages_distributions().items()
    return {module for module, names in providers if not {normalised(name) for name in names} & wanted}
