"""`python -m tests.bench NAME`: the tables of tests/bench/README.md. Compare timings within one run only."""

from __future__ import annotations

import importlib
import os
import platform
import sys

BENCHES = {
    "quality": "Chamfer, F-score, pieces, borders of the first mesh on the yardstick shapes",
    "extraction": "seconds, memory and topology of the extraction, 64 to 256 cells",
    "pipeline": "capture to published LOD set: seconds per stage and peak memory",
    "uploads": "32 phones uploading 20 MB each: answers, gateway memory, latency of GET job",
}


def main(arguments: list[str]) -> int:
    """Run the named bench, or all of them."""
    name, *rest = arguments or [""]
    if name not in {*BENCHES, "all"}:
        print("usage: python -m tests.bench NAME\n")
        for bench, what in {**BENCHES, "all": "everything"}.items():
            print(f"  {bench:<11} {what}")
        return 2
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}\n")
    for bench in BENCHES if name == "all" else [name]:
        print(f"## {bench}\n")
        importlib.import_module(f"tests.bench.{bench}").main(rest)
        print()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
