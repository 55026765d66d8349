"""Run a program, and say in one sentence what went wrong."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

from release.errors import ReleaseError

_LAST = 500  # characters of a complaint, whose end says most


class ProgramAbsentError(ReleaseError):
    """A program that is not installed."""


def run(
    command: Sequence[str], *, cwd: Path | None = None, content: str | None = None, timeout_s: float | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a program to its end, with `content` as its input and without a shell.

    Raises ProgramAbsentError, and subprocess.TimeoutExpired after `timeout_s`.
    """
    try:
        return subprocess.run(  # noqa: S603 - no shell, and all words are the project's own
            command, cwd=cwd, input=content, capture_output=True, text=True, timeout=timeout_s
        )
    except FileNotFoundError:
        raise ProgramAbsentError(f"{command[0]} is not installed") from None


def output_of(command: Sequence[str], why: str, *, cwd: Path | None = None, content: str | None = None) -> str:
    """What a program prints. Raises ReleaseError, `why` and the program's complaint, where it fails."""
    ended = run(command, cwd=cwd, content=content)
    if ended.returncode != 0:
        raise ReleaseError(f"{why}: {(ended.stderr or ended.stdout).strip()[-_LAST:]}")
    return ended.stdout
