"""A real Postgres for the tests: a cluster of its own on a free port, removed at the end."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from services.cli.up import free_port

_START_S = 30.0  # 1 s on an idle machine


def programs() -> Path | None:
    """The folder of the newest server's programs; Debian keeps them off the PATH."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/postgres"), key=lambda path: int(path.parts[4]))
    return found[-1].parent if found else None


@contextmanager
def running(programs: Path) -> Iterator[str]:
    """The URL of an empty database, for SQLAlchemy. Postgres refuses to run as root, so root lends it a user."""
    user = ["runuser", "-u", "postgres", "--"] if os.geteuid() == 0 else []
    folder, port = Path(tempfile.mkdtemp(prefix="pg-")), free_port()
    try:
        if user:
            shutil.chown(folder, "postgres")
        data = folder / "data"
        initialise = [*user, programs / "initdb", "-D", data, "-A", "trust", "-U", "test", "-N"]
        subprocess.run(initialise, check=True, capture_output=True, cwd=folder)
        flags = ["-D", data, "-p", str(port), "-k", folder, "-h", "127.0.0.1"]
        with (folder / "log").open("wb") as log:
            server = subprocess.Popen([*user, programs / "postgres", *flags], stdout=log, stderr=log, cwd=folder)
        try:
            _wait([programs / "pg_isready", "-h", "127.0.0.1", "-p", str(port)], folder / "log")
            yield f"postgresql+psycopg://test@127.0.0.1:{port}/postgres"
        finally:
            server.terminate()
            server.wait(_START_S)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _wait(is_ready: list[str | Path], log: Path) -> None:
    deadline = time.monotonic() + _START_S
    while subprocess.run(is_ready, capture_output=True).returncode != 0:
        if time.monotonic() > deadline:
            raise RuntimeError(f"Postgres did not start: {log.read_text()[-1000:]}")
        time.sleep(0.1)
