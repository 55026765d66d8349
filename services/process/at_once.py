"""Call functions that wait for something else, several at a time."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

_MOST = 16

_T = TypeVar("_T")


def at_once(calls: Sequence[Callable[[], _T]]) -> list[_T]:
    """Call functions in threads, at most 16 at a time, and return what they return, in their order.

    Raises what the first that fails raises, after all have ended. In a process that ends they are called one by one:
    it starts no more threads.
    """
    if len(calls) < 2 or not threading.main_thread().is_alive():
        return [call() for call in calls]
    with ThreadPoolExecutor(min(_MOST, len(calls))) as pool:
        return list(pool.map(lambda call: call(), calls))
