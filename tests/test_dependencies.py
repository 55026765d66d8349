"""What the product depends on: all that a service imports is declared for it, all that is declared is imported, and the
licences are permissive."""

from __future__ import annotations

import ast
import sys
import tomllib
from collections.abc import Iterable
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution, packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tests.support.fresh_process import normalised, required_distributions
from tests.support.licences import gpl_code_in, licence_of, permits
from tests.support.repository import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

# The service that each extra is for. What is declared without an extra is for all of them.
SERVICES = {
    "storage": "storage",
    "gateway": "gateway",
    "postgres": "gateway",
    "edge": "edge",
    "fast": "edge",
    "learned-matching": "edge",
}
RUNTIME = tuple(SERVICES)

# Declared, and imported by none of our files.
LOADED_BY_OTHERS = {
    "httptools",  # uvicorn parses HTTP with it where it is installed, and else in Python
    "psycopg",  # SQLAlchemy loads it where GATEWAY_DATABASE_URL names it
}

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

# Wheels that say BSD of their own code and bundle code under the GPL. It binds who hands on an image with them in it.
GPL_BUNDLED = {
    # FFmpeg is linked to these two encoders, which the product never calls. Its decoders are under the LGPL.
    "av": {"x264", "x265"},
    # The same encoder beside libheif. The variants without it decode with a libheif that has known memory errors.
    "pillow-heif": {"x265"},
    # Ceres solves bundle adjustment with it; linked into the one module that the wheel has.
    "pycolmap": {"CHOLMOD/Supernodal"},
}


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
    todo, reached = list((ROOT / "services" / service).rglob("*.py")), set[Path]()
    while todo:
        file = todo.pop()
        reached.add(file)
        ours = [ROOT / name.replace(".", "/") for name in _imports(file) if name.startswith("services.")]
        places = [place for path in ours for place in (path.with_suffix(".py"), path / "__init__.py")]
        todo += [place for place in places if place.is_file() and place not in reached]
    return reached


def _imported(files: Iterable[Path]) -> dict[str, set[str]]:
    """Module -> the distributions that may provide it, for all modules that are neither ours nor Python's."""
    providers = packages_distributions()
    modules = {name.partition(".")[0] for file in files for name in _imports(file)}
    foreign = modules - {"services"} - sys.stdlib_module_names
    # What is not installed, or is one compiled file, is listed nowhere: its distribution has the module's name.
    return {module: {normalised(name) for name in providers.get(module, [module])} for module in foreign}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("service", "extras"),
    [
        ("storage", ["storage"]),
        ("gateway", ["gateway"]),
        ("edge", ["edge", "fast", "learned-matching"]),
        ("cli", list(RUNTIME)),
    ],
)
def test_a_service_imports_only_what_is_declared_for_it(service: str, extras: list[str]) -> None:
    declared = _declared(*extras)
    assert {module for module, names in _imported(_reached(service)).items() if not names & declared} == set()


@pytest.mark.parametrize("extra", RUNTIME)
def test_what_an_extra_declares_its_service_imports(extra: str) -> None:
    imported = set[str]().union(*_imported(_reached(SERVICES[extra])).values())
    assert _own(extra) - imported - LOADED_BY_OTHERS == set()


def test_what_is_declared_for_all_is_imported() -> None:
    imported = set[str]().union(*_imported((ROOT / "services").rglob("*.py")).values())
    assert _declared() - imported == set()
    assert imported & LOADED_BY_OTHERS == set()


def _installed() -> list[str]:
    """All that the product needs, theirs too, as far as it is here: some are of other platforms, `fast` needs C++."""
    found = []
    for name in required_distributions("capture2vr", RUNTIME) - {"capture2vr"}:
        try:
            distribution(name)
        except PackageNotFoundError:
            continue
        if not name.startswith(CLOSED):
            found.append(name)
    return found


def test_every_licence_is_permissive_but_those_of_a_few_that_are_named() -> None:
    licences = {name: licence_of(name) for name in _installed()}
    assert len(licences) > 50
    others = {name: licence for name, licence in licences.items() if not permits(licence, PERMISSIVE)}
    assert others == {name: licence for name, licence in OTHER_LICENCES.items() if name in licences}


@pytest.mark.slow
def test_no_wheel_bundles_gpl_code_but_those_that_are_named() -> None:
    assert {name: found for name in _installed() if (found := gpl_code_in(name))} == GPL_BUNDLED


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
