"""A real S3 server for the tests: Ceph's RADOS Gateway, started on free ports, stopped and removed at the end."""

from __future__ import annotations

import os
import secrets
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

_PACKAGES = ("radosgw", "ceph-mon", "ceph-osd", "ceph-common", "curl")
_START_S = 180.0  # 3 s on an idle machine with two cores
_STOP_S = 20.0
_INSTALL_S = 600.0


@dataclass(frozen=True, slots=True)
class S3Server:
    endpoint: str
    access_key: str
    secret_key: str
    folder: Path


def available() -> bool:
    """Whether the server's programs are installed, installing them where this process may."""
    if shutil.which("radosgw") and shutil.which("ceph-mon") and shutil.which("ceph-osd"):
        return True
    if os.geteuid() != 0 or not shutil.which("apt-get"):
        return False
    for command in (("update",), ("install", "-y", "--no-install-recommends", *_PACKAGES)):
        environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        done = subprocess.run(("apt-get", *command), env=environment, capture_output=True, timeout=_INSTALL_S)
        if done.returncode:
            return False
    return True


@contextmanager
def running() -> Iterator[S3Server]:
    """The server, until the block ends."""
    # Not below pytest's own folder: the path of the admin sockets in it must stay under 108 bytes.
    folder = Path(tempfile.mkdtemp(prefix="rgw-"))
    port, access, secret = _two_free_ports(), "test-access", secrets.token_hex(16)
    script = Path(__file__).with_name("rgw-up.sh")
    log = folder / "up.log"
    try:
        with log.open("wb") as output:
            arguments = ("bash", str(script), str(folder), str(port), access, secret)
            done = subprocess.run(arguments, stdout=output, stderr=output, timeout=_START_S)
        if done.returncode:
            raise RuntimeError(f"the S3 server did not start: {log.read_text()[-2000:]}")
        yield S3Server(f"http://127.0.0.1:{port}", access, secret, folder)
    finally:
        _stop([int(file.read_text()) for file in folder.glob("*.pid")])
        shutil.rmtree(folder, ignore_errors=True)


def _two_free_ports() -> int:
    """A port that is free together with its successor."""
    while True:
        with socket.socket() as first, socket.socket() as second:
            first.bind(("127.0.0.1", 0))
            port = int(first.getsockname()[1])
            try:
                second.bind(("127.0.0.1", port + 1))
            except (OSError, OverflowError):
                continue
            return port


def _stop(pids: list[int]) -> None:
    """Kill the processes, whose data are deleted next: told to end, the gateway would take five seconds."""
    for pid in pids:
        if _alive(pid):
            os.kill(pid, signal.SIGKILL)
    deadline = time.monotonic() + _STOP_S
    while any(_alive(pid) for pid in pids) and time.monotonic() < deadline:
        time.sleep(0.02)


def _alive(pid: int) -> bool:
    """Whether the process runs; one that only waits to be reaped does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
