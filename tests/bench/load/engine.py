"""Throughput of 16 jobs on a real Ray cluster of 1, 2 and 4 nodes of one core, on this machine.

`python -m tests.bench engine`. The tasks only sleep, for as long as a capture was measured to take: four nodes that
computed on two cores would measure the cores. What is left is what the engine costs: placing a task, starting a process
for it, and handing its result on.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence

from capture2vr.edge.engine.address import open_engine
from capture2vr.edge.engine.nouns import Engine, Needs, wait_for_all
from tests.bench.data_files import DataMissing
from tests.support.network import own_network
from tests.support.repository import ROOT
from tests.support.workers import engine_tasks
from tests.support.workers.ray_cluster import ADDRESS, RayCluster, running

_NODES = (1, 2, 4)
_GOAL = 0.8  # of the throughput of one node, times the number of nodes
_ONE = Needs(cpus=1)
_SECONDS = 21.9  # of a scanned room of 196,133 points: results/pipeline.md


def main(arguments: list[str]) -> None:
    """Print one row for each number of nodes."""
    options = _parser().parse_args(arguments)
    if options.inside:
        _print_rows(options.jobs, options.seconds)
        return
    asked = (f"--jobs={options.jobs}", f"--seconds={options.seconds}")
    command = own_network.command("tests.bench.load.engine", "--inside", *asked)
    if command is None:
        raise DataMissing("a network namespace is needed: run as root, or allow user namespaces")
    print(f"{options.jobs} pretend tasks, which sleep for {options.seconds:.1f} s each\n", flush=True)
    subprocess.run(command, cwd=ROOT, check=True)


def _print_rows(jobs: int, seconds: float) -> None:
    print(f"{'nodes':>5} {'seconds':>8} {'jobs a minute':>14} {'of k x one node':>16}", flush=True)
    first = 0.0
    with running() as cluster, open_engine(ADDRESS, Needs()) as engine:
        for nodes, took in _runs(cluster, engine, jobs, seconds):
            first = first or took
            share = first / took / nodes
            below = "" if share >= _GOAL else f" < {_GOAL}"
            print(f"{nodes:>5} {took:>8.1f} {60 * jobs / took:>14.1f} {share:>16.2f}{below}", flush=True)


def _runs(cluster: RayCluster, engine: Engine, jobs: int, seconds: float) -> Iterator[tuple[int, float]]:
    """Yield each number of nodes, and the seconds from the first submission to the last result."""
    there = 0
    for nodes in _NODES:
        cluster.start_nodes(**{f"node{number}": "" for number in range(there, nodes)})
        there = nodes
        _finish(engine, [1.0] * nodes)  # the first task on a node waits for Ray's own services there
        began = time.monotonic()
        _finish(engine, [seconds] * jobs)
        yield nodes, time.monotonic() - began


def _finish(engine: Engine, seconds: Sequence[float]) -> None:
    tasks = [engine.submit(_ONE, engine_tasks.rest, each) for each in seconds]
    wait_for_all(tasks, lambda _: None)
    for task in tasks:
        task.result(0)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.bench engine", description=__doc__)
    parser.add_argument("--jobs", type=int, default=16)
    parser.add_argument("--seconds", type=float, default=_SECONDS, help="for which a task sleeps")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    return parser


if __name__ == "__main__":  # in the network namespace
    main(sys.argv[1:])
