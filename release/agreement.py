"""Check that version, changelog, tag, tree and environment agree before a release is made."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from release.errors import ReleaseError
from release.project import git, newest_changes, pins, project_version
from release.sbom import absent, python_components

_ANY_VERSION = ("nvidia-", "cuda-")
"""What only PyTorch's CUDA build brings: that build itself names the versions."""


def check_agreement(root: Path) -> None:
    """Raises ReleaseError with all that does not agree, a sentence for each."""
    _refuse([*_version_faults(root), *_git_faults(root)])


def check_environment(root: Path, sbom: str) -> None:
    """Raises ReleaseError where the environment of the SBOM is not the one that constraints.txt pins."""
    pinned = pins(root)
    faults = [f"{name} is not installed, so the SBOM would lack it: make test-setup" for name in absent(sbom)]
    for name, component in python_components(sbom).items():
        version = component["version"].partition("+")[0]  # 2.13.0+cpu is a build of 2.13.0
        if pinned.get(name) != version and not name.startswith(_ANY_VERSION):
            says = f"pins {pinned[name]}" if name in pinned else "does not pin it"
            faults.append(f"{name} {version} is installed, but constraints.txt {says}: make test-setup, or pin it")
    _refuse(faults)


def _version_faults(root: Path) -> Iterator[str]:
    version, changes = project_version(root), newest_changes(root)
    found = re.search(r'^__version__ = "(.+)"$', (root / "services" / "__init__.py").read_text(), re.MULTILINE)
    if found is None or found[1] != version:
        yield f"pyproject.toml says version {version}, services/__init__.py says {found and found[1]}: change one"
    if changes.version != version:
        yield f"pyproject.toml says version {version}, CHANGELOG.md begins with {changes.version}: change one"
    if changes.day is None:
        yield f"CHANGELOG.md calls {changes.version} unreleased: write the day instead"


def _git_faults(root: Path) -> Iterator[str]:
    tag = f"v{project_version(root)}"
    if strays := git(root, "status", "--porcelain"):
        yield f"the tree has changes that are in no commit: commit or remove them\n{strays}"
    if not git(root, "tag", "--list", tag):
        yield f"there is no tag {tag}: git tag {tag}"
    elif git(root, "rev-list", "-n", "1", tag) != git(root, "rev-parse", "HEAD"):
        yield f"the tag {tag} is on another commit: check it out, or release another version"


def _refuse(faults: list[str]) -> None:
    if faults:
        raise ReleaseError("\n".join(faults))
