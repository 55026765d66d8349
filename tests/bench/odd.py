"""Valid but odd files, of which it is known what they mean: read as that, read otherwise, refused, crashed.

`python -m tests.bench odd --count 10000` reads files 0 to 9,999 of `tests/support/odd`, as the product reads an upload,
400 in each process, and goes on where an earlier run of the same `--state` stopped. `--siblings` reads the inputs
that were once misread and siblings of them, each with a word on what is right.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

from tests.support.odd.odd_files import odd_file, verdict
from tests.support.odd.truth import judge_of

_AT_ONCE = 400  # a process takes seconds to start
_SECONDS = 3_600  # for the files of one process
_HOW = ("right", "wrong", "refused", "crashed")


@dataclass(frozen=True, slots=True)
class OddOutcome:
    """What became of a file: how it was read, one of `_HOW`, why, and the seconds."""

    number: int
    kind: str
    way: str
    around: str
    how: str
    why: str = ""
    seconds: float = 0.0


def main(arguments: list[str]) -> None:
    """Read files until there are as many as wanted, and print the table of all, or that of the siblings."""
    options = _parser().parse_args(arguments)
    if options.siblings:
        from tests.bench.odd_siblings import sibling_lines

        print(*sibling_lines(), sep="\n")
        return
    if options.child or options.only is not None:
        for number in options.child or [options.only]:
            print(json.dumps(asdict(_look_at(number))), flush=True)
        return
    state = Path(options.state)
    known = _outcomes(state)
    numbers = [number for number in range(options.count) if number not in known]
    parts = [numbers[start : start + _AT_ONCE] for start in range(0, len(numbers), _AT_ONCE)]
    with ThreadPoolExecutor(options.processes) as pool, state.open("a") as kept:
        for outcomes in pool.map(_read, parts):
            kept.writelines(json.dumps(asdict(each)) + "\n" for each in outcomes)
            kept.flush()
    print(*table([each for number, each in sorted(_outcomes(state).items()) if number < options.count]), sep="\n")


def table(outcomes: Sequence[OddOutcome]) -> Iterator[str]:
    """Yield the lines of a table, one for each kind, one for each way in which files were packed, and what is odd."""
    yield "| kind | files | right | wrong | refused | crashed | slowest, s |"
    yield "|---" * 7 + "|"
    kinds = sorted({each.kind for each in outcomes})
    ways = sorted({each.around for each in outcomes} - {"nothing"})
    rows = [(kind, [each for each in outcomes if each.kind == kind]) for kind in kinds]
    rows += [(f"of them: {way}", [each for each in outcomes if each.around == way]) for way in ways]
    for name, own in [*rows, ("**all**", outcomes)]:
        count = Counter(each.how for each in own)
        counts = [f"{number:,}" for number in (len(own), *(count[how] for how in _HOW))]
        yield f"| {name} | {' | '.join(counts)} | {max((each.seconds for each in own), default=0):.2f} |"
    yield ""
    for each in outcomes:
        if each.how != "right":
            yield f"- {each.number}: {each.kind}, {each.way}, around it {each.around}: {each.how}, {each.why}"


def _read(numbers: Sequence[int]) -> list[OddOutcome]:
    """Read files in a process of its own, and those behind one that ends the process in another."""
    found: list[OddOutcome] = []
    while len(found) < len(numbers):
        left = numbers[len(found) :]
        command = [sys.executable, "-m", "tests.bench.odd", "--child", *map(str, left)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_SECONDS, check=False)
            lines, ended = done.stdout, f"exit code {done.returncode}: {done.stderr.strip()[-200:]}"
        except subprocess.TimeoutExpired as late:
            lines = late.stdout.decode() if isinstance(late.stdout, bytes) else late.stdout or ""
            ended = f"over {_SECONDS} s"
        read = [OddOutcome(**json.loads(line)) for line in lines.splitlines() if line.startswith("{")]
        found += read
        if len(read) < len(left):
            found.append(_described(left[len(read)], "crashed", ended))
    return found


def _look_at(number: int) -> OddOutcome:
    file = odd_file(number)
    began = time.perf_counter()
    how, why = verdict(file.files, judge_of(file.truth))
    return _described(number, how, why, round(time.perf_counter() - began, 3))


def _described(number: int, how: str, why: str, seconds: float = 0.0) -> OddOutcome:
    file = odd_file(number)
    return OddOutcome(number, file.kind, file.way, file.around, how, why, seconds)


def _outcomes(state: Path) -> dict[int, OddOutcome]:
    if not state.exists():
        return {}
    return {(each := OddOutcome(**json.loads(line))).number: each for line in state.open()}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench odd", description=__doc__)
    parser.add_argument("--count", type=int, default=1_000, help="how many files (1,000)")
    parser.add_argument("--processes", type=int, default=2, help="how many read at the same time (2): 210 MB each")
    parser.add_argument(
        "--state", default="odd.jsonl", help="file of what was read, a line a file; the next run goes on"
    )
    parser.add_argument("--only", type=int, help="read the file of this number alone")
    parser.add_argument("--siblings", action="store_true", help="what was once misread, and siblings of it")
    parser.add_argument("--child", type=int, nargs="+", help=argparse.SUPPRESS)
    return parser


if __name__ == "__main__":
    main(sys.argv[1:])
