"""`LocalEngine`: runs each task in a process of its own on this machine, in the order in which they were submitted."""

from __future__ import annotations

import os
import pickle
import subprocess
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from threading import Lock, Thread
from typing import Any

from capture2vr.edge.engine.nouns import ATTEMPTS, Needs, Result, Submitted, Work, lost
from capture2vr.edge.errors import EdgeError
from capture2vr.process.child_start import python_command, start_child

_CHILD = "capture2vr.edge.engine.local_child"


@dataclass(slots=True)
class _Waiting:
    """A task that waits for its turn. order: what the child is to do, pickled"""

    task: Submitted[Any]
    needs: Needs
    order: bytes


class LocalEngine:
    """Runs tasks while their needs together are within `room`. A task that needs more than that runs alone."""

    def __init__(self, room: Needs) -> None:
        self._room = self._free = room
        self._waiting: deque[_Waiting] = deque()
        self._running: list[Submitted[Any]] = []
        self._lock = Lock()
        self._closed = False

    def submit(self, needs: Needs, work: Work[Result], *inputs: Any) -> Submitted[Result]:
        task = Submitted[Result]()
        waiting = _Waiting(task, _at_most(needs, self._room), pickle.dumps((work, inputs)))
        with self._lock:
            if self._closed:
                raise EdgeError("ENGINE_LOST", "the local engine was closed; send the task again", retryable=True)
            self._waiting.append(waiting)
            self._start_what_fits()
        return task

    def close(self) -> None:
        with self._lock:
            self._closed = True
            left = [*(each.task for each in self._waiting), *self._running]
            self._waiting.clear()
        for task in left:
            task.cancel()

    def _start_what_fits(self) -> None:
        """Start the first tasks of the queue that fit; the lock is held. None overtakes another: it might never end."""
        while self._waiting and (self._waiting[0].task.future.done() or _fits(self._waiting[0].needs, self._free)):
            waiting = self._waiting.popleft()
            if not waiting.task.future.done():
                self._free = _less(self._free, waiting.needs)
                self._running.append(waiting.task)
                Thread(target=self._supervise, args=(waiting,), name="task", daemon=True).start()

    def _supervise(self, waiting: _Waiting) -> None:
        try:
            _run(waiting.task, waiting.order, waiting.needs)
        except Exception as error:  # noqa: BLE001 - whatever it is, who waits for the task must hear of it
            waiting.task.end(error=error)
        with self._lock:
            self._running.remove(waiting.task)
            self._free = _less(self._free, _negative(waiting.needs))
            self._start_what_fits()


def _run(task: Submitted[Any], order: bytes, needs: Needs) -> None:
    """Run a task in a child process, and again where that is killed."""
    for _ in range(ATTEMPTS):
        child = _start(needs)
        task.stop = child.kill
        if task.future.done():  # cancelled before `stop` was known
            child.kill()
        with child:
            _send(child, order)
            _follow(child, task)
        if task.future.done():
            return
    task.end(error=lost(ATTEMPTS))


def _start(needs: Needs) -> subprocess.Popen[bytes]:
    threads = str(max(1, int(needs.cpus)))
    environment = {**os.environ, "OMP_NUM_THREADS": threads}
    command = python_command("-m", _CHILD)
    return start_child(command, environment=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE)


def _send(child: subprocess.Popen[bytes], order: bytes) -> None:
    assert child.stdin is not None
    with suppress(BrokenPipeError), child.stdin:
        child.stdin.write(order)


def _follow(child: subprocess.Popen[bytes], task: Submitted[Any]) -> None:
    """Read what a child says until it has ended: its progress, then its result or error, unless it is killed."""
    assert child.stdout is not None
    with suppress(EOFError, pickle.UnpicklingError):  # it was killed, perhaps in the middle of a word
        while True:
            kind, value = pickle.load(child.stdout)  # noqa: S301 - of our own child
            match kind:
                case "fraction":
                    task.fraction = value
                case "result":
                    task.end(result=value)
                case _:
                    task.end(error=value)


def _each(first: Needs, second: Needs, rule: Callable[[Any, Any], Any]) -> Needs:
    return Needs(
        rule(first.cpus, second.cpus),
        rule(first.gpus, second.gpus),
        rule(first.memory_bytes, second.memory_bytes),
    )


def _at_most(needs: Needs, room: Needs) -> Needs:
    return _each(needs, room, min)


def _less(room: Needs, needs: Needs) -> Needs:
    return _each(room, needs, lambda has, takes: has - takes)


def _negative(needs: Needs) -> Needs:
    return Needs(-needs.cpus, -needs.gpus, -needs.memory_bytes)


def _fits(needs: Needs, free: Needs) -> bool:
    left = _less(free, needs)
    return min(left.cpus, left.gpus, left.memory_bytes) >= -1e-9  # shares of a core are no exact numbers
