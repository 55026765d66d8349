"""Figures that keep the house small: no circle of imports, one class a name, short folders, files and functions."""

from __future__ import annotations

import ast
import re
import subprocess
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from tests.support.python_files import SERVICES, python_files
from tests.support.repository import ROOT

Graph = Mapping[str, set[str]]
Function = ast.FunctionDef | ast.AsyncFunctionDef

TESTS = ROOT / "tests"
MOST_FILES = {"services": 30, "tests": 45}  # of a folder: as many names as a reader looks through
MOST_COMPLEXITY = 12  # of a function; ruff, which does not count conditions, has the same limit (C901)
MOST_LINES = 300  # of a file

# What breaks a rule today, and may only get fewer: a name that no longer breaks it must go from here.
LONG_FILES = {
    "cli/main.py",
    "edge/capture/frame_records.py",
    "gateway/backup/restore.py",
    "gateway/jobs/store.py",
    "gateway/routes/access.py",
    "gateway/routes/captures.py",
    "gateway/routes/jobs.py",
    "gateway/schemas.py",
    "gateway/workers/worker_client.py",
    "process/archives.py",
}


def functions() -> Iterator[tuple[str, Function]]:
    """Every function and method, as `path:name`."""
    for path, tree in python_files().items():
        for node in ast.walk(tree):
            if isinstance(node, Function):
                yield f"{path}:{node.name}", node


# ---- circles ----


def python_imports() -> Graph:
    """Each module with those that it imports while it is loaded, both by their paths."""
    known = python_files()
    return {path: set(_paths(_loaded(tree), known)) - {path} for path, tree in known.items()}


def _loaded(body: ast.AST) -> Iterator[ast.ImportFrom | ast.Import]:
    """The imports that run when a module is loaded: none in functions, none for the type checker alone."""
    for node in ast.iter_child_nodes(body):
        if isinstance(node, ast.ImportFrom | ast.Import):
            yield node
        elif not isinstance(node, Function) and not (
            isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
        ):
            yield from _loaded(node)


def _paths(imports: Iterable[ast.ImportFrom | ast.Import], known: Mapping[str, ast.Module]) -> Iterator[str]:
    """Those of our modules that imports name."""
    for node in imports:
        base = f"{node.module}." if isinstance(node, ast.ImportFrom) else ""
        names = [base + alias.name for alias in node.names] + [base.rstrip(".")]
        for name in names:
            path = name.removeprefix("capture2vr.").replace(".", "/") + ".py"
            if name.startswith("capture2vr.") and path in known:
                yield path


def script_imports() -> Graph:
    """Each JavaScript module of the pages with those that it imports: at once, later, or for their types."""
    web = SERVICES / "web"
    found = {}
    for module in sorted(web.glob("*/*.js")):
        paths = re.findall(r"(?:from|import\(|importScripts\(|URL\()\s*'(\.\.?/[^']+)'", module.read_text())
        found[module.relative_to(web).as_posix()] = {
            (module.parent / path).resolve().relative_to(web.resolve()).as_posix() for path in paths
        }
    return {name: others for name, others in found.items() if not name.startswith("vendor/")}


def rooms_of(modules: Graph) -> Graph:
    """The same between rooms: a folder of a service; a file that lies beside such folders is a room of its own."""
    rooms: dict[str, set[str]] = defaultdict(set)
    for module, others in modules.items():
        rooms[_room(module)] |= {_room(other) for other in others} - {_room(module)}
    return rooms


def _room(module: str) -> str:
    folder = module.rpartition("/")[0]
    return folder if "/" in folder or not module.endswith(".py") else module


def circle(graph: Graph) -> list[str]:
    """A circle of a graph, if there is one."""
    try:
        tuple(TopologicalSorter(graph).static_order())
    except CycleError as found:
        return list(found.args[1])
    return []


@pytest.mark.essential
@pytest.mark.slow
def test_no_module_imports_itself_by_others() -> None:
    assert circle({"a": {"b"}, "b": {"a"}}) != [], "the test can fail"
    assert len(python_imports()) > 500
    assert circle(python_imports()) == []


