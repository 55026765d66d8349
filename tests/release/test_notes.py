"""A release's notes repeat the vulnerabilities that are accepted, and why."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from release.audit import Audit, Vulnerability
from release.notes import write_notes
from tests.support.release_project import commit_all, make_project
from tests.support.repository import ROOT


def test_an_accepted_vulnerability_stands_in_the_notes_with_its_reason(tmp_path: Path) -> None:
    make_project(tmp_path)
    with (tmp_path / "pyproject.toml").open("a") as project:
        project.write('[project.optional-dependencies]\nedge = ["numpy"]\ndev = ["pytest"]\n')
    (tmp_path / "release").mkdir()
    shutil.copy(ROOT / "release" / "notes.md", tmp_path / "release")
    (tmp_path / "release" / "accepted_vulnerabilities.toml").write_text(
        'CVE-2030-0007 = "no stranger\'s name is read"\n'
    )
    commit_all(tmp_path, "Notes")
    sbom = tmp_path / "capture2vr-1.2.0.cdx.json"
    properties = [{"name": "capture2vr:environment", "value": "Python 3.11.7, Linux x86_64"}]
    sbom.write_text(json.dumps({"specVersion": "1.6", "components": [], "metadata": {"properties": properties}}))
    found = Vulnerability("idna", "3.20", ("PYSEC-2030-7", "CVE-2030-0007"), "no version fixes it")
    audits = [Audit("pip-audit", "constraints.txt", 170, (found,)), Audit("npm audit", "package-lock.json", 97)]
    section = write_notes(tmp_path, [sbom], audits).read_text().partition("## Known vulnerabilities\n")[2]
    assert section.partition("\n\n")[0].splitlines() == [
        "- pip-audit: 170 packages of constraints.txt, 1 known vulnerability",
        "- npm audit: 97 packages of package-lock.json, no known vulnerability",
        "- idna 3.20: PYSEC-2030-7, no version fixes it; no stranger's name is read",
    ]
