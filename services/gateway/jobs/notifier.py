"""Notifies coroutines of this process that wait for changes of a job."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager


class JobNotifier:
    """Wakes listeners of a job: `with notifier.listen(job) as news: await news.wait()`. Event loop thread only."""

    def __init__(self) -> None:
        self._listeners: defaultdict[str, set[asyncio.Event]] = defaultdict(set)

    @contextmanager
    def listen(self, job: str) -> Iterator[asyncio.Event]:
        """Yield an asyncio.Event that is set at every change of the job; clear it before reading the job."""
        news = asyncio.Event()
        self._listeners[job].add(news)
        try:
            yield news
        finally:
            self._listeners[job].discard(news)
            if not self._listeners[job]:
                del self._listeners[job]

    def notify(self, job: str) -> None:
        """Wake the tasks that wait for news of the job, such as event streams."""
        for news in self._listeners.get(job, ()):
            news.set()

    def notify_all(self) -> None:
        """Wake all listeners, of every job."""
        for job in tuple(self._listeners):
            self.notify(job)

    @property
    def listener_count(self) -> int:
        """Number of listeners, over all jobs."""
        return sum(map(len, self._listeners.values()))
