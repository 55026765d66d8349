"""deploy/locks, which deploy/lock.sh writes: images install by hash, at the versions of constraints.txt."""

from __future__ import annotations

import re
import tomllib

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from release.project import pins
from tests.support.repository import ROOT

LOCKS = ROOT / "deploy" / "locks"
EXTRAS = {"gateway": ("gateway", "storage", "postgres", "traces"), "edge": ("edge", "storage", "fast", "traces")}
_PINS = {canonicalize_name(name): version for name, version in pins(ROOT).items()}
_ENTRY = re.compile(r"^(\S+)==(\S+)( ; .+)? \\\n((?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)", re.MULTILINE)


def locked(name: str) -> dict[str, str]:
    """The versions of a lock that Linux installs, by package. Every line belongs to an entry with hashes."""
    text = (LOCKS / f"{name}.txt").read_text()
    entries = list(_ENTRY.finditer(text))
    assert "".join(entry.group(0) for entry in entries) == text
    return {entry[1]: entry[2] for entry in entries if entry[3] != " ; sys_platform == 'win32'"}


@pytest.mark.parametrize("name", sorted(path.stem for path in LOCKS.iterdir()))
def test_versions_are_those_of_the_constraints(name: str) -> None:
    versions = locked(name)
    others = {package for package, version in versions.items() if _PINS.get(package) != version}
    assert not others & _PINS.keys(), "bash deploy/lock.sh"
    # CUDA is nothing that the tests' environment has, and neither are some tools that build wheels.
    assert not others or name in ("build", "cuda")


@pytest.mark.parametrize("image", EXTRAS)
def test_a_lock_has_all_that_the_image_needs(image: str) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    of_extras = (text for extra in EXTRAS[image] for text in project["optional-dependencies"][extra])
    texts = [*project["dependencies"], *of_extras]
    needed = {canonicalize_name(Requirement(text).name) for text in texts} - {"capture2vr"}
    apart = locked("cuda") if image == "edge" else {}
    assert needed <= locked(image).keys() | apart.keys(), "bash deploy/lock.sh"
    extras = [f"--extra {extra}" for extra in EXTRAS[image]]
    assert f"lock pyproject.toml {' '.join(extras)}" in (ROOT / "deploy" / "lock.sh").read_text()


@pytest.mark.parametrize("image", ["gateway", "store"])
def test_an_image_installs_by_hash_alone(image: str) -> None:
    """The worker's, which may take PyTorch from elsewhere, is run in test_deploy.py."""
    text = (ROOT / "deploy" / f"{image}.Dockerfile").read_text().replace("\\\n", "")
    asked = re.findall(r"/bin/pip (.*?)(?: &&|$)", text, re.MULTILINE)
    assert asked
    for line in asked:
        fetches_nothing = line == "check" or "--no-index" in line or line.endswith("--no-build-isolation -w /wheels .")
        assert "--require-hashes" in line or fetches_nothing, line
