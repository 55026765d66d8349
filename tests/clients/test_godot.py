"""The Godot addon, run by Godot itself without a window, on what the product has published, served by a real server."""

from __future__ import annotations

import json
import re
from pathlib import Path
from textwrap import indent

import pytest

from tests.referees.godot.engine import Project, project
from tests.support.clients.client_site import serving
from tests.support.clients.godot_facts import facts
from tests.support.repository import ROOT

_HERE = Path(__file__).parent / "godot"
_CLIENT = ROOT / "clients" / "godot"
_EXAMPLE = """extends Node
var dress: CapturedAsset
var winter: CaptureCollection
func _run() -> void:
"""
_ADDON = _CLIENT / "addons" / "capture2vr"


@pytest.fixture(scope="module")
def godot(tmp_path_factory: pytest.TempPathFactory) -> Project:
    """A project with the addon, its tests and the examples of its README."""
    made = project(tmp_path_factory.mktemp("godot"), _ADDON)
    made.add(sorted(_HERE.glob("*.gd")), "tests")
    (made.folder / "readme").mkdir()
    for number, block in enumerate(
        re.findall(r"```gdscript\n(.*?)```", (_CLIENT / "README.md").read_text(), re.DOTALL)
    ):
        (made.folder / "readme" / f"block{number}.gd").write_text(_EXAMPLE + indent(block, "\t"))
    return made


@pytest.fixture(scope="module")
def results(godot: Project, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What each test said: "ok", or why it failed."""
    root = tmp_path_factory.mktemp("site")
    told = facts(root, godot.folder)
    printed = godot.import_files()
    assert "SCRIPT ERROR" not in printed, printed
    with serving(root) as url:
        path = root / "facts.json"
        path.write_text(json.dumps({"server": url, **told}))
        printed = godot.run("-s", "res://tests/run.gd", "--", f"--facts={path}")
    assert "SCRIPT ERROR" not in printed, printed
    lines = [re.fullmatch(r"(ok|FAIL) (\w+)(?:: (.*))?", line) for line in printed.splitlines()]
    found = {line[2]: line[3] or line[1] for line in lines if line}
    assert found, printed
    return found


def _tests() -> list[str]:
    scripts = (script.read_text() for script in sorted(_HERE.glob("test_*.gd")))
    return [name for script in scripts for name in re.findall(r"^func (test_\w+)\(", script, re.MULTILINE)]


@pytest.mark.slow
@pytest.mark.parametrize("name", _tests())
def test_addon(results: dict[str, str], name: str) -> None:
    assert results[name] == "ok"
