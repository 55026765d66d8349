"""Promises about the tree itself: imports, start-up, the README's map, vendored files."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from services.cli.main import app

ROOT = Path(__file__).parents[1]


def _loaded_after(statement: str) -> set[str]:
    code = f"{statement}; import sys; print(*sorted(sys.modules))"
    return set(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split())


@pytest.mark.parametrize(
    ("statement", "forbidden"),
    [
        ("import services.gateway.app", {"torch", "numpy", "scipy", "trimesh"}),
        ("import services.storage.local", {"torch", "numpy", "boto3", "grpc", "fastapi"}),
        ("import services.cli.main", {"torch", "numpy", "grpc", "fastapi", "boto3"}),
        ("import services.edge.pipeline", {"torch", "fastapi", "sqlalchemy"}),
    ],
)
def test_importing_one_part_leaves_the_others_unloaded(statement: str, forbidden: set[str]) -> None:
    assert _loaded_after(statement) & forbidden == set()


def test_every_file_that_the_readme_names_exists() -> None:
    links = re.findall(r"\]\(([^)#:]+)\)", (ROOT / "README.md").read_text())
    seen = ROOT
    for link in links:
        path = ROOT / link
        # "extract.py" after "services/edge/mesh/nouns.py" stands in the same folder.
        assert path.exists() or (seen / link).exists(), link
        seen = path.parent if path.exists() else seen


def test_the_page_libraries_name_only_files_that_are_there() -> None:
    web = ROOT / "services" / "gateway" / "web"
    for module in web.glob("*.js"):
        for name in re.findall(r"(?:from|import\()\s*'(\./[^']+)'", module.read_text()):
            assert (web / name).is_file(), f"{module.name} imports {name}"
    assert all(re.match(r"three-\d+\.\d+\.\d+\.", file.name) for file in web.glob("three-*"))


def test_no_folder_of_protos_is_a_package() -> None:
    assert list((ROOT / "proto").rglob("__init__.py")) == []


def test_every_command_that_the_readme_names_exists() -> None:
    named = set(re.findall(r"capture2vr (\w+)", (ROOT / "README.md").read_text()))
    commands = {command.callback.__name__ for command in app.registered_commands if command.callback}
    commands |= {group.name for group in app.registered_groups}
    assert named - commands == set()
    assert {"run", "up", "push", "pull", "doctor"} <= named
