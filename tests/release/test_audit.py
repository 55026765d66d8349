"""Audits: a vulnerability that a service knows of fails, a service that cannot be asked does not."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from release.audit import Audit, Vulnerability, audit_javascript, audit_python, unaccepted
from release.errors import ReleaseError
from release.project import pins
from release.vendored import FOLDER
from tests.conftest import missing
from tests.support.network.vulnerability_service import ABSENT, BUSY, SILENT, VulnerabilityService, serving
from tests.support.patience import HANG_S
from tests.support.repository import ROOT

pytestmark = pytest.mark.slow

PYTHON = {
    "id": "PYSEC-2030-7",
    "aliases": ["CVE-2030-0007"],
    "summary": "a name of many dots takes minutes",
    "affected": [
        {
            "package": {"name": "idna", "ecosystem": "PyPI"},
            "ranges": [{"type": "ECOSYSTEM", "events": [{"introduced": "0"}, {"fixed": "99.1"}]}],
        }
    ],
}
JAVASCRIPT = {
    "id": 1,
    "url": "https://github.com/advisories/GHSA-2222-3333-4444",
    "title": "a file runs code",
    "severity": "high",
    "vulnerable_versions": "<0.999.0",
}


@pytest.fixture(autouse=True)
def _node() -> None:
    if shutil.which("npm") is None:
        missing("npm")


def test_a_vulnerability_fails_and_is_named_with_what_fixes_it() -> None:
    """By what `make audit` runs, which asks about every pin of this checkout."""
    with serving(VulnerabilityService({"idna": [PYTHON]}, {"three": [JAVASCRIPT]})) as service:
        command = [sys.executable, "-m", "release", "audit"]
        environment = {**os.environ, **service.environment}
        ended = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=HANG_S)
    assert ended.returncode == 1
    assert f"idna {pins(ROOT)['idna']}: PYSEC-2030-7, fixed in 99.1" in ended.stderr
    assert "three 0.187.0: GHSA-2222-3333-4444, versions <0.999.0; fixed by three 0.999.0" in ended.stderr
    assert "accepted_vulnerabilities.toml" in ended.stderr
    assert "Traceback" not in ended.stderr
    assert ended.stdout.count(", 1 known vulnerability\n") == 2
    assert service.asked_python == pins(ROOT)
    lock = json.loads((ROOT / "package-lock.json").read_text())["packages"]
    tools = {path.rpartition("node_modules/")[2] for path in lock} - {""}
    vendored = {"three", "earcut", "meshoptimizer", "tus-js-client", "js-base64", "3d-tiles-renderer"}
    vendored |= {"@sparkjsdev/spark", "fflate"}
    assert service.asked_javascript == tools | vendored


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A project with one package of each kind."""
    (tmp_path / "constraints.txt").write_text("idna==3.20\n")
    packages = {"": {"name": "small"}, "node_modules/globals": {"version": "17.14.0"}}
    lock = {"name": "small", "lockfileVersion": 3, "requires": True, "packages": packages}
    (tmp_path / "package-lock.json").write_text(json.dumps(lock))
    shutil.copytree(ROOT / FOLDER, tmp_path / FOLDER)
    return tmp_path


def _asked(
    audit: Callable[[Path, int], Audit], root: Path, service: VulnerabilityService, patch: pytest.MonkeyPatch
) -> Audit:
    for name, value in service.environment.items():
        patch.setenv(name, value)
    return audit(root, 1)


@pytest.mark.parametrize("audit", [audit_python, audit_javascript])
def test_nothing_known_passes(
    audit: Callable[[Path, int], Audit], small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with serving(VulnerabilityService()) as service:
        found = _asked(audit, small, service, monkeypatch)
    assert (found.vulnerabilities, found.not_audited) == ((), "")
    assert str(found).endswith("no known vulnerability")


@pytest.mark.parametrize("audit", [audit_python, audit_javascript])
@pytest.mark.parametrize(("state", "says"), [(BUSY, "503"), (SILENT, "time"), (ABSENT, "refused")])
def test_a_service_that_cannot_answer_passes_and_that_is_said(
    audit: Callable[[Path, int], Audit], state: str, says: str, small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with serving(VulnerabilityService({"idna": [PYTHON]}, {"three": [JAVASCRIPT]}, state)) as service:
        found = _asked(audit, small, service, monkeypatch)
    assert found.vulnerabilities == ()
    assert says in found.not_audited.lower()
    assert "not audited" in str(found)
    assert "\n" not in str(found)
    assert unaccepted(ROOT, [found]) == []


@pytest.mark.parametrize(
    ("audit", "file", "content"),
    [
        (audit_python, "constraints.txt", "idna>=3\n"),
        (
            audit_javascript,
            "package-lock.json",
            '{"packages": {"": {}, "node_modules/b": {"link": true, "resolved": "b"}}}',
        ),
    ],
)
def test_a_project_that_cannot_be_audited_is_an_error(
    audit: Callable[[Path, int], Audit], file: str, content: str, small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a broken file would pass for a service that is away."""
    (small / file).write_text(content)
    with serving(VulnerabilityService()) as service, pytest.raises(ReleaseError, match="audit failed"):
        _asked(audit, small, service, monkeypatch)


def test_a_vulnerability_with_a_reason_is_accepted_by_any_of_its_ids(tmp_path: Path) -> None:
    found = Vulnerability("idna", "3.20", ("PYSEC-2030-7", "CVE-2030-0007"), "no version fixes it")
    audits = [Audit("pip-audit", "constraints.txt", 1, (found,))]
    reasons = tmp_path / "release" / "accepted_vulnerabilities.toml"
    reasons.parent.mkdir()
    reasons.write_text('CVE-2030-0008 = "another"\n')
    assert unaccepted(tmp_path, audits) == [found]
    reasons.write_text('CVE-2030-0007 = "no name of a stranger is decoded"\n')
    assert unaccepted(tmp_path, audits) == []


def test_a_reason_says_more_than_that_there_is_one() -> None:
    from release.audit import accepted

    assert all(len(reason.split()) > 3 for reason in accepted(ROOT).values())
