"""`python -m tests.parts`: all tests, in parts of about the same length. A killed run goes on with the part it was in.

pytest-split would cut between the tests of one server; here the files that share a process stay in one part.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path
from statistics import median
from xml.etree import ElementTree

from tests.support.repository import ROOT
from tests.support.suite.groups import group_of

PARTS = 12
SECONDS = ROOT / "tests" / "durations.json"
"""File -> seconds that its tests took, written by --record. A file that is not in it counts as one in the middle."""

_STATE = ROOT / ".pytest_cache" / "parts.json"
_NO_TESTS = 5  # pytest's status where all tests of the files are left out


def files_of_tests() -> list[str]:
    """All files of tests, relative to the checkout."""
    return sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "tests").rglob("test_*.py"))


def split(files: Iterable[str], seconds: dict[str, float], count: int) -> list[list[str]]:
    """Share files among parts, the longest group first: where it costs no time, or into the part that stays shortest.

    A part takes as long as its longest group, which one process runs, or as all of its groups on two cores.
    """
    usual = median(seconds.values()) if seconds else 1.0
    groups = defaultdict[str, list[str]](list)
    for file in files:
        groups[group_of(file)].append(file)
    cost = {name: sum(seconds.get(file, usual) for file in group) for name, group in groups.items()}
    parts: list[list[str]] = [[] for _ in range(count)]
    longest, totals = [0.0] * count, [0.0] * count

    def length_with(part: int, added: float) -> float:
        return max(longest[part], added, (totals[part] + added) / 2)

    for name in sorted(groups, key=lambda name: (-cost[name], name)):
        added = cost[name]
        free = [part for part in range(count) if length_with(part, added) == length_with(part, 0.0)]
        best = min(free or range(count), key=lambda part: (length_with(part, added), totals[part]))
        parts[best] += groups[name]
        longest[best] = max(longest[best], added)
        totals[best] += added
    return parts


def run_parts(
    numbers: Iterable[int], run: Callable[[int], bool], state: Path, tree: str, within_s: float = float("inf")
) -> tuple[list[int], list[int]]:
    """Run those parts that have not passed yet for this state of the checkout; those that failed, and those not begun.

    run       runs a part; whether it passed
    state     file of the parts that passed, with the `tree` they passed for
    within_s  no part begins later than so many seconds from now
    """
    known = json.loads(state.read_text()) if state.exists() else {}
    passed: list[int] = known["passed"] if known.get("tree") == tree else []
    failed, waiting, began = list[int](), list[int](), time.monotonic()
    for number in numbers:
        if number in passed:
            continue
        if time.monotonic() - began >= within_s:
            waiting.append(number)
        elif run(number):
            passed.append(number)
            state.parent.mkdir(exist_ok=True)
            state.write_text(json.dumps({"tree": tree, "passed": passed}))
        else:
            failed.append(number)
    return failed, waiting


def _tree(count: int) -> str:
    """A hash of the commit, of what differs from it, and of the number of parts."""
    commands = (["rev-parse", "HEAD"], ["diff", "HEAD"], ["status", "--porcelain"])
    said = [subprocess.run(["git", "-C", ROOT, *command], capture_output=True).stdout for command in commands]
    return hashlib.sha256(b"\n".join([*said, str(count).encode()])).hexdigest()


def _pytest(files: list[str], processes: str, report: Path) -> bool:
    """Run pytest on files in a process of its own."""
    if not files:
        return True
    command = [sys.executable, "-m", "pytest", "-n", processes, f"--junitxml={report}", *files]
    return subprocess.run(command, cwd=ROOT).returncode in (0, _NO_TESTS)


def seconds_in(report: Path, files: Iterable[str]) -> dict[str, float]:
    """How long the tests of each file took, as pytest's report (JUnit's XML) tells it."""
    modules = {file.removesuffix(".py").replace("/", "."): file for file in files}
    found = defaultdict[str, float](float)
    for case in ElementTree.parse(report).iter("testcase"):
        name = case.get("classname", "")
        while name and name not in modules:  # a class in a module
            name = name.rpartition(".")[0]
        if name:
            found[modules[name]] += float(case.get("time", 0))
    return {file: round(seconds, 1) for file, seconds in sorted(found.items())}


def _record(known: dict[str, float], report: Path, files: list[str]) -> None:
    """Note how long files took, and forget those that are gone."""
    known.update(seconds_in(report, files))
    there = {file: known[file] for file in files_of_tests() if file in known}
    SECONDS.write_text(json.dumps(there, indent=0) + "\n")


def _share(text: str) -> tuple[int, int]:
    """Read `3/12`. Raises ValueError."""
    number, count = map(int, text.split("/"))
    if not 1 <= number <= count:
        raise ValueError
    return number, count


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.parts", description=__doc__)
    parser.add_argument("part", nargs="?", type=_share, help="3/12: the third of twelve parts, passed before or not")
    parser.add_argument("-n", dest="processes", default="3", help="processes side by side")
    parser.add_argument("--within", type=float, help="begin no part after so many seconds, nor always with the first")
    parser.add_argument("--record", action="store_true", help=f"note in {SECONDS.name} how long each file took")
    return parser.parse_args()


def _runner(options: argparse.Namespace, count: int) -> Callable[[int], bool]:
    """What runs a part, and says whether it passed."""
    known = json.loads(SECONDS.read_text()) if SECONDS.exists() else {}
    parts = split(files_of_tests(), known, count)

    def run(number: int) -> bool:
        files, began, report = parts[number - 1], time.monotonic(), _STATE.with_name(f"part-{number}.xml")
        passed = _pytest(files, options.processes, report)
        verdict = "passed" if passed else "failed"
        print(f"part {number} of {count} {verdict} after {time.monotonic() - began:.0f} s", flush=True)
        if options.record and files:
            _record(known, report, files)
        return passed

    return run


def _run_all(options: argparse.Namespace) -> int:
    """Run all parts, from the first, or where not all may have time, from one that the commit chooses."""
    tree = _tree(PARTS)
    first, within = (0, float("inf")) if options.within is None else (int(tree[:8], 16), options.within)
    order = [(first + step) % PARTS + 1 for step in range(PARTS)]
    failed, waiting = run_parts(order, _runner(options, PARTS), _STATE, tree, within)
    print(
        f"all tests: {PARTS - len(failed) - len(waiting)} of {PARTS} parts have passed for this state of the checkout"
    )
    for what, numbers in (("failed", failed), ("not begun", waiting)):
        if numbers:
            print(f"{what}: {', '.join(f'make test-all PART={number}/{PARTS}' for number in numbers)}")
    return int(bool(failed))


def main() -> int:
    """Run one part or all; 1 where one failed."""
    options = _arguments()
    if options.part is None:
        return _run_all(options)
    number, count = options.part
    return int(not _runner(options, count)(number))


if __name__ == "__main__":
    sys.exit(main())
