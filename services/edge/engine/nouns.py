"""`Engine`: runs tasks in processes of this machine, or on a Ray cluster. What the two have in common.

A task is a function at the top level of a module, `work(tick, *inputs) -> result`. Machines share no disk: inputs and
result are values that can be pickled, and files are bytes. A task whose process was killed is begun anew, so it must
not mind having run before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, InvalidStateError, wait
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

from capture2vr.edge.arrays import Tick
from capture2vr.edge.errors import Cancelled, EdgeError
from capture2vr.sentences.sentence import say

ATTEMPTS = 4
"""How often a task is begun whose process is killed, or whose machine is lost."""

_POLL_S = 0.2  # between two ticks of who waits for results

Result = TypeVar("Result")
Work = Callable[..., Result]
"""A task: work(tick, *inputs)."""


@dataclass(frozen=True, slots=True)
class Needs:
    """What a task needs where it runs: CPU cores, GPUs (or a share of one), and memory in bytes."""

    cpus: float = 1.0
    gpus: float = 0.0
    memory_bytes: int = 0


@dataclass(slots=True)
class Submitted(Generic[Result]):
    """A task that was submitted. fraction: what it last reported as done, [0,1]; stop: kills its process"""

    future: Future[Result] = field(default_factory=Future)
    fraction: float = 0.0
    stop: Callable[[], None] = lambda: None

    def result(self, timeout_s: float | None = None) -> Result:
        """Block until the task has finished, and return its result.

        Raises what the task has raised; Cancelled; TimeoutError; EdgeError TASK_LOST where its process was killed each
        time, ENGINE_LOST where the engine itself is gone.
        """
        return self.future.result(timeout_s)

    def cancel(self) -> None:
        """Kill the task where it runs or take it out of the queue; nothing where it has ended."""
        if self.end(error=Cancelled("the task was cancelled")):
            self.stop()

    def end(self, *, result: Any = None, error: BaseException | None = None) -> bool:
        """End the task with a result or an error; return whether it had no end before."""
        try:
            if error is None:
                self.future.set_result(result)
            else:
                self.future.set_exception(error)
        except InvalidStateError:  # it was cancelled meanwhile
            return False
        return True


class Engine(Protocol):
    """Runs tasks, as many at once as there is room for by their needs."""

    def submit(self, needs: Needs, work: Work[Result], *inputs: Any) -> Submitted[Result]:
        """Submit a task: start it, or queue it until there is room. Raises EdgeError ENGINE_LOST."""
        ...

    def close(self) -> None:
        """Cancel what has not ended, and let go of the machines."""
        ...


OpenEngine = Callable[[], AbstractContextManager[Engine]]
"""Opens an engine for as long as somebody needs it. Raises EdgeError ENGINE_LOST."""


def wait_for_all(tasks: Sequence[Submitted[Any]], tick: Tick) -> None:
    """Wait until all tasks have ended, well or not. `tick` gets the mean fraction; if it raises, all are cancelled."""
    try:
        while not all(task.future.done() for task in tasks):
            tick(sum(1.0 if task.future.done() else task.fraction for task in tasks) / len(tasks))
            wait([task.future for task in tasks], _POLL_S)
    except BaseException:
        for task in tasks:
            task.cancel()
        raise


def lost(attempts: int) -> EdgeError:
    """Return the error of a task whose process was killed each time."""
    return EdgeError(
        "TASK_LOST",
        say("task_process_killed_times_perhaps", times=attempts),
        hints=(say("give_more_memory_let_fewer"),),
        retryable=True,
    )
