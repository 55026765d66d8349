"""Troubleshooting explains every code with which the product refuses something."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from capture2vr.storage.catalogue import faults
from tests.support.repository import ROOT

REFUSALS = {
    *("Problem", "EdgeError", "CaptureError", "RefusedError", "Refused", "ArchiveError", "RunFailed"),
    *("invalid", "refused", "limited", "_refused", "_require_name", "_database_problem", "_in_use"),
}
"""What is called with a code as its first or second argument, to refuse something or to end a job."""
_CODE = re.compile(r"[A-Z][A-Z0-9]+(_[A-Z0-9]+)*")
_REFUSES = re.compile(rf"\b(?:{'|'.join(REFUSALS)})\(")


def _codes_of(source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in REFUSALS:
            for given in node.args[:2]:
                if isinstance(given, ast.Constant) and isinstance(given.value, str) and _CODE.fullmatch(given.value):
                    yield given.value


def test_every_error_code_is_explained() -> None:
    sources = [file.read_text() for file in (ROOT / "services").rglob("*.py")]
    used = {code for source in sources if _REFUSES.search(source) for code in _codes_of(source)}
    used |= {name for name in vars(faults) if name.isupper()}
    rows = [line for line in (ROOT / "docs" / "troubleshooting.md").read_text().splitlines() if line.startswith("| `")]
    explained = {code for row in rows for code in re.findall(r"`([A-Z][A-Z0-9_]+)`", row.split("|")[1])}
    assert len(used) > 150
    assert used - explained == set()
    assert [row for row in rows if re.match(r"\| `[A-Z]", row) and row.count("|") != 4] == []
