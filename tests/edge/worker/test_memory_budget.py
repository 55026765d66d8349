"""The memory that jobs share: never more than there is, first come first served, and a wait that can be given up."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from capture2vr.edge.errors import Cancelled
from capture2vr.edge.worker import memory_budget as memory_module
from capture2vr.edge.worker.control_group import ControlGroup
from capture2vr.edge.worker.memory_budget import MemoryBudget, machine_bytes


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory_module, "_POLL_S", 0.01)


def no_wait() -> None:
    raise AssertionError("it had to wait")


def give_up() -> None:
    raise Cancelled


def test_what_fits_beside_another_does_not_wait() -> None:
    memory = MemoryBudget(10)
    with memory.reserve(6, no_wait), memory.reserve(4, no_wait), pytest.raises(Cancelled), memory.reserve(1, give_up):
        pass
    with memory.reserve(10, no_wait):
        pass


def test_more_than_there_is_takes_all_there_is() -> None:
    memory = MemoryBudget(10)
    with memory.reserve(99, no_wait), pytest.raises(Cancelled), memory.reserve(1, give_up):
        pass


def test_memory_is_given_back_whatever_happens() -> None:
    memory = MemoryBudget(10)
    with pytest.raises(ZeroDivisionError), memory.reserve(10, no_wait):
        raise ZeroDivisionError
    with memory.reserve(10, no_wait):
        pass


def test_jobs_never_hold_more_than_there_is() -> None:
    memory, held, most, lock = MemoryBudget(10), [0], [0], threading.Lock()

    def job(wanted: int) -> None:
        for _ in range(20):
            with memory.reserve(wanted, lambda: None):
                with lock:
                    held[0] += wanted
                    most[0] = max(most[0], held[0])
                time.sleep(0.0005)
                with lock:
                    held[0] -= wanted

    threads = [threading.Thread(target=job, args=(wanted,)) for wanted in (1, 3, 4, 6, 7, 10)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert not any(thread.is_alive() for thread in threads)
    assert 7 <= most[0] <= 10


def test_a_large_job_is_not_overtaken_for_ever() -> None:
    memory, order, waits = MemoryBudget(10), [], threading.Event()

    def large() -> None:
        with memory.reserve(10, waits.set):
            order.append("large")

    def small() -> None:
        with memory.reserve(1, lambda: None):
            order.append("small")

    with memory.reserve(5, no_wait):
        first = threading.Thread(target=large)
        first.start()
        assert waits.wait(5)
        second = threading.Thread(target=small)
        second.start()
        time.sleep(0.05)
        assert order == []
    first.join(5)
    second.join(5)
    assert order == ["large", "small"]


def test_a_share_of_the_machine_is_for_fits(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    whole = machine_bytes()
    assert whole > 1 << 28
    (tmp_path / "memory.max").write_text(f"{1 << 30}\n")
    monkeypatch.setattr(memory_module, "own_control_group", lambda: ControlGroup((tmp_path,)))
    assert machine_bytes() == int(0.6 * (1 << 30)) <= whole
