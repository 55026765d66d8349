"""A real Postgres for the tests: a cluster of its own on a free port, removed at the end."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

from capture2vr.cli.up import free_port

_START_S = 30.0  # 1 s on an idle machine


def programs() -> Path | None:
    """The folder of the newest server's programs; Debian keeps them off the PATH."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/postgres"), key=lambda path: int(path.parts[4]))
    return found[-1].parent if found else None


class PostgresServer:
    """A server with a cluster of its own in a folder, which is made where there is none. Postgres refuses to run as
    root, so root lends it a user.
    """

    def __init__(self, programs: Path, folder: Path) -> None:
        self._programs, self._folder, self._port = programs, folder, free_port()
        self._user = ["runuser", "-u", "postgres", "--"] if os.geteuid() == 0 else []
        if self._user:
            shutil.chown(folder, "postgres")
        text = ["-E", "UTF8", "--locale", "C"]  # the machine's own locale may be none
        initialise = [programs / "initdb", "-D", folder / "data", "-A", "trust", "-U", "test", "-N", *text]
        if not (folder / "data").exists():
            subprocess.run([*self._user, *initialise], check=True, capture_output=True, cwd=folder)

    @property
    def url(self) -> str:
        """The URL of a database, for SQLAlchemy."""
        return f"postgresql+psycopg://test@127.0.0.1:{self._port}/postgres"

    def start(self) -> None:
        """Start the server, and wait until it answers."""
        flags = ["-D", self._folder / "data", "-p", str(self._port), "-k", self._folder, "-h", "127.0.0.1"]
        with (self._folder / "log").open("ab") as log:
            command = [*self._user, self._programs / "postgres", *flags]
            self._running = subprocess.Popen(command, stdout=log, stderr=log, cwd=self._folder)
        _wait([self._programs / "pg_isready", "-h", "127.0.0.1", "-p", str(self._port)], self._folder / "log")

    def kill(self) -> None:
        """End it as a power cut does. What was committed is there when it starts again."""
        first = psutil.Process(self.pid)
        serving = first.children()
        for process in (first, *serving):
            with suppress(psutil.NoSuchProcess):
                process.kill()
        psutil.wait_procs((first, *serving), _START_S)
        self._running.wait(_START_S)
        (self._folder / "data" / "postmaster.pid").unlink()

    @property
    def pid(self) -> int:
        """Its first process, whose children serve connections."""
        return int((self._folder / "data" / "postmaster.pid").read_text().splitlines()[0])

    def stop(self) -> None:
        """Stop the server. Connections are cut, and what was not committed is rolled back."""
        stop = [self._programs / "pg_ctl", "stop", "-D", self._folder / "data", "-m", "fast"]
        subprocess.run([*self._user, *stop], check=True, capture_output=True, cwd=self._folder)
        self._running.wait(_START_S)


@contextmanager
def running_server(programs: Path) -> Iterator[PostgresServer]:
    """A server that a test may stop and start again."""
    folder = Path(tempfile.mkdtemp(prefix="pg-"))
    try:
        server = PostgresServer(programs, folder)
        server.start()
        try:
            yield server
        finally:
            server.stop()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def running(programs: Path) -> Iterator[str]:
    """The URL of an empty database, for SQLAlchemy."""
    with running_server(programs) as server:
        yield server.url


def _wait(is_ready: list[str | Path], log: Path) -> None:
    deadline = time.monotonic() + _START_S
    while subprocess.run(is_ready, capture_output=True).returncode != 0:
        if time.monotonic() > deadline:
            raise RuntimeError(f"Postgres did not start: {log.read_text()[-1000:]}")
        time.sleep(0.1)
