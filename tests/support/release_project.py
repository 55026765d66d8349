"""A project of three files in a git repository, as far as a release reads it; and throwaway keys."""

from __future__ import annotations

import subprocess
from pathlib import Path

_IDENTITY = ["-c", "user.name=Ada", "-c", "user.email=ada@example.org", "-c", "commit.gpgsign=false"]


def git(root: Path, *arguments: str) -> str:
    return subprocess.run(
        ["git", "-C", str(root), *_IDENTITY, *arguments], check=True, capture_output=True, text=True
    ).stdout


def commit_all(root: Path, message: str) -> None:
    git(root, "add", "--all")
    git(root, "commit", "--quiet", "--message", message)


def make_project(root: Path, *, version: str = "1.2.0", day: str = "2030-12-31", tag: str = "v1.2.0") -> None:
    """The repository of a version that can be released, or nearly."""
    (root / "services").mkdir(parents=True)
    (root / "pyproject.toml").write_text('[project]\nname = "capture2vr"\nversion = "1.2.0"\n')
    (root / "services" / "__init__.py").write_text(f'__version__ = "{version}"\n')
    (root / "CHANGELOG.md").write_text(
        f"# Changelog\n\n## 1.2.0 ({day})\n\n### Added\n- Wings.\n\n## 1.1.0 (2030-01-01)\n\nOld.\n"
    )
    git(root.parent, "init", "--quiet", "--initial-branch=main", str(root))
    commit_all(root, "Wings")
    git(root, "tag", tag)


def make_key(path: Path, kind: str = "ed25519") -> str:
    """Make a key pair; the line that allows it to sign."""
    options = ["-q", "-t", kind, "-N", "", "-C", "throwaway", "-f", str(path)]
    subprocess.run(["ssh-keygen", *options], check=True, capture_output=True)
    kind_of_key, public, _ = path.with_suffix(".pub").read_text().split()
    return f'capture2vr namespaces="capture2vr-release" {kind_of_key} {public}\n'
