"""Packages that tests drive from outside, npm's and others: installed once per set of pins, outside the checkout."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from tests.conftest import missing

_NPM = ("npm", "ci", "--no-audit", "--no-fund", "--ignore-scripts", "--silent")


def installed(
    name: str, pins: Path, files: Sequence[str] = (), *, also: Sequence[Sequence[str]] = (), what: str
) -> Path:
    """The folder in the user's cache that holds what `pins`/package-lock.json names.

    files   further files of `pins` that are copied beside it, and part of what makes the folder another one
    also    further commands that are run there
    Skips (fails in CI) where node or a package cannot be had; `what` says what for.
    """
    if shutil.which("node") is None or shutil.which("npm") is None:
        missing(f"node, to run {what}")
    needed = ("package.json", "package-lock.json", *files)

    def fill(scratch: Path) -> None:
        scratch.mkdir(parents=True)
        for file in needed:
            shutil.copy(pins / file, scratch)
        for command in (_NPM, *also):
            _run(command, what, cwd=scratch, timeout=180)

    return kept(name, b"".join((pins / file).read_bytes() for file in needed), fill)


def wheels(name: str, requirements: Path, *, what: str) -> Path:
    """A folder for PYTHONPATH in the user's cache that holds what a pip file with hashes names, for this Python.

    Skips (fails in CI) where a package cannot be had; `what` says what for.
    """

    def fill(scratch: Path) -> None:
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps"]
        pinned = ["--only-binary", ":all:", "--require-hashes", "--target", str(scratch), "-r", str(requirements)]
        _run([*pip, *pinned], what, timeout=600)

    return kept(name, requirements.read_bytes() + sys.version.encode(), fill)


def _run(command: Sequence[str], what: str, *, timeout: float, cwd: Path | None = None) -> None:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=timeout)
    if done.returncode != 0:
        missing(f"a package for {what} ({done.stderr.strip().splitlines()[-1:]})")


def kept(name: str, pins: bytes, fill: Callable[[Path], None]) -> Path:
    """A folder of the user's cache, for those pins, which `fill` makes where it is not there yet."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    folder = cache / "capture2vr" / f"{name}-{hashlib.sha256(pins).hexdigest()[:16]}"
    if folder.is_dir():
        return folder
    scratch = folder.with_name(f"{folder.name}.{os.getpid()}")
    try:
        fill(scratch)
        scratch.rename(folder)
    except OSError:  # another test run was faster, and its copy is as good
        if not folder.is_dir():
            raise
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return folder
