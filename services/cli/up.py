"""`capture2vr up`: run gateway, worker and a local store on this machine; restart services that die."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import httpx

from capture2vr.cli.progress import console, warn
from capture2vr.cli.stop_signals import exit_on_signals, stop_signals
from capture2vr.errors import BadInput
from capture2vr.process.child_start import python_command, start_child
from capture2vr.process.private_files import private_folder
from capture2vr.process.strict_settings import LOOPBACK

DEFAULT_PORT = 8080
_READY_S = 60.0  # timeout of the start; a cold start on a busy two-core machine takes 3 s
_STOP_S = 15.0  # timeout of the stop; longer than the worker's EDGE_DRAIN_S, set below
_DRAIN_S = 10  # seconds that the worker's running jobs get at the stop
_RESTART_PAUSE_S = 1.0
_RESTARTS = 20  # of dead services in all: after so many, another restart will not help


def serve_together(host: str, port: int, data: Path, *, everybody: bool = False) -> int:
    """Run all services until a signal of `stop_signals`, and return the exit code.

    everybody  let everybody in without an access key, from other machines too
    Raises BadInput where the port is in use or a service cannot start, SettingsError where others could reach the
    gateway and there are no keys.
    """
    _refuse_without_keys(host, port, data, everybody)
    stop = threading.Event()
    exit_on_signals()  # while the services start: then there is nothing to wait for
    with run_stack(host, port, data, everybody=everybody) as stack:
        for name in stop_signals():
            signal.signal(name, lambda *_: stop.set())
        console.print(f"capture page   {stack.url}/")
        console.print(f"viewer         {stack.url}/view/KEY")
        console.print(f"API            {stack.url}/openapi.json")
        console.print(f"data           {data.resolve()}")
        if everybody and host not in LOOPBACK:
            warn("open to the network without access keys: everybody who reaches this port owns all that is in it")
        while not stop.wait(0.5):
            stack.restart_dead()
    return 0


@contextmanager
def run_stack(host: str, port: int, data: Path, *, wait: bool = True, everybody: bool = False) -> Iterator[Stack]:
    """Start both services, yield when they are ready, and stop them on exit. Raises BadInput.

    wait  False: yield at once; the caller waits with `Stack.wait_ready`
    """
    port = port or free_port()
    _check_free(host, port)
    private_folder(data)
    stack = Stack(host, port, data.resolve(), everybody=everybody)
    try:
        stack.start()
        if wait:
            stack.wait_ready()
        yield stack
    finally:
        stack.stop()


class Stack:
    """The child processes, gateway and worker. A dead one is restarted; its jobs are leased again automatically."""

    def __init__(self, host: str, port: int, data: Path, *, everybody: bool = False) -> None:
        reached = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)  # noqa: S104 - every address of this machine
        self.url = f"http://{f'[{reached}]' if ':' in reached else reached}:{port}"
        # Short, as a socket's path must be; mkdtemp makes a folder that no other user may enter.
        self._sockets = Path(tempfile.mkdtemp(prefix="capture2vr-"))
        self._environment = _environment(host, port, data, sockets=self._sockets, everybody=everybody)
        self.store_root = data / "store"
        self._logs = data / "logs"
        self._children: dict[str, subprocess.Popen[bytes]] = {}
        self._restarts = 0

    def start(self) -> None:
        """Start the services that are not running."""
        self._logs.mkdir(parents=True, exist_ok=True)
        for service in ("edge", "gateway"):
            if service not in self._children or self._children[service].poll() is not None:
                with (self._logs / f"{service}.log").open("ab") as log:
                    self._children[service] = start_child(
                        python_command("-m", "capture2vr.cli.service_process", service, str(os.getpid())),
                        environment=self._environment,
                        stdout=log,
                        stderr=log,
                        start_new_session=True,  # Ctrl-C reaches only this process, which stops the children in order
                    )

    def restart_dead(self) -> None:
        """Restart services that have died. Raises BadInput after too many restarts."""
        dead = [name for name, child in self._children.items() if child.poll() is not None]
        if not dead:
            return
        self._restarts += 1
        if self._restarts > _RESTARTS:
            raise BadInput(f"the service {dead[0]} ended too often; see {self._logs / dead[0]}.log")
        warn(f"the service {dead[0]} ended with exit code {self._children[dead[0]].returncode}; restarting it")
        time.sleep(_RESTART_PAUSE_S)
        self.start()

    def wait_ready(self) -> None:
        """Wait until the gateway reports that it, its store and its worker are ready. Raises BadInput."""
        deadline = time.monotonic() + _READY_S
        while time.monotonic() < deadline:
            for name, child in self._children.items():
                if child.poll() is not None:
                    raise BadInput(f"the service {name} cannot start: {_last_line(self._logs / f'{name}.log')}")
            try:
                answer = self._ask(exclude="disk")  # on a full disk there is still much to read, and to delete
                if answer.is_success:
                    if not self._ask().is_success:
                        warn("the disk is almost full: nothing is taken until captures or assets are deleted")
                    return
                if '"GATEWAY_STARTING"' in answer.text:  # a migration takes as long as it takes
                    deadline = time.monotonic() + _READY_S
                if '"SCHEMA_NEWER"' in answer.text:
                    raise BadInput(f"the service gateway cannot start: {_last_line(self._logs / 'gateway.log')}")
            except httpx.TransportError:
                pass
            time.sleep(0.1)
        raise BadInput(f"the services were not ready within {_READY_S:.0f} s; see {self._logs}")

    def _ask(self, **query: str) -> httpx.Response:
        return httpx.get(f"{self.url}/readyz", params=query, timeout=2.0, trust_env=False)

    def stop(self) -> None:
        """Stop the gateway, then the worker, so that no new job reaches a worker that is shutting down."""
        for name in ("gateway", "edge"):
            child = self._children.get(name)
            if child is None or child.poll() is not None:
                continue
            child.terminate()
            try:
                child.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()
        shutil.rmtree(self._sockets, ignore_errors=True)


def free_port() -> int:
    """Return a TCP port that is free at this moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def is_free(host: str, port: int) -> bool:
    """Return whether the port is free."""
    try:
        _check_free(host, port)
    except BadInput:
        return False
    return True


