"""The JavaScript libraries inside the pages, read from the notices of their licences (services/web/vendor/*.LICENSE).

The scripts `deploy/vendor-*.sh` write a notice for every library, also for those inside another one's file:

    meshoptimizer 1.1 (MIT): meshopt-decoder.js     name, version, licence, files (without "LIBRARY-VERSION.")
    pkg:npm/meshoptimizer@1.1.0                     package URL

    the licence's text
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from release.errors import ReleaseError

FOLDER = Path("services", "web", "vendor")
_NOTICE = re.compile(r"(?P<name>.+) (?P<version>\d\S*) \((?P<licence>[^)]+)\): (?P<files>.+)\n(?P<purl>pkg:\S+)\n\n.")


@dataclass(frozen=True, slots=True)
class VendoredLibrary:
    """A library in the pages. licence: an SPDX expression; notice, files: paths relative to the repository"""

    name: str
    version: str
    licence: str
    purl: str
    notice: Path
    files: tuple[Path, ...]


def vendored_libraries(root: Path) -> list[VendoredLibrary]:
    """Read all notices. Raises ReleaseError where one is not of the form above, or names a file that is not there."""
    return [_read(root, notice.relative_to(root)) for notice in sorted((root / FOLDER).glob("*.LICENSE"))]


def _read(root: Path, notice: Path) -> VendoredLibrary:
    found = _NOTICE.match((root / notice).read_text())
    if found is None:
        raise ReleaseError(f"{notice} does not begin with a library and its package URL: run its deploy/vendor-*.sh")
    prefix = ".".join(notice.name.split(".")[:3])  # three-0.187.0
    files = tuple(FOLDER / f"{prefix}.{name}" for name in found["files"].split())
    if absent := [file for file in files if not (root / file).is_file()]:
        raise ReleaseError(f"{notice} names {absent[0]}, which does not exist: run its deploy/vendor-*.sh")
    return VendoredLibrary(found["name"], found["version"], found["licence"], found["purl"], notice, files)
