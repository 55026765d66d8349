"""Fill the template of a release's notes: changes, files with their hashes, SBOM, known vulnerabilities."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from string import Template
from typing import Any

from release import signing
from release.artefacts import sha256
from release.audit import Audit, Vulnerability, accepted
from release.distributions import PRODUCT, product_extras
from release.project import git, newest_changes, previous_tag

NOTES = "RELEASE-NOTES.md"
_TEMPLATE = Path("release", "notes.md")


def write_notes(root: Path, artefacts: Sequence[Path], audits: Sequence[Audit]) -> Path:
    """Write the notes beside the artefacts, one of which is the SBOM."""
    (sbom,) = (path for path in artefacts if path.name.endswith(".cdx.json"))
    listed = json.loads(sbom.read_text())
    changes = newest_changes(root)
    text = Template((root / _TEMPLATE).read_text()).substitute(
        version=changes.version,
        day=changes.day,
        commit=git(root, "rev-parse", "HEAD"),
        since=_since(root),
        changes=changes.text.replace("### ", "## "),
        files="\n".join(f"| `{path.name}` | {path.stat().st_size:,} | `{sha256(path)}` |" for path in artefacts),
        sbom=sbom.name,
        sbom_sha256=sha256(sbom),
        spec=listed["specVersion"],
        components=len(listed["components"]),
        extras=", ".join(f"`{extra}`" for extra in product_extras(root)),
        environment=_environment(listed),
        vulnerabilities=_vulnerabilities(root, audits),
        identity=signing.IDENTITY,
        namespace=signing.NAMESPACE,
    )
    path = sbom.with_name(NOTES)
    path.write_text(text)
    return path


def _environment(sbom: dict[str, Any]) -> str:
    properties = {each["name"]: each["value"] for each in sbom["metadata"]["properties"]}
    return str(properties[f"{PRODUCT}:environment"])


def _since(root: Path) -> str:
    if (tag := previous_tag(root)) is None:
        return "the first release"
    count = git(root, "rev-list", "--count", f"{tag}..HEAD")
    return f"{count} {'commit' if count == '1' else 'commits'} since `{tag}`"


def _vulnerabilities(root: Path, audits: Sequence[Audit]) -> str:
    reasons = accepted(root)
    lines = [str(audit) for audit in audits]
    lines += [f"{each}; {_reason(each, reasons)}" for audit in audits for each in audit.vulnerabilities]
    return "\n".join(f"- {line}" for line in lines)


def _reason(vulnerability: Vulnerability, reasons: dict[str, str]) -> str:
    return next(reasons[each] for each in vulnerability.ids if each in reasons)
