"""Have uploads checked in processes of their own, by the server of check_server.py."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import weakref
from dataclasses import asdict
from pathlib import Path
from typing import Any

from anyio import CapacityLimiter

from services.gateway.errors import Problem, storage_full
from services.gateway.uploads.check_and_pack import CheckOrder, PackedFiles, archive_of
from services.gateway.uploads.refusal import SEND_FEWER
from services.gateway.uploads.validate import FileReport

_PROGRAM = ("-m", "services.gateway.uploads.check_server")
_AT_ONCE = 4  # checks, each with up to 768 MB; more would slow each other down on a small machine
_PASSED_ON = ("PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "LANG", "LC_ALL", "TMPDIR")  # variables; never a secret
# Signals by which the kernel ends a check that has used up its processor time, its time on the clock, or all memory.
_USED_UP = (signal.SIGXCPU, signal.SIGALRM, signal.SIGKILL)


class CheckProcesses:
    """Checks uploads, a few at once, each in a process that ends with its check.

    The server is started at first use, and again where it has been killed.
    """

    def __init__(self) -> None:
        self._at_once: CapacityLimiter | None = None
        self._server: _Server | None = None

    def start(self) -> None:
        """Start the server now, so that the first upload need not wait for it."""
        if self._server is None or self._server.has_ended:
            self.close()
            self._server = _Server()

    def close(self) -> None:
        """End the server. Checks that run are ended by their callers."""
        if self._server is not None:
            self._server.close()
            self._server = None

    async def check(self, order: CheckOrder) -> PackedFiles:
        """Check an upload and pack its files. When cancelled, returns once the check's process has ended.

        Raises Problem.
        """
        if self._at_once is None:
            self._at_once = CapacityLimiter(_AT_ONCE)
        async with self._at_once:
            channel, leash = self._begin()
            return _result(order, await _talk(channel, leash, order))

    def _begin(self) -> tuple[socket.socket, int]:
        """Start a check; return its socket and its leash."""
        self.start()
        assert self._server is not None
        try:
            return self._server.fork()
        except OSError:  # it has been killed just now
            self._server.close()
            self._server = _Server()
            return self._server.fork()


class _Server:
    """A running server, with the socket over which it gets the checks' sockets."""

    def __init__(self) -> None:
        self._control, theirs = socket.socketpair()
        command = [sys.executable, *_PROGRAM, str(theirs.fileno())]
        variables = {name: os.environ[name] for name in _PASSED_ON if name in os.environ}
        with theirs:
            self._process = subprocess.Popen(  # noqa: S603 - our own module
                command,
                env=variables,
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C in a terminal is for the gateway, which then ends this
            )
        # Also for an app that is dropped without a shutdown.
        self.close = weakref.finalize(self, _end, self._control, self._process)

    @property
    def has_ended(self) -> bool:
        return self._process.poll() is not None

    def fork(self) -> tuple[socket.socket, int]:
        """Start a process for a check; return the socket to it, and the leash. Raises OSError."""
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
        return ours, leash


def _end(control: socket.socket, process: subprocess.Popen[bytes]) -> None:
    control.close()
    process.wait()


async def _talk(channel: socket.socket, leash: int, order: CheckOrder) -> list[dict[str, Any]]:
    """Send the order and return all that the check says. When cancelled, ends the check and waits for that."""
    reader, writer = await asyncio.open_unix_connection(sock=channel)
    writer.write(json.dumps(asdict(order)).encode() + b"\n")
    answer = asyncio.ensure_future(reader.read())
    try:
        return [json.loads(line) for line in (await asyncio.shield(answer)).splitlines()]
    except ConnectionError:
        return []
    finally:
        os.close(leash)
        await asyncio.wait((answer,))
        writer.close()


def _result(order: CheckOrder, messages: list[dict[str, Any]]) -> PackedFiles:
    """Return what was packed. Raises Problem for what was refused, and for a process that was ended."""
    said = {name: value for message in messages for name, value in message.items()}
    if (refused := said.get("refused")) is not None:
        code, detail, file = refused["code"], refused["detail"], refused["file"]
        raise Problem(refused["status"], code, detail, file=file, hints=tuple(refused["hints"]))
    if "full" in said:
        raise storage_full()
    if (packed := said.get("packed")) is not None and said.get("ended") == 0:
        verdicts = [FileReport(**{**each, "stripped": tuple(each["stripped"])}) for each in packed["verdicts"]]
        return PackedFiles(archive_of(Path(order.folder)), packed["sha256"], verdicts)
    if "failed" in said:
        raise RuntimeError(f"the check of an upload failed: {said['failed']}")
    raise _ended(said)


def _ended(said: dict[str, Any]) -> Problem:
    """Return the problem for a check without a result: it ran out of memory or time, crashed, or was killed."""
    status, file = said.get("ended"), said.get("file", "")
    if status is None:
        return Problem(503, "CHECK_INTERRUPTED", "the check of the upload was interrupted", retryable=True)
    if "costly" in said or -status in _USED_UP:
        what = "memory" if "costly" in said else "time"
        detail = f"checking it takes more {what} than an upload of its size may take"
        return Problem(422, "CAPTURE_TOO_LARGE", detail, file=file, hints=SEND_FEWER)
    name = signal.Signals(-status).name if status < 0 else f"status {status}"
    hints = ("send the file again, or leave it out",)
    return Problem(422, "CAPTURE_UNREADABLE", f"cannot be read: its decoder crashed ({name})", file=file, hints=hints)
