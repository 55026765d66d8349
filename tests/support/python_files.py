"""The product's Python modules, parsed once for all tests of a process that read them."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

from tests.support.repository import ROOT

SERVICES = ROOT / "services"
_MADE = ("edge/api/", "web/vendor/")  # by protoc; by others


def python_files(*rooms: str) -> dict[str, ast.Module]:
    """Every module of ours below services/, or below some of its folders alone, by its path there."""
    paths = sorted(path for room in rooms or ("",) for path in (SERVICES / room).rglob("*.py"))
    names = {path.relative_to(SERVICES).as_posix(): path for path in paths}
    return {name: _parsed(path) for name, path in names.items() if not name.startswith(_MADE)}


@cache
def _parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))