def _check_free(host: str, port: int) -> None:
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise BadInput(
                f"cannot listen on {host}:{port}: {error.strerror}; choose another port with --port"
            ) from error


def _refuse_without_keys(host: str, port: int, data: Path, everybody: bool) -> None:
    """Refuse what the gateway would refuse, before anything is started."""
    if host in LOOPBACK or everybody or os.environ.get("GATEWAY_OPEN"):
        return
    from capture2vr.gateway.server import refuse_without_keys
    from capture2vr.gateway.settings import GatewaySettings

    environment = _environment(host, port, data.resolve(), sockets=data)
    os.environ["GATEWAY_DATA_DIR"] = environment["GATEWAY_DATA_DIR"]
    settings = GatewaySettings(host=host)
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    refuse_without_keys(settings)


def _environment(host: str, port: int, data: Path, *, sockets: Path, everybody: bool = False) -> Mapping[str, str]:
    """Return the services' environment: our defaults, then the operator's settings, then addresses that must agree."""
    worker = f"unix:{sockets / 'edge.sock'}"  # on a port, every user of this machine could run jobs
    defaults = {
        "STORAGE_KIND": "local",
        "STORAGE_ROOT": str(data / "store"),
        "EDGE_SCRATCH": str(data / "scratch"),
        "EDGE_DRAIN_S": str(_DRAIN_S),
        "EDGE_DEVICE": "auto",
        "GATEWAY_DATA_DIR": str(data / "gateway"),
    }
    fixed = {
        "EDGE_HOST": worker,
        "GATEWAY_HOST": host,
        "GATEWAY_PORT": str(port),
        "GATEWAY_WORKERS": worker,
        "PYTHONUNBUFFERED": "1",
        **({"GATEWAY_OPEN": "true"} if everybody else {}),
    }
    return {**defaults, **os.environ, **fixed}


def _last_line(log: Path) -> str:
    """Return what a service has said last: the message alone of a line in JSON."""
    lines = log.read_text(errors="replace").strip().splitlines()
    last = lines[-1] if lines else "its log is empty"
    try:
        return str(json.loads(last)["message"]).removeprefix("cannot start: ")
    except (ValueError, KeyError, TypeError):  # before the log begins, such as of a wrong setting
        return last
