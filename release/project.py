"""What a release is called: its version and changes, in the files that say so and in git."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from release.distributions import normalised
from release.errors import ReleaseError
from release.process import output_of

_HEADING = re.compile(r"^## (?P<version>\S+) \((?P<day>[^)]*)\)$", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Changes:
    """The newest section of CHANGELOG.md. day: None while it is unreleased; text: Markdown without the heading"""

    version: str
    day: date | None
    text: str


def project_version(root: Path) -> str:
    """The version in pyproject.toml."""
    return str(tomllib.loads((root / "pyproject.toml").read_text())["project"]["version"])


def newest_changes(root: Path) -> Changes:
    """Read the newest section of CHANGELOG.md. Raises ReleaseError where its heading is not `## VERSION (DAY)`."""
    text = (root / "CHANGELOG.md").read_text()
    headings = list(_HEADING.finditer(text))
    if not headings:
        raise ReleaseError("CHANGELOG.md has no heading of the form: ## 1.2.3 (2030-12-31)")
    end = headings[1].start() if len(headings) > 1 else len(text)
    newest = headings[0]
    return Changes(newest["version"], _day(newest["day"]), text[newest.end() : end].strip())


def pins(root: Path) -> dict[str, str]:
    """Normalised name -> version, as constraints.txt has them."""
    lines = (root / "constraints.txt").read_text().split()
    return {normalised(name): version for name, _, version in (line.partition("==") for line in lines)}


def git(root: Path, *arguments: str) -> str:
    """What git prints. Raises ReleaseError with what it complains about."""
    return output_of(["git", "-C", str(root), *arguments], f"git {arguments[0]}").strip()


def previous_tag(root: Path) -> str | None:
    """The last version tag before this commit, or None before the second release."""
    tags = git(root, "tag", "--list", "v*", "--merged", "HEAD", "--no-contains", "HEAD", "--sort=-version:refname")
    return tags.partition("\n")[0] or None


def _day(text: str) -> date | None:
    if text == "unreleased":
        return None
    try:
        return date.fromisoformat(text)
    except ValueError:
        raise ReleaseError(f"CHANGELOG.md: {text} is no day: write it as 2030-12-31, or unreleased") from None
