"""Services as processes of their own, which are killed and come back."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from tests.support.repository import ROOT


class ServiceProcess:
    """A service that is killed and comes back."""

    def __init__(
        self, module: str, log: Path, *arguments: str, within: Sequence[str] = (), **variables: object
    ) -> None:
        """within: a command that runs another one, which it is given behind its own arguments"""
        self._command = [*within, sys.executable, "-m", module, *arguments]
        self._log = log
        self._environment = {**os.environ, **{name: str(value) for name, value in variables.items()}}
        self.start()

    def start(self) -> None:
        with self._log.open("ab") as log:
            self._running = subprocess.Popen(self._command, cwd=ROOT, env=self._environment, stdout=log, stderr=log)

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._running.pid

    def kill(self) -> None:
        """As a power cut: no handler runs."""
        self.end(signal.SIGKILL)

    @property
    def is_running(self) -> bool:
        return self._running.poll() is None

    def wait(self) -> int:
        """Wait until it has ended by itself; its exit status."""
        return self._running.wait()

    def end(self, number: signal.Signals) -> None:
        """Send a signal that ends it, and wait until it has ended."""
        self._running.send_signal(number)
        self._running.wait()


@contextmanager
def killed_at_the_end(*processes: ServiceProcess) -> Iterator[None]:
    try:
        yield
    finally:
        for process in processes:
            process.kill()
