"""Ask the public services whether a version that the project pins has a known vulnerability.

pip-audit asks OSV about every line of constraints.txt. npm asks its registry about the tools of package-lock.json, and
about the npm packages inside the pages. A service that cannot be asked is no fault of the project: the audit then says
"not audited", and why, and no release is made. Other addresses are the tools' own settings: PIP_AUDIT_OSV_URL and
npm_config_registry.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from release.errors import ReleaseError
from release.process import ProgramAbsentError, run
from release.project import pins
from release.vendored import vendored_libraries

REQUEST_S = 15
"""Seconds that a service has for one answer."""
_ALL_S = 900  # for all answers: OSV is asked some 170 times, one after the other
_TOO_LONG = f"not all answers came within {_ALL_S} s"

_UNREACHED = re.compile(r"^(?:requests\.exceptions\.\w+: |ERROR:pip_audit\._cli:(?=Could not connect))(.+)$", re.M)


@dataclass(frozen=True, slots=True)
class Vulnerability:
    """A known vulnerability of a pinned version. ids: its own first, then those of other databases"""

    package: str
    version: str
    ids: tuple[str, ...]
    remedy: str

    def __str__(self) -> str:
        return f"{self.package} {self.version}: {self.ids[0]}, {self.remedy}"


@dataclass(frozen=True, slots=True)
class Audit:
    """What a service answered about `count` packages of a file; not_audited: why it did not, else empty"""

    tool: str
    source: str
    count: int
    vulnerabilities: tuple[Vulnerability, ...] = ()
    not_audited: str = ""

    def __str__(self) -> str:
        if self.not_audited:
            return f"{self.tool}: not audited: {self.source}: {self.not_audited}"
        count = len(self.vulnerabilities)
        found = f"{count or 'no'} known {'vulnerability' if count < 2 else 'vulnerabilities'}"
        return f"{self.tool}: {self.count} packages of {self.source}, {found}"


def audit_all(root: Path) -> list[Audit]:
    """Audit all that is pinned."""
    return [audit_python(root), audit_javascript(root)]


def accepted(root: Path) -> dict[str, str]:
    """Id of a vulnerability -> why it does no harm here."""
    return tomllib.loads((root / "release" / "accepted_vulnerabilities.toml").read_text())


def unaccepted(root: Path, audits: list[Audit]) -> list[Vulnerability]:
    """The vulnerabilities that nobody has given a reason to live with."""
    known = accepted(root).keys()
    return [each for audit in audits for each in audit.vulnerabilities if not known & set(each.ids)]


def audit_python(root: Path, request_s: int = REQUEST_S) -> Audit:
    """Audit constraints.txt by pip-audit. Raises ReleaseError where that fails for a reason of its own."""
    count = len(pins(root))
    command = [sys.executable, "-m", "pip_audit", "-r", "constraints.txt", "--no-deps", "--disable-pip", "-s", "osv"]
    command += ["--timeout", str(request_s), "-f", "json", "--progress-spinner", "off"]
    try:
        ended = run(command, cwd=root, timeout_s=_ALL_S)
    except subprocess.TimeoutExpired:
        return Audit("pip-audit", "constraints.txt", count, not_audited=_TOO_LONG)
    if ended.stdout.startswith("{"):
        return Audit("pip-audit", "constraints.txt", count, tuple(_python_vulnerabilities(json.loads(ended.stdout))))
    if reasons := _UNREACHED.findall(ended.stderr):
        return Audit("pip-audit", "constraints.txt", count, not_audited=reasons[-1])
    raise ReleaseError(f"pip-audit failed: {ended.stderr.strip()[-500:]}")


def _python_vulnerabilities(report: dict[str, Any]) -> Iterator[Vulnerability]:
    for package in report["dependencies"]:
        for each in package.get("vulns", ()):
            fixed = ", ".join(each["fix_versions"])
            remedy = f"fixed in {fixed}" if fixed else "no version fixes it"
            yield Vulnerability(package["name"], package["version"], (each["id"], *each["aliases"]), remedy)


def audit_javascript(root: Path, request_s: int = REQUEST_S) -> Audit:
    """Audit package-lock.json and the pages' libraries by npm. Raises ReleaseError where that fails by itself."""
    lock = _lock(root)
    source, count = "package-lock.json and services/web/vendor", len(lock["packages"]) - 1
    options = ["--json", "--package-lock-only", "--fetch-retries=0", f"--fetch-timeout={request_s * 1000}"]
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "package.json").write_text(json.dumps(lock["packages"][""]))
        Path(folder, "package-lock.json").write_text(json.dumps(lock))
        try:
            ended = run(["npm", "audit", *options], cwd=Path(folder), timeout_s=_ALL_S)
        except ProgramAbsentError as absent:
            return Audit("npm audit", source, count, not_audited=str(absent))
        except subprocess.TimeoutExpired:
            return Audit("npm audit", source, count, not_audited=_TOO_LONG)
    report = json.loads(ended.stdout or "{}")
    if "message" in report:  # of the request; an error of npm's own has a code instead
        return Audit("npm audit", source, count, not_audited=report["message"])
    if report.get("metadata", {}).get("dependencies", {}).get("total") != count:
        raise ReleaseError(f"npm audit failed on package-lock.json: {ended.stderr.strip()[-500:] or ended.stdout}")
    return Audit("npm audit", source, count, tuple(_javascript_vulnerabilities(report["vulnerabilities"], lock)))


def _lock(root: Path) -> dict[str, Any]:
    """package-lock.json as if the npm packages inside the pages had been installed too."""
    lock: dict[str, Any] = json.loads((root / "package-lock.json").read_text())
    for purl in (library.purl for library in vendored_libraries(root)):
        if purl.startswith("pkg:npm/"):
            name, version = unquote(purl.removeprefix("pkg:npm/")).rsplit("@", 1)
            lock["packages"][""].setdefault("dependencies", {})[name] = version
            lock["packages"][f"node_modules/{name}"] = {"version": version}
    return lock


def _javascript_vulnerabilities(report: dict[str, Any], lock: dict[str, Any]) -> Iterator[Vulnerability]:
    for name, package in report.items():
        version = lock["packages"][package["nodes"][0]]["version"]
        for each in package["via"]:
            if isinstance(each, dict):  # a name instead: the vulnerability of another package that it needs
                yield Vulnerability(name, version, (each["url"].rpartition("/")[2],), _npm_remedy(each, package))


def _npm_remedy(advisory: dict[str, Any], package: dict[str, Any]) -> str:
    """npm tells which versions are vulnerable, and what to update where there is a version that is not."""
    fix, vulnerable = package["fixAvailable"], f"versions {advisory['range']}"
    if not fix:
        return f"{vulnerable}; no version fixes it"
    return f"{vulnerable}; fixed by " + (f"{fix['name']} {fix['version']}" if isinstance(fix, dict) else "npm update")
