"""`RayEngine`: runs tasks on a Ray cluster, wherever their needs are free. Needs the extra `ray`.

Ray places the tasks, keeps their inputs and results in its object store, and begins a task anew elsewhere when its node
is lost. This engine speaks to the cluster's head as a client (port 10001); every node has the same version of
capture2vr installed.
"""

from __future__ import annotations

import logging
import socket
import time
from threading import Event, Lock, Thread
from typing import Any
from urllib.parse import urlsplit
from uuid import uuid4

import ray

import capture2vr
from capture2vr.edge.engine.local_child import sendable
from capture2vr.edge.engine.nouns import ATTEMPTS, Needs, Result, Submitted, Work, lost
from capture2vr.edge.errors import EdgeError

_POLL_S = 0.5  # between two looks at what has ended
_REPORT_S = 0.5  # between two reports of a task's progress
_KNOCK_S = 5.0  # for a TCP connection to the head
_CONNECTS = 3  # attempts
_REASON = 300  # characters of Ray's reason that are shown: it may be a page
_PROGRESS_S = 5.0  # wait for the actor of the progress: its node may just be lost
_LARGE_BYTES = 100_000  # an input of more goes to the object store once; smaller ones travel with the task, as in Ray

_log = logging.getLogger(__name__)


class RayEngine:
    """Tasks on the cluster whose head is at `address`, ray://host:port. One for a process, as Ray's client is."""

    def __init__(self, address: str) -> None:
        """Connect. Raises EdgeError ENGINE_LOST, which names the head."""
        self._address = address
        self._tasks: dict[Any, tuple[str, Submitted[Any]]] = {}
        self._lock, self._closed = Lock(), Event()
        self._fault: EdgeError | None = None  # since when nobody looks any more at what has ended
        try:
            _knock(address)
            _connect(address)
            # On no core of its own; made anew where its node is lost, with what tasks report from then on.
            self._progress: Any = ray.remote(num_cpus=0, max_restarts=-1)(_Progress).remote()
        except Exception as error:
            raise self._lost(error) from error
        Thread(target=self._watch, name="ray", daemon=True).start()

    def submit(self, needs: Needs, work: Work[Result], *inputs: Any) -> Submitted[Result]:
        name, task = uuid4().hex, Submitted[Result]()
        run = ray.remote(
            num_cpus=needs.cpus,
            num_gpus=needs.gpus,
            memory=needs.memory_bytes,
            max_retries=ATTEMPTS - 1,
            max_calls=1,  # a process for each task: what it has left in memory goes with it
        )(_run)
        try:
            placed = [ray.put(each) if _is_large(each) else each for each in inputs]
            reference = run.remote(capture2vr.__version__, self._progress, name, work, *placed)
            hash(reference)  # waits for the head's answer, which may be a refusal
        except Exception as error:
            raise self._lost(error) from error
        task.stop = lambda: self._kill(reference)
        with self._lock:
            if self._fault:
                raise self._fault
            self._tasks[reference] = name, task
        return task

    def close(self) -> None:
        with self._lock:
            left = [task for _, task in self._tasks.values()]
        for task in left:
            task.cancel()
        self._closed.set()
        ray.shutdown()

    def _kill(self, reference: Any) -> None:
        """Stop a task on its node; its end is known here already."""
        with self._lock:
            self._tasks.pop(reference, None)
        try:
            ray.cancel(reference, force=True)
        except Exception as error:  # noqa: BLE001 - the head may be gone, and the task with it
            _log.info("a task of %s could not be cancelled: %s", self._address, error)

    def _watch(self) -> None:
        """End the tasks here that have ended there, until the engine is closed or the head is lost."""
        while not self._closed.wait(_POLL_S):
            try:
                self._look()
            except Exception as error:  # noqa: BLE001 - Ray's client raises any kind once it has lost the head
                if not self._closed.is_set():
                    self._give_up(self._lost(error))
                return

    def _look(self) -> None:
        with self._lock:
            tasks = dict(self._tasks)
        if not tasks:
            return
        ended, _ = ray.wait(list(tasks), num_returns=len(tasks), timeout=_POLL_S)
        for reference in ended:
            _end(tasks[reference][1], reference)
            with self._lock:  # not before: where the head is lost meanwhile, the task ends with all others
                self._tasks.pop(reference, None)
        self._read_progress({name: task for reference, (name, task) in tasks.items() if reference not in ended})

    def _read_progress(self, tasks: dict[str, Submitted[Any]]) -> None:
        try:
            fractions: dict[str, float] = ray.get(self._progress.all.remote(), timeout=_PROGRESS_S)
        except (ray.exceptions.RayActorError, ray.exceptions.GetTimeoutError):
            return
        for name, task in tasks.items():
            task.fraction = max(task.fraction, fractions.get(name, 0.0))

    def _give_up(self, error: EdgeError) -> None:
        with self._lock:
            self._fault = error
            tasks = [task for _, task in self._tasks.values()]
            self._tasks.clear()
        for task in tasks:
            task.end(error=error)

    def _lost(self, error: Exception) -> EdgeError:
        reason = " ".join([type(error).__name__, *str(error).split("\n")[-3:]]).strip()[:_REASON]
        return EdgeError(
            "ENGINE_LOST",
            f"the Ray head at {self._address} cannot be reached or used: {reason}",
            hints=("see that it runs, and that EDGE_ENGINE names its client port, 10001",),
            retryable=True,
        )


