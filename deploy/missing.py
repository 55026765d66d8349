"""What the product asks for and this environment does not have; `setup.sh` says it where pip finds no packages."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_EXTRAS = ("gateway", "edge", "storage")


def main() -> None:
    """Print the names, or that of what builds the product, which pip fetches anew each time."""
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())
    extras = project["project"]["optional-dependencies"]
    lines = [*project["project"]["dependencies"], *(line for extra in _EXTRAS for line in extras[extra])]
    names = {re.split(r"[^A-Za-z0-9._-]", line)[0] for line in lines} - {project["project"]["name"]}
    absent = sorted(filter(_is_absent, names)) or [
        re.split("[>=]", line)[0] for line in project["build-system"]["requires"]
    ]
    print(", ".join(absent))


def _is_absent(name: str) -> bool:
    try:
        version(name)
    except PackageNotFoundError:
        return True
    return False


if __name__ == "__main__":
    main()
