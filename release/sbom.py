"""Make the SBOM: a CycloneDX JSON file of all that an installation of the product consists of.

cyclonedx-py reads the installed distributions; of these stay what the product's extras bring, with the licence that
`licences.py` finds. Added is what no package manager knows: the JavaScript inside the pages, trained weights, and the
GPL code that a few wheels bundle. The same environment and tree give the same bytes: there is no time and no serial
number in it.
"""

from __future__ import annotations

import hashlib
import json
import platform
import sys
from collections.abc import Mapping
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

from cyclonedx.schema import SchemaVersion
from cyclonedx.spdx import is_expression

from release.distributions import PRODUCT, brought_by, normalised, product_extras
from release.errors import ReleaseError
from release.licences import GPL, GPL_BUNDLED, licence_of
from release.process import output_of
from release.vendored import VendoredLibrary, vendored_libraries

SPEC = SchemaVersion.V1_6
WEIGHTS = (".pt", ".onnx", ".safetensors")
"""Suffixes of files of trained weights. Not .pth, which in a wheel is a list of folders."""

_ROOT = "root-component"
_KEPT = ("type", "bom-ref", "name", "version", "description", "purl")

Json = dict[str, Any]


def make_sbom(root: Path, version: str) -> str:
    """Make the SBOM of the product in this environment. Raises ReleaseError where it would not be a valid one."""
    read = _environment(root)
    brought = brought_by(product_extras(root))
    installed = {normalised(each["name"]): each for each in read["components"]}
    ours = [_vendored(root, each) for each in vendored_libraries(root)]
    wheels = [_wheel(installed[name], extras) for name, extras in sorted(brought.items()) if name in installed]
    graph = _graph(read["dependencies"], {each["bom-ref"] for each in wheels}, [each["bom-ref"] for each in ours])
    document = {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": SPEC.to_version(),
        "version": 1,
        "metadata": _metadata(read["metadata"], version, sorted(brought.keys() - installed.keys())),
        "components": [*wheels, *ours],
        "dependencies": graph,
    }
    return _valid(json.dumps(document, indent=2, ensure_ascii=False) + "\n")


def absent(sbom: str) -> list[str]:
    """The distributions that an SBOM leaves out, because they were not installed where it was made.

    Such is meshoptimizer where there is no C++ compiler to build it.
    """
    return [each["value"] for each in json.loads(sbom)["metadata"]["properties"] if each["name"] == f"{PRODUCT}:absent"]


def python_components(sbom: str) -> dict[str, Json]:
    """The distributions that an SBOM lists, by normalised name."""
    components = json.loads(sbom)["components"]
    return {normalised(each["name"]): each for each in components if each.get("purl", "").startswith("pkg:pypi/")}


def _environment(root: Path) -> Json:
    """What cyclonedx-py reads from this interpreter's environment."""
    command = [sys.executable, "-m", "cyclonedx_py", "environment", "--pyproject", str(root / "pyproject.toml")]
    options = ["--output-reproducible", "--no-validate", "--sv", SPEC.to_version(), "--of", "JSON", sys.executable]
    read: Json = json.loads(output_of([*command, *options], "cyclonedx-py cannot read this environment"))
    return read


def _metadata(read: Json, version: str, absent: list[str]) -> Json:
    tools = [{key: tool[key] for key in ("type", "name", "version")} for tool in read["tools"]["components"]]
    component = {**read["component"], "bom-ref": _ROOT, "version": version, "purl": f"pkg:pypi/{PRODUCT}@{version}"}
    where = f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"
    properties = [_property("environment", where), *(_property("absent", each) for each in absent)]
    return {"tools": {"components": tools}, "component": component, "properties": [*read["properties"], *properties]}


def _wheel(read: Json, extras: tuple[str, ...]) -> Json:
    """A distribution. The addresses of its home are left out: the package URL leads there."""
    component = {key: read[key] for key in _KEPT if key in read}
    component |= {"scope": "optional" if extras else "required", "licenses": _licences(licence_of(read["name"]))}
    if extras:
        component["properties"] = [_property("extras", ", ".join(extras))]
    if inside := [*_bundled_gpl(read), *_bundled_weights(read)]:
        component["components"] = inside
    return component


def _bundled_gpl(read: Json) -> list[Json]:
    bundled = sorted(GPL_BUNDLED.get(normalised(read["name"]), ()))
    return [
        {"type": "library", "bom-ref": f"{read['bom-ref']}/{each}", "name": each, "licenses": _licences(GPL)}
        for each in bundled
    ]


def _bundled_weights(read: Json) -> list[Json]:
    """Weights among a wheel's files, hashed by themselves: a wheel's own list may leave hashes out."""
    installed = distribution(read["name"])
    names = [line.partition(",")[0] for line in (installed.read_text("RECORD") or "").splitlines()]
    files = sorted(
        name for name in names if name.endswith(WEIGHTS) and "/test_" not in name
    )  # PyTorch brings one to test
    licence = licence_of(read["name"])
    return [_model(f"{read['bom-ref']}/{name}", Path(str(installed.locate_file(name))), licence) for name in files]


def _model(ref: str, path: Path, licence: str) -> Json:
    model = {"type": "machine-learning-model", "bom-ref": ref, "name": path.name}
    return {**model, "hashes": _hashes(path), "licenses": _licences(licence)}


def _vendored(root: Path, library: VendoredLibrary) -> Json:
    files = [library.notice, *library.files]
    ref = f"{library.name}@{library.version}"
    return {
        "type": "library",
        "bom-ref": ref,
        "name": library.name,
        "version": library.version,
        "purl": library.purl,
        "licenses": _licences(library.licence),
        "components": [
            {"type": "file", "bom-ref": f"{ref}/{path.name}", "name": path.as_posix(), "hashes": _hashes(root / path)}
            for path in files
        ],
    }


def _graph(read: list[Json], wheels: set[str], ours: list[str]) -> list[Json]:
    """Who depends on whom, without the tools of development."""
    kept = [each for each in read if each["ref"] in wheels or each["ref"] == _ROOT]
    graph = {each["ref"]: [ref for ref in each.get("dependsOn", ()) if ref in wheels] for each in kept}
    graph[_ROOT] = [*graph[_ROOT], *ours]
    return [{"ref": ref, "dependsOn": depends_on} for ref, depends_on in sorted(graph.items())]


def _licences(expression: str) -> list[Mapping[str, Any]]:
    return [{"expression": expression}] if is_expression(expression) else [{"license": {"name": expression}}]


def _hashes(path: Path) -> list[Mapping[str, str]]:
    return [{"alg": "SHA-256", "content": hashlib.sha256(path.read_bytes()).hexdigest()}]


def _property(name: str, value: str) -> Mapping[str, str]:
    return {"name": f"{PRODUCT}:{name}", "value": value}


def _valid(text: str) -> str:
    from cyclonedx.validation.json import JsonStrictValidator  # takes two seconds to load

    if fault := JsonStrictValidator(SPEC).validate_str(text):
        raise ReleaseError(f"the SBOM is not valid CycloneDX {SPEC.to_version()}: {fault}")
    return text
