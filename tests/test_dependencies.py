"""What the product depends on: all that a service imports is declared for it, all that is declared is imported, and the
licences of all that the SBOM lists are permissive."""

from __future__ import annotations

import ast
import json
import sys
import tomllib
from collections.abc import Iterable
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement

from release.distributions import normalised, product_extras
from release.licences import GPL, GPL_BUNDLED, gpl_code_in, permits
from release.sbom import python_components
from tests.support.repository import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

# The service that each extra is for. What is declared without an extra is for all of them.
SERVICES = {
    "storage": "storage",
    "gateway": "gateway",
    "postgres": "gateway",
    "traces": "gateway",
    "edge": "edge",
    "fast": "edge",
    "ray": "edge",
    "learned-matching": "edge",
    "models": "edge",
}
RUNTIME = tuple(SERVICES)

# Declared, and imported by none of our files.
LOADED_BY_OTHERS = {
    "httptools",  # uvicorn parses HTTP with it where it is installed, and else in Python
}

# Imported only when somebody asks for it by name, and told to install where it is not.
ASKED_FOR = {"open3d"}  # Mesh.to_open3d

PERMISSIVE = {
    *("0BSD", "BSD", "BSD-2-Clause", "BSD-3-Clause", "BSL-1.0", "ISC", "MIT", "MIT-0", "Zlib"),
    *("Apache-2.0", "Apache-2.0 WITH LLVM-exception"),
    *("CC0-1.0", "Unlicense"),
    *("HPND", "MIT-CMU"),
    "PSF-2.0",
}
OTHER_LICENCES = {
    "certifi": "MPL-2.0",  # certificates: data that is read, and handed on unchanged
    # The LGPL asks that users can replace the library: it is a folder of its own. Only the extra "postgres" brings it.
    "psycopg": "LGPL-3.0-only",
    "psycopg-binary": "LGPL-3.0-only",
    # A progress bar that the extra "learned-matching" brings and never draws; used unchanged.
    "tqdm": "MPL-2.0 AND MIT",
}
# NVIDIA's own libraries, which only PyTorch's CUDA build brings: free of charge, closed, under NVIDIA's terms.
CLOSED = ("nvidia-", "cuda-")


def _declared(*extras: str) -> set[str]:
    """What an installation with these extras asks for by name, with the extras that they bring along."""
    lines = [*PROJECT["dependencies"], *(line for extra in extras for line in PROJECT["optional-dependencies"][extra])]
    wanted = [Requirement(line) for line in lines]
    brought = {extra for each in wanted if each.name == PROJECT["name"] for extra in each.extras} - set(extras)
    names = {normalised(each.name) for each in wanted if each.name != PROJECT["name"]}
    return names | (_declared(*brought) if brought else set())


def _own(extra: str) -> set[str]:
    return {normalised(Requirement(line).name) for line in PROJECT["optional-dependencies"][extra]} - {PROJECT["name"]}


@cache
def _imports(file: Path) -> frozenset[str]:
    """Dotted names of all modules that a file imports, wherever in it; `from a import b` may mean the module a.b."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.module is not None
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return frozenset(found)


def _reached(service: str) -> set[Path]:
    """The files of a service, and those that they import from others."""
    todo, reached = list((ROOT / "capture2vr" / service).rglob("*.py")), set[Path]()
    while todo:
        file = todo.pop()
        reached.add(file)
        ours = [ROOT / name.replace(".", "/") for name in _imports(file) if name.startswith("capture2vr.")]
        places = [place for path in ours for place in (path.with_suffix(".py"), path / "__init__.py")]
        todo += [place for place in places if place.is_file() and place not in reached]
    return reached


def _imported(files: Iterable[Path]) -> dict[str, set[str]]:
    """Module -> the distributions that may provide it, for all modules that are neither ours nor Python's."""
    providers = packages_distributions()
    modules = {name.partition(".")[0] for file in files for name in _imports(file)}
    foreign = modules - {"capture2vr"} - sys.stdlib_module_names
    # What is not installed, or is one compiled file, is listed nowhere: its distribution has the module's name.
    return {module: {normalised(name) for name in providers.get(module, [module])} for module in foreign}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("service", "extras"),
    [
        ("storage", ["storage"]),
        ("gateway", ["gateway", "postgres", "traces"]),
        ("edge", ["edge", "fast", "learned-matching", "models", "ray", "traces"]),
        ("cli", list(RUNTIME)),
    ],
)
def test_a_service_imports_only_what_is_declared_for_it(service: str, extras: list[str]) -> None:
    declared = _declared(*extras)
    foreign = {module for module, names in _imported(_reached(service)).items() if not names & declared}
    assert foreign - ASKED_FOR == set()


