"""Have work on hostile bytes done in processes of their own, each forked from a server that is warm: fork_server.py."""

from __future__ import annotations

import os
import socket
import subprocess
import threading
import weakref
from collections.abc import Mapping
from dataclasses import dataclass

from capture2vr.process.child_start import python_command, start_child

_PASSED_ON = ("PATH", "HOME", "PYTHONPATH", "LD_LIBRARY_PATH", "LANG", "LC_ALL", "TMPDIR")  # never a secret
# Threads of libraries do not survive a fork; a process for each piece of work is parallel enough.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
_OF_COMPUTING = ("OMP_", "OPENBLAS_", "MKL_", "CUDA_", "NVIDIA_", "PYTORCH_", "TORCH_", "RAY_", "XDG_CACHE_")


@dataclass(frozen=True, slots=True)
class Forked:
    """A process that waits for its order. channel: socket to it; leash: closing this descriptor kills it"""

    channel: socket.socket
    leash: int


class ForkServer:
    """Starts processes that run `work` of a module; starts its server at first use, and again where that was killed."""

    def __init__(self, *program: str, threads: bool = False) -> None:
        """program: arguments of the interpreter, to which the number of the control socket is added

        threads  whether libraries may use several threads, as in this process, and the GPU's and Ray's variables count
        """
        self._program = program
        self._variables = _variables_of_computing() if threads else _ONE_THREAD
        self._server: _RunningServer | None = None
        self._lock = threading.Lock()

    @classmethod
    def of(cls, module: str, *, threads: bool = False) -> ForkServer:
        """Return the server of a module that has `work`."""
        return cls("-m", "capture2vr.process.fork_server", module, threads=threads)

    def start(self) -> None:
        """Start the server now, so that the first piece of work need not wait for it."""
        with self._lock:
            self._alive()

    def close(self) -> None:
        """Terminate the fork server and all processes that it has started."""
        with self._lock:
            if self._server is not None:
                self._server.close()
                self._server = None

    def fork(self) -> Forked:
        """Start a process. Raises OSError."""
        with self._lock:
            try:
                return self._alive().fork()
            except OSError:  # it has been killed just now
                assert self._server is not None
                self._server.close()
                return self._alive().fork()

    def _alive(self) -> _RunningServer:
        if self._server is None or self._server.has_ended:
            if self._server is not None:
                self._server.close()
            self._server = _RunningServer(self._program, self._variables)
        return self._server


def _variables_of_computing() -> dict[str, str]:
    """Return those of this process's variables by which libraries compute: their threads, GPUs and clusters."""
    return {name: value for name, value in os.environ.items() if name.startswith(_OF_COMPUTING)}


class _RunningServer:
    """A running server, with the socket over which it gets descriptors."""

    def __init__(self, program: tuple[str, ...], more: Mapping[str, str]) -> None:
        self._control, theirs = socket.socketpair()
        variables = {name: os.environ[name] for name in _PASSED_ON if name in os.environ}
        with theirs:
            self._process = start_child(
                python_command(*program, str(theirs.fileno())),
                environment={**variables, **more},
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C in a terminal is for the service, which then ends this
            )
        # Also for an owner that is dropped without a shutdown.
        self.close = weakref.finalize(self, _end, self._control, self._process)

    @property
    def has_ended(self) -> bool:
        return not self.close.alive or self._process.poll() is not None

    def fork(self) -> Forked:
        ours, theirs = socket.socketpair()
        watched, leash = os.pipe()
        with theirs:
            try:
                socket.send_fds(self._control, [b"+"], [theirs.fileno(), watched])
            except OSError:
                ours.close()
                os.close(leash)
                raise
            finally:
                os.close(watched)
        return Forked(ours, leash)


def _end(control: socket.socket, process: subprocess.Popen[bytes]) -> None:
    control.close()
    process.wait()
