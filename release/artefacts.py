"""Build a release's files in dist/: wheel, source distribution, SBOM, and the list of their hashes."""

from __future__ import annotations

import hashlib
import shutil
import sys
from collections.abc import Iterable
from pathlib import Path

from release.distributions import PRODUCT
from release.process import output_of
from release.project import project_version
from release.sbom import make_sbom

SUMS = "SHA256SUMS"


def write_sbom(root: Path) -> Path:
    """Write the SBOM into dist/."""
    version = project_version(root)
    path = root / "dist" / f"{PRODUCT}-{version}.cdx.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(make_sbom(root, version))
    return path


def build_artefacts(root: Path) -> list[Path]:
    """Empty dist/ and build wheel, source distribution and SBOM there.

    hatchling builds in this environment, so it needs no network; the same tree gives the same bytes.
    """
    dist = root / "dist"
    shutil.rmtree(dist, ignore_errors=True)
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(dist)]
    output_of(command, "hatchling cannot build the wheel", cwd=root)
    write_sbom(root)
    return sorted(dist.iterdir())


def write_sums(files: Iterable[Path], path: Path) -> None:
    """Write the sha256 of files of one folder, in the form that `sha256sum --check` reads."""
    path.write_text("".join(f"{sha256(file)}  {file.name}\n" for file in sorted(files)))


def sha256(path: Path) -> str:
    """The sha256 of a file in hexadecimal digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