@pytest.mark.slow
@pytest.mark.parametrize("extra", RUNTIME)
def test_what_an_extra_declares_its_service_imports(extra: str) -> None:
    imported = set[str]().union(*_imported(_reached(SERVICES[extra])).values())
    assert _own(extra) - imported - LOADED_BY_OTHERS == set()


@pytest.mark.slow
def test_what_is_declared_for_all_is_imported() -> None:
    imported = set[str]().union(*_imported((ROOT / "services").rglob("*.py")).values())
    assert _declared() - imported == set()
    assert imported & LOADED_BY_OTHERS == set()


def _licence(component: dict[str, Any]) -> str:
    (choice,) = component["licenses"]
    return str(choice["expression"] if "expression" in choice else choice["license"]["name"])


def test_the_extras_that_users_install_are_those_of_a_service() -> None:
    assert set(product_extras(ROOT)) == set(RUNTIME)


@pytest.mark.slow
def test_every_licence_is_permissive_but_those_of_a_few_that_are_named(sbom: str) -> None:
    """Of Python and JavaScript libraries and of weights alike."""
    components = [each for each in json.loads(sbom)["components"] if not each["name"].startswith(CLOSED)]
    assert len(components) > 50
    assert {"three.js", "Basis Universal", "numpy"} <= {each["name"] for each in components}
    licences = [(normalised(each["name"]), _licence(each)) for each in components]
    others = {name: licence for name, licence in licences if not permits(licence, PERMISSIVE)}
    assert others == {name: licence for name, licence in OTHER_LICENCES.items() if name in dict(licences)}


@pytest.mark.slow
def test_what_a_wheel_bundles_is_permissive_but_the_gpl_code_that_is_named(sbom: str) -> None:
    inside = {
        name: {each["name"]: _licence(each) for each in component["components"] if each["type"] != "file"}
        for name, component in python_components(sbom).items()
        if "components" in component
    }
    others = {
        name: {part: licence for part, licence in parts.items() if not permits(licence, PERMISSIVE)}
        for name, parts in inside.items()
    }
    assert {name: found for name, found in others.items() if found} == {
        name: dict.fromkeys(bundled, GPL) for name, bundled in GPL_BUNDLED.items()
    }


@pytest.mark.slow
def test_no_wheel_bundles_gpl_code_but_those_that_are_named(sbom: str) -> None:
    names = [name for name in python_components(sbom) if not name.startswith(CLOSED)]
    assert {name: found for name in names if (found := gpl_code_in(name))} == GPL_BUNDLED


@pytest.mark.parametrize(
    ("expression", "verdict"),
    [
        ("MIT", True),
        ("GPL-3.0-only OR MIT", True),
        ("GPL-3.0-only AND MIT", False),
        ("(GPL-3.0-only OR MIT) AND MIT", False),
        ("(MIT OR Apache-2.0) AND ISC", True),
        ("unknown", False),
    ],
)
def test_one_may_choose_among_licences_but_must_keep_all_that_apply(expression: str, verdict: bool) -> None:
    assert permits(expression, PERMISSIVE) is verdict
