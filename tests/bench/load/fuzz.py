"""Hostile files against a gateway and a worker in processes of their own: `python -m tests.bench fuzz --minutes 60`.

Each file is uploaded alone, so that what its check costs can be told: processor seconds and peak memory of the
processes that check and inspect it, and what it leaves behind. The numbers go on where an earlier run of the same
`--state` stopped. Wanted: no 5xx, no hang, no file above 5 processor seconds or 500 MB, and nothing left.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import httpx
import psutil

from capture2vr.cli.up import run_stack
from tests.bench.load.fuzz_files import Hostile, hostile
from tests.bench.load.product import PeakMemory, processor_seconds

_HANG_S = 300.0  # without an answer
_LEFT_S = 30.0  # after the answer, for folders to go
_MOST_SECONDS, _MOST_MB = 5.0, 500.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one file. status 0: no answer; seconds: of processors; mb: peak of one process"""

    number: int
    format: str
    way: str
    bytes: int
    status: int
    code: str
    seconds: float
    mb: float
    wall_s: float
    left: int

    @property
    def fault(self) -> str:
        """What is wrong with it, or ""."""
        if self.status == 0 or self.status >= 500:
            return self.code or str(self.status)
        if self.seconds > _MOST_SECONDS or self.mb > _MOST_MB:
            return f"{self.seconds:.1f} s, {self.mb:.0f} MB"
        return f"{self.left} left" if self.left else ""


def main(arguments: list[str]) -> None:
    """Send files until the time is over, then print the table of all that were sent."""
    options = _parser().parse_args(arguments)
    state = Path(options.state)
    numbers = [options.only] if options.only is not None else _after(state)
    deadline = time.monotonic() + 60 * options.minutes
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder, _service(Path(folder)) as service:
        for number in numbers:
            if time.monotonic() > deadline:
                break
            outcome = service.send(number, hostile(number))
            with state.open("a") as kept:
                kept.write(json.dumps(asdict(outcome)) + "\n")
            if outcome.fault:
                print(f"{number}: {outcome.format}, {outcome.way}: {outcome.fault}", flush=True)
    for line in table(_outcomes(state)):
        print(line)


def table(outcomes: list[Outcome]) -> Iterator[str]:
    """Yield the lines of a table, one for each format."""
    columns = ("format", "files", "accepted", "refused", "5xx or hung", "CPU s: median", "most", "MB: most", "left")
    yield f"| {' | '.join((*columns, 'over the limits'))} |"
    yield "|---" * (len(columns) + 1) + "|"
    formats = sorted({each.format for each in outcomes})
    for name, rows in [*((name, [o for o in outcomes if o.format == name]) for name in formats), ("**all**", outcomes)]:
        statuses = Counter(min(row.status // 100, 5) for row in rows)
        seconds = [row.seconds for row in rows]
        costly = sum(row.seconds > _MOST_SECONDS or row.mb > _MOST_MB for row in rows)
        cells = (len(rows), statuses[2], statuses[4], statuses[5] + statuses[0], f"{statistics.median(seconds):.2f}")
        most = (f"{max(seconds):.2f}", f"{max(row.mb for row in rows):.0f}", sum(row.left for row in rows), costly)
        yield f"| {name} | {' | '.join(map(str, (*cells, *most)))} |"
    codes = Counter(row.code for row in outcomes if row.code).most_common()
    yield ""
    yield "Refused as: " + ", ".join(f"{code} {count:,}" for code, count in codes)


class _Service:
    """A running gateway and worker."""

    def __init__(self, data: Path, client: httpx.Client) -> None:
        self._folders = [data / "gateway" / "uploads", data / "scratch"]
        self._client = client
        self._services = {
            name: next(each for each in psutil.Process().children() if name in each.cmdline()[-2:])
            for name in ("gateway", "edge")
        }
        self._quiet = self._left()

    def send(self, number: int, file: Hostile) -> Outcome:
        """Upload a file, and delete it where it was accepted."""
        before, began, peak = self._spent(), time.monotonic(), PeakMemory(self._services.values())
        with peak:
            status, code, capture = self._upload(file)
        wall_s = time.monotonic() - began
        left = self._wait_for_quiet()
        seconds = self._spent() - before
        if capture:
            self._client.delete(f"/v1/captures/{capture}")
        size = sum(map(len, file.files.values()))
        return Outcome(number, file.format, file.way, size, status, code, seconds, peak.mb, wall_s, left)

    def _upload(self, file: Hostile) -> tuple[int, str, str]:
        try:
            answer = self._client.post("/v1/captures", files=[("files", each) for each in file.files.items()])
            said = answer.json()
        except httpx.TimeoutException:
            return 0, "HUNG", ""
        except (httpx.TransportError, ValueError) as error:
            return 0, type(error).__name__, ""
        code = said.get("code", "") or ("" if said.get("inspected") else "NOT_INSPECTED")
        return answer.status_code, code, said.get("capture", "")

    def _spent(self) -> float:
        return processor_seconds(self._services.values())

    def _wait_for_quiet(self) -> int:
        """Wait until no more lies in the folders than at the start; return how much more there is in the end."""
        deadline = time.monotonic() + _LEFT_S
        while (left := len(self._left() - self._quiet)) and time.monotonic() < deadline:
            time.sleep(0.02)
        return left

    def _left(self) -> set[str]:
        return {f"{folder}/{name}" for top in self._folders for folder, _, names in os.walk(top) for name in names}


@contextmanager
def _service(folder: Path) -> Iterator[_Service]:
    os.environ.setdefault("EDGE_DEVICE", "cpu")
    with (
        run_stack("127.0.0.1", 0, folder / "data") as stack,
        httpx.Client(base_url=stack.url, timeout=_HANG_S) as client,
    ):
        client.post("/v1/captures", files=[("files", ("a.xyz", b"1 2 3\n"))])  # starts what is started at first use
        yield _Service(folder / "data", client)


def _outcomes(state: Path) -> list[Outcome]:
    if not state.exists():
        return []
    kept: Mapping[int, Outcome] = {(o := Outcome(**json.loads(line))).number: o for line in state.open()}
    return list(kept.values())


def _after(state: Path) -> Iterator[int]:
    """Yield the numbers of files that were not sent yet."""
    number = max((each.number for each in _outcomes(state)), default=-1)
    while True:
        yield (number := number + 1)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="how long to send files (10)")
    parser.add_argument(
        "--state", default="fuzz.jsonl", help="file of what was sent, a line a file; the next run goes on"
    )
    parser.add_argument("--only", type=int, help="send the file of this number alone")
    return parser
