"""A release is made only where version, changelog, tag, tree and environment agree."""

from __future__ import annotations

import json
from datetime import date
from pathlib import Path

import pytest

from release.agreement import check_agreement, check_environment
from release.errors import ReleaseError
from release.project import newest_changes, previous_tag
from tests.support.release_project import commit_all, git, make_project
from tests.support.repository import ROOT


def test_what_agrees_passes(tmp_path: Path) -> None:
    make_project(tmp_path / "project")
    check_agreement(tmp_path / "project")


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"version": "1.1.9"}, r"services/__init__.py says 1\.1\.9"),
        ({"day": "unreleased"}, r"calls 1\.2\.0 unreleased"),
        ({"day": "tomorrow"}, "tomorrow is no day"),
        ({"tag": "v1.1.0"}, r"there is no tag v1\.2\.0"),
    ],
)
def test_what_does_not_agree_is_named(options: dict[str, str], complaint: str, tmp_path: Path) -> None:
    make_project(tmp_path / "project", **options)
    with pytest.raises(ReleaseError, match=complaint):
        check_agreement(tmp_path / "project")


def test_a_changelog_that_begins_with_another_version_is_named(tmp_path: Path) -> None:
    make_project(tmp_path)
    (tmp_path / "CHANGELOG.md").write_text("# Changelog\n\n## 1.3.0 (2031-01-01)\n\nMore.\n")
    with pytest.raises(ReleaseError, match=r"CHANGELOG\.md begins with 1\.3\.0"):
        check_agreement(tmp_path)


def test_a_tag_on_another_commit_and_a_stray_file_are_both_named(tmp_path: Path) -> None:
    make_project(tmp_path)
    (tmp_path / "feathers.txt").write_text("white")
    commit_all(tmp_path, "Feathers")
    (tmp_path / "stray.txt").write_text("?")
    with pytest.raises(ReleaseError) as refused:
        check_agreement(tmp_path)
    assert "the tag v1.2.0 is on another commit" in str(refused.value)
    assert "stray.txt" in str(refused.value)


def test_the_changes_are_those_of_the_newest_section(tmp_path: Path) -> None:
    make_project(tmp_path)
    changes = newest_changes(tmp_path)
    assert (changes.version, changes.day, changes.text) == ("1.2.0", date(2030, 12, 31), "### Added\n- Wings.")


def test_the_previous_tag_is_the_highest_version_before_this_commit(tmp_path: Path) -> None:
    make_project(tmp_path, tag="v1.9.0")
    assert previous_tag(tmp_path) is None
    for number, tag in enumerate(("v1.10.0", "w9.0.0", "v2.0.0")):
        (tmp_path / "count.txt").write_text(str(number))
        commit_all(tmp_path, tag)
        git(tmp_path, "tag", tag)
    assert previous_tag(tmp_path) == "v1.10.0"


def test_the_changelog_of_this_checkout_has_the_version_of_the_project() -> None:
    import capture2vr

    assert newest_changes(ROOT).version == capture2vr.__version__


def _sbom(*absent: str, **versions: str) -> str:
    components = [{"name": name, "version": each, "purl": f"pkg:pypi/{name}@{each}"} for name, each in versions.items()]
    properties = [{"name": "capture2vr:absent", "value": name} for name in absent]
    return json.dumps({"metadata": {"properties": properties}, "components": components})


def test_an_environment_other_than_the_pinned_one_is_named(tmp_path: Path) -> None:
    (tmp_path / "constraints.txt").write_text("torch==2.13.0\nnumpy==2.4.6\n")
    check_environment(tmp_path, _sbom(**{"torch": "2.13.0+cpu", "numpy": "2.4.6", "nvidia-nccl": "3"}))
    with pytest.raises(ReleaseError, match=r"numpy 2\.4\.5 is installed, but constraints\.txt pins 2\.4\.6"):
        check_environment(tmp_path, _sbom(numpy="2.4.5"))
    with pytest.raises(ReleaseError, match=r"scipy 1 is installed, but constraints\.txt does not pin it"):
        check_environment(tmp_path, _sbom(scipy="1"))
    with pytest.raises(ReleaseError, match="meshoptimizer is not installed, so the SBOM would lack it"):
        check_environment(tmp_path, _sbom("meshoptimizer"))