def test_no_room_imports_itself_by_others() -> None:
    rooms = rooms_of(python_imports())
    assert rooms["edge/mesh"]
    assert circle(rooms) == []


def test_no_script_and_no_room_of_scripts_imports_itself_by_others() -> None:
    scripts = script_imports()
    assert "scenes/scene-item.js" in scripts["viewer/viewer.js"]
    assert circle(scripts) == []
    assert circle(rooms_of(scripts)) == []


# ---- names ----


def test_no_two_classes_of_services_have_the_same_name() -> None:
    trees = python_files().values()
    names = Counter(node.name for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    assert [name for name, count in names.items() if count > 1] == []


def test_nothing_imports_the_folder_by_its_name() -> None:
    """The package is called capture2vr; services/ is where it lies."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True).stdout.splitlines()
    if not listed:
        pytest.skip("no Git checkout")
    wrong = re.compile(
        r"\bfrom services\b(?! )|\b(from|import) services(\.| import)|-m services\b|\"services\.\w|'services\.\w"
    )
    texts = (
        ROOT / name
        for name in listed
        if Path(name).suffix in {".py", ".toml", ".yml", ".yaml", ".md", ".sh", ".Dockerfile"}
    )
    found = [
        path.relative_to(ROOT).as_posix() for path in texts if path != Path(__file__) and wrong.search(path.read_text())
    ]
    assert found == []


# ---- sizes ----


@pytest.mark.parametrize("top", MOST_FILES)
def test_no_folder_has_more_files_than_a_reader_looks_through(top: str) -> None:
    here = [path for path in (ROOT / top).rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    ours = Counter(
        path.parent.relative_to(ROOT).as_posix() for path in here if not {"vendor", "node_modules"} & set(path.parts)
    )
    assert {folder: count for folder, count in ours.items() if count > MOST_FILES[top]} == {}


def test_files_are_short_and_the_list_of_longer_ones_only_shrinks() -> None:
    paths = (SERVICES / path for path in python_files())
    assert {
        path.relative_to(SERVICES).as_posix() for path in paths if path.read_text().count("\n") > MOST_LINES
    } == LONG_FILES


@pytest.mark.slow
@pytest.mark.essential
def test_functions_are_simple() -> None:
    assert [name for name, node in functions() if complexity(node) > MOST_COMPLEXITY] == []


def complexity(function: Function) -> int:
    """McCabe's number of a function, as Radon counts it: one more than its branches, loops and conditions."""
    return 1 + sum(map(_branches, _own(function)))


def _own(function: ast.AST) -> Iterator[ast.AST]:
    """The nodes of a function, without those of functions and classes in it, which count by themselves."""
    for node in ast.iter_child_nodes(function):
        if not isinstance(node, Function | ast.ClassDef):
            yield node
            yield from _own(node)


def _branches(node: ast.AST) -> int:
    match node:
        case ast.BoolOp(values=values):
            return len(values) - 1
        case ast.comprehension(ifs=conditions):
            return 1 + len(conditions)
        case ast.For(orelse=rest) | ast.AsyncFor(orelse=rest) | ast.While(orelse=rest):
            return 1 + bool(rest)
        case ast.Try(handlers=handlers, orelse=rest):
            return len(handlers) + bool(rest)
        case ast.Match(cases=cases):
            return len(cases) - any(
                isinstance(case.pattern, ast.MatchAs) and not case.pattern.pattern for case in cases
            )
        case ast.If() | ast.IfExp() | ast.Assert():
            return 1
    return 0


def test_the_complexity_of_a_function_counts_its_ways() -> None:
    text = "def f(a):\n    if a and [b for b in a if b]:\n        return 1 if a else 2\n    for c in a:\n        pass\n"
    (function,) = ast.parse(text).body
    assert isinstance(function, ast.FunctionDef)
    assert complexity(function) == 1 + 2 + 2 + 1 + 1
