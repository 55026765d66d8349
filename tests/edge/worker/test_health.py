"""The container's health check against a worker of its own."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from capture2vr.cli.up import free_port
from capture2vr.edge.worker.health import is_alive, is_serving

pytestmark = pytest.mark.slow


def _check(environment: dict[str, str], *arguments: str) -> int:
    command = [sys.executable, "-m", "capture2vr.edge.worker.health", *arguments]
    return subprocess.run(command, env=environment).returncode


def test_the_check_follows_the_worker(tmp_path: Path) -> None:
    port = free_port()
    environment = {**os.environ, "EDGE_PORT": str(port), "EDGE_SCRATCH": str(tmp_path), "STORAGE_ROOT": str(tmp_path)}
    assert _check(environment) == 1, "nobody serves yet"
    worker = subprocess.Popen([sys.executable, "-m", "capture2vr.cli", "edge"], env=environment)
    try:
        deadline = time.monotonic() + 60
        while not is_serving(f"127.0.0.1:{port}"):
            assert worker.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.1)
        assert _check(environment) == _check(environment, "--alive") == 0
    finally:
        worker.send_signal(signal.SIGTERM)
        assert worker.wait(60) == 0
    assert _check(environment) == _check(environment, "--alive") == 1


def test_a_worker_that_hangs_is_not_alive() -> None:
    """Its port takes connections, for the kernel does so."""
    with socket.create_server(("127.0.0.1", 0)) as silent:
        assert not is_alive(f"127.0.0.1:{silent.getsockname()[1]}", timeout_s=0.5)


def test_a_device_that_is_not_there_stops_the_start_by_name(tmp_path: Path) -> None:
    environment = {**os.environ, "EDGE_DEVICE": "cuda:99", "EDGE_SCRATCH": str(tmp_path), "STORAGE_ROOT": str(tmp_path)}
    started = subprocess.run(
        [sys.executable, "-m", "capture2vr.cli", "edge"], env=environment, capture_output=True, text=True
    )
    assert started.returncode == 2
    assert "EDGE_DEVICE: there is no cuda:99: " in started.stderr
    assert "Traceback" not in started.stderr
