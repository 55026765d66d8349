"""What other processes were started with; one that ends while it is looked at counts as none."""

from __future__ import annotations

from contextlib import suppress

import psutil


def command_of(process: psutil.Process) -> list[str]:
    """The command line of `process`; empty when it has ended or may not be looked into."""
    with suppress(psutil.Error):
        return process.cmdline()
    return []


def setting_of(process: psutil.Process, name: str) -> str:
    """The environment variable `name` that `process` was started with; empty when it has none, or has ended."""
    with suppress(psutil.Error):
        return process.environ().get(name, "")
    return ""


def children_running(text: str) -> list[psutil.Process]:
    """This process's children, and theirs, that have `text` in their command lines."""
    below = psutil.Process().children(recursive=True)
    return [each for each in below if any(text in argument for argument in command_of(each))]