class _Progress:
    """Actor that remembers what tasks report."""

    def __init__(self) -> None:
        self._fractions: dict[str, float] = {}

    def report(self, name: str, fraction: float) -> None:
        self._fractions[name] = fraction

    def forget(self, name: str) -> None:
        self._fractions.pop(name, None)

    def all(self) -> dict[str, float]:
        return self._fractions


def _run(version: str, progress: Any, name: str, work: Work[Any], *inputs: Any) -> tuple[str, Any]:
    """Run a task on its node; return ("result", value) or ("error", exception)."""
    if version != capture2vr.__version__:
        raised = f"a node has capture2vr {capture2vr.__version__}, and this is {version}"
        return "error", EdgeError("ENGINE_VERSION", raised, hints=("install the same version on every node",))
    last = 0.0

    def tick(fraction: float) -> None:
        nonlocal last
        if (now := time.monotonic()) - last > _REPORT_S:
            last = now
            progress.report.remote(name, fraction)  # not waited for: progress is no part of the work

    try:
        return "result", work(tick, *inputs)
    except Exception as error:  # noqa: BLE001 - it is raised where the result is waited for
        return "error", sendable(error)
    finally:
        progress.forget.remote(name)


def _end(task: Submitted[Any], reference: Any) -> None:
    """End a task as it has ended on its node. Raises what Ray's client does that has lost the head."""
    try:
        kind, value = ray.get(reference)
    except (ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError, ray.exceptions.OutOfMemoryError):
        task.end(error=lost(ATTEMPTS))
    except (ray.exceptions.ObjectLostError, ray.exceptions.TaskCancelledError, ray.exceptions.RayTaskError) as error:
        task.end(error=EdgeError("TASK_FAILED", str(error).strip().splitlines()[-1], retryable=True))
    else:
        task.end(**{kind: value})


def _connect(address: str) -> None:
    """Connect Ray's client; again where the head was too slow to start the process that serves this client."""
    for attempt in range(_CONNECTS):
        try:
            ray.init(address, namespace="capture2vr", log_to_driver=False, logging_level=logging.ERROR)
            return
        except ConnectionError as error:
            ray.shutdown()
            reason = str(error).strip().splitlines()[-1:]
            _log.info("%s did not take the connection, attempt %d: %s", address, attempt + 1, reason)
            if attempt == _CONNECTS - 1:
                raise


def _knock(address: str) -> None:
    """Raises OSError where nothing answers: Ray's client would wait half a minute, and then not say why."""
    parts = urlsplit(address)
    socket.create_connection((parts.hostname or "", parts.port or 0), _KNOCK_S).close()


def _is_large(value: Any) -> bool:
    return isinstance(value, bytes) and len(value) > _LARGE_BYTES
