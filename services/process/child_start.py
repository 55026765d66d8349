"""Start the child processes of the product so that they import installed modules alone, never a stranger's.

Python puts the current folder first on its search path for `-m` and `-c`, where a capture may hold a `json.py`.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any


def python_command(*arguments: str | Path) -> list[str | Path]:
    """Return the command that runs this interpreter with arguments. -P: without the current or the program's folder."""
    return [sys.executable, "-P", *arguments]


def start_child(
    command: Sequence[str | Path], *, environment: Mapping[str, str] | None = None, **options: Any
) -> subprocess.Popen[bytes]:
    """Start a program, with the options of `subprocess.Popen`. Raises OSError where no process can be started.

    environment  its variables; None: those of this process. PYTHONSAFEPATH is added, so that any Python that the
                 program starts in turn ignores the current folder as well
    """
    variables = {**(os.environ if environment is None else environment), "PYTHONSAFEPATH": "1"}
    return subprocess.Popen(command, env=variables, **options)  # noqa: S603 - callers pass our own programs
