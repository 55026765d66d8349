"""Somebody who asks the stack all the time, and repeats what breaks off, as clients do."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

import httpx

from tests.referees.docker.stack import Stack
from tests.support.patience import PATIENCE_S

_PAUSE_S = 0.05
_TRIES = 5  # of one request, which then has failed
_AGAIN_S = 1.0  # before each but the first: the edge cache looks gateways' names up every five seconds
_AWAY = {502, 503, 504}


class Load:
    """Requests by what became of them.

    answered, repeated, failed  at once; after more tries; not at all
    """

    def __init__(self, stack: Stack) -> None:
        self._url = f"{stack.url}/v1/jobs?limit=1"
        self._counts = Counter[str]()
        self._stop = threading.Event()

    def ask(self) -> None:
        """Ask until told to stop."""
        while not self._stop.wait(_PAUSE_S):
            tries = next((number for number in range(_TRIES) if self._is_answered(number)), None)
            self._counts["failed" if tries is None else "repeated" if tries else "answered"] += 1

    def _is_answered(self, number: int) -> bool:
        time.sleep(_AGAIN_S if number else 0.0)
        try:
            return httpx.get(self._url, timeout=PATIENCE_S).status_code not in _AWAY
        except httpx.TransportError:
            return False

    @property
    def failed(self) -> int:
        return self._counts["failed"]

    def __str__(self) -> str:
        return f"{self._counts.total()} requests, {self._counts['repeated']} repeated, {self.failed} failed"

    def stop(self) -> None:
        self._stop.set()


@contextmanager
def asked_meanwhile(stack: Stack) -> Iterator[Load]:
    """Ask while the block runs."""
    load = Load(stack)
    thread = threading.Thread(target=load.ask)
    thread.start()
    try:
        yield load
    finally:
        load.stop()
        thread.join()
