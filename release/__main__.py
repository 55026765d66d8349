"""`python -m release sbom | audit | dist | publish`: what the targets of the Makefile run."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from release.agreement import check_agreement, check_environment
from release.artefacts import SUMS, build_artefacts, write_sbom, write_sums
from release.audit import Audit, audit_all, unaccepted
from release.errors import ReleaseError
from release.notes import write_notes
from release.sbom import absent
from release.signing import sign

ROOT = Path(__file__).resolve().parents[1]

app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False)


@app.command()
def sbom() -> None:
    """Write the SBOM into dist/."""
    path = write_sbom(ROOT)
    typer.echo(path.relative_to(ROOT))
    for name in absent(path.read_text()):
        typer.echo(f"sbom: {name} is not installed here, so the SBOM lacks it", err=True)


@app.command()
def audit() -> None:
    """Ask OSV and npm about all pinned versions. Exit code 1: they know of a vulnerability that is not accepted.

    A service that cannot be asked fails nothing here; a release waits until it can.
    """
    _audited()


@app.command()
def dist() -> None:
    """Build wheel, source distribution, SBOM and SHA256SUMS in dist/, whatever the state of the tree."""
    files = build_artefacts(ROOT)
    write_sums(files, ROOT / "dist" / SUMS)
    _list_files()


@app.command()
def publish(
    key: Annotated[Path, typer.Option(exists=True, help="Ed25519 key of OpenSSH, or its .pub if an agent holds it.")],
) -> None:
    """Check, build, audit, describe and sign a release in dist/: what is to be uploaded."""
    check_agreement(ROOT)
    audits = _audited()
    if unanswered := [str(each) for each in audits if each.not_audited]:
        hint = "a release needs both answers: try again where both services can be reached"
        raise ReleaseError("\n".join([*unanswered, hint]))
    files = build_artefacts(ROOT)
    (sbom,) = (file for file in files if file.name.endswith(".cdx.json"))
    check_environment(ROOT, sbom.read_text())
    notes = write_notes(ROOT, files, audits)
    sums = ROOT / "dist" / SUMS
    write_sums([*files, notes], sums)
    sign(ROOT, sums, key.absolute())
    _list_files()


def _audited() -> list[Audit]:
    """Audit, and say what was found. Raises ReleaseError where that is not accepted."""
    audits = audit_all(ROOT)
    for each in audits:
        typer.echo(each)
    if found := unaccepted(ROOT, audits):
        hint = "pin a version without it, or give a reason in release/accepted_vulnerabilities.toml"
        raise ReleaseError("\n".join([*map(str, found), hint]))
    return audits


def _list_files() -> None:
    for path in sorted((ROOT / "dist").iterdir()):
        typer.echo(path.relative_to(ROOT))


if __name__ == "__main__":
    try:
        app()
    except ReleaseError as fault:
        sys.exit(f"release: {fault}")
