"""A folder of modules that a stranger has named like ours and like those of Python; what runs one of them is known."""

from __future__ import annotations

from pathlib import Path

NAMES = ("services", "capture2vr", "numpy", "json", "sitecustomize", "pickle", "socket", "ray", "httpx", "torch")

_MODULE = """
import os
with open({mark!r}, "a") as file:
    file.write(__name__ + "\\n")
raise SystemExit("a stranger's " + __name__)
"""


def strangers_folder(folder: Path) -> Path:
    """Make the folder, with a module or a package of each name, and return it."""
    folder.mkdir(parents=True)
    code = _MODULE.format(mark=str(_mark(folder)))
    for number, name in enumerate(NAMES):
        if number % 2:
            (folder / f"{name}.py").write_text(code)
        else:
            (folder / name).mkdir()
            (folder / name / "__init__.py").write_text(code)
    return folder


def that_ran(folder: Path) -> list[str]:
    """Return the names of the modules of the folder that have been run."""
    mark = _mark(folder)
    return mark.read_text().split() if mark.exists() else []


def _mark(folder: Path) -> Path:
    return folder.resolve() / "ran.txt"
