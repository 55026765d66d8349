"""Measure cases one after another, each in a process of its own, and print them as the rows of a table."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterable, Sequence

from tests.bench.cell import ROOT


def print_cases(module: str, cases: Iterable[str], words: Sequence[str]) -> None:
    """Print the rows of the cases that have all the words; `python -m module CASE` prints a case's figures as JSON."""
    chosen = [case for case in cases if all(word in case for word in words)]
    for number, case in enumerate(chosen):
        command = [sys.executable, "-m", module, case]
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
        if done.returncode:
            raise SystemExit(done.stderr)
        figures = json.loads(done.stdout.splitlines()[-1])
        if not number:
            print(f"| capture | {' | '.join(figures)} |\n|{'---|' * (len(figures) + 1)}")
        print(f"| {case} | {' | '.join(map(str, figures.values()))} |", flush=True)
