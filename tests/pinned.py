"""Packages that tests drive from outside, npm's and others: installed once per set of pins, outside the checkout."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
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
    digest = hashlib.sha256(b"".join((pins / file).read_bytes() for file in needed)).hexdigest()[:16]
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    folder = cache / "capture2vr" / f"{name}-{digest}"
    if not folder.is_dir():
        scratch = folder.with_name(f"{folder.name}.{os.getpid()}")
        scratch.mkdir(parents=True)
        for file in needed:
            shutil.copy(pins / file, scratch)
        for command in (_NPM, *also):
            done = subprocess.run(command, cwd=scratch, capture_output=True, text=True, timeout=180)
            if done.returncode != 0:
                shutil.rmtree(scratch)
                missing(f"a package for {what} ({done.stderr.strip().splitlines()[-1:]})")
        try:
            scratch.rename(folder)
        except OSError:  # another test run was faster, and its copy is as good
            shutil.rmtree(scratch)
    return folder


def wheels(name: str, requirements: Path, *, what: str) -> Path:
    """A folder for PYTHONPATH in the user's cache that holds what a pip file with hashes names, for this Python.

    Skips (fails in CI) where a package cannot be had; `what` says what for.
    """
    digest = hashlib.sha256(requirements.read_bytes() + sys.version.encode()).hexdigest()[:16]
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    folder = cache / "capture2vr" / f"{name}-{digest}"
    if not folder.is_dir():
        scratch = folder.with_name(f"{folder.name}.{os.getpid()}")
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps"]
        pinned = ["--only-binary", ":all:", "--require-hashes", "--target", scratch, "-r", requirements]
        done = subprocess.run([*pip, *pinned], capture_output=True, text=True, timeout=600)
        if done.returncode != 0:
            shutil.rmtree(scratch, ignore_errors=True)
            missing(f"a package for {what} ({done.stderr.strip().splitlines()[-1:]})")
        try:
            scratch.rename(folder)
        except OSError:  # another test run was faster, and its copy is as good
            shutil.rmtree(scratch)
    return folder
