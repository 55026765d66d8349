"""Who waits for news of which job, within this process."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager


class Hub:
    """`with hub.listen(job) as news: await news.wait()`; a `notify` wakes every listener. Loop thread only."""

    def __init__(self) -> None:
        self._listeners: defaultdict[str, set[asyncio.Event]] = defaultdict(set)

    @contextmanager
    def listen(self, job: str) -> Iterator[asyncio.Event]:
        """An event that is set at each news of the job; the listener clears it before it looks."""
        news = asyncio.Event()
        self._listeners[job].add(news)
        try:
            yield news
        finally:
            self._listeners[job].discard(news)
            if not self._listeners[job]:
                del self._listeners[job]

    def notify(self, job: str) -> None:
        """Something was written about the job."""
        for news in self._listeners.get(job, ()):
            news.set()

    @property
    def listening(self) -> int:
        """How many listeners there are, over all jobs."""
        return sum(map(len, self._listeners.values()))
