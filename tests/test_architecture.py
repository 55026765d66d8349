"""Promises about the tree itself: imports, start-up, the README's map, vendored files."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from capture2vr.cli.main import app

ROOT = Path(__file__).parents[1]


def _loaded_after(statement: str) -> set[str]:
    code = f"{statement}; import sys; print(*sorted(sys.modules))"
    return set(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("statement", "forbidden"),
    [
        ("import capture2vr.gateway.app", {"torch", "numpy", "scipy", "trimesh"}),
        ("import capture2vr.storage.local", {"torch", "numpy", "boto3", "grpc", "fastapi"}),
        ("import capture2vr.cli.main", {"torch", "numpy", "grpc", "fastapi", "boto3"}),
        ("import capture2vr.edge.pipeline", {"torch", "fastapi", "sqlalchemy"}),
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
    web = ROOT / "services" / "web"
    for module in web.glob("*/*.js"):
        for name in re.findall(r"(?:from|import\()\s*'(\.\.?/[^']+)'", module.read_text()):
            assert (module.parent / name).is_file(), f"{module.name} imports {name}"
    assert all(
        re.match(r"(spark|three|tus-js-client|tiles-renderer)-\d+\.\d+\.\d+\.", file.name)
        for file in (web / "vendor").iterdir()
    )


def test_pages_import_what_they_share_and_never_each_other() -> None:
    drawing = {"graphics", "catalogue", "shared", "vendor"}
    may = {
        "capture": {"capture"} | drawing,
        "edit": {"edit"} | drawing,
        "viewer": {"viewer", "wardrobe", "headset", "scenes"} | drawing,
        "wardrobe": {"wardrobe", "headset", "scenes"} | drawing,
        "headset": {"headset", "scenes"} | drawing,
        "scenes": {"scenes"} | drawing,
        "collection": {"collection"} | drawing,
        "admin": {"admin", "shared"},
        "login": {"login", "shared"},
        "pair": {"pair", "shared"},
        "share": {"share", "shared"},
        "graphics": drawing,
        "catalogue": {"catalogue", "shared"},
        "shared": {"shared"},
        "vendor": {"vendor"},
    }
    web = ROOT / "services" / "web"
    for module in web.glob("*/*.js"):
        room = module.parent.name
        for name in re.findall(r"(?:from|import\(|importScripts\(|URL\()\s*'(\.\.?/[^']+)'", module.read_text()):
            assert (module.parent / name).resolve().parent.name in may[room], f"{room}/{module.name} imports {name}"


@pytest.mark.slow
def test_the_drawing_of_the_rooms_is_what_the_imports_say() -> None:
    command = [sys.executable, str(ROOT / "docs" / "draw_rooms.py"), "--check"]
    assert subprocess.run(command, capture_output=True, text=True).stderr == ""


@pytest.mark.slow
def test_no_room_imports_itself_by_others() -> None:
    module = runpy.run_path(str(ROOT / "docs" / "draw_rooms.py"))
    tuple(TopologicalSorter(module["rooms_and_arrows"]()).static_order())  # raises CycleError


def test_every_room_and_file_that_the_architecture_names_exists() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text()
    rows = re.findall(r"^\| `([\w/.]+)`[^|]*\|[^|]*\| ([^|]*) \|$", text.split("## Rooms of the edge")[1], re.MULTILINE)
    rooms = {room: re.findall(r"`(\w+\.py)`", files) for room, files in rows}
    assert {"worker", "capture", "field", "mesh", "asset"} <= rooms.keys()
    edge = ROOT / "services" / "edge"
    for room, files in rooms.items():
        assert all((edge / room / file).is_file() or (edge / file).is_file() for file in files), room
    folders = {path.name for path in edge.iterdir() if (path / "__init__.py").is_file()} - {"api"}
    assert folders <= rooms.keys()


def test_no_folder_of_protos_is_a_package() -> None:
    assert list((ROOT / "proto").rglob("__init__.py")) == []


def test_every_command_that_readme_and_first_steps_name_exists() -> None:
    pages = (ROOT / "README.md", ROOT / "docs" / "start.md")
    named = {name for page in pages for name in re.findall(r"(?:/|`)capture2vr (\w+)", page.read_text())}
    commands = {command.callback.__name__ for command in app.registered_commands if command.callback}
    commands |= {group.name for group in app.registered_groups}
    assert named - commands == set()
    assert {"run", "up", "push", "pull", "doctor"} <= named
