"""Fork a process for each piece of work on hostile bytes: `python -m capture2vr.process.fork_server MODULE FD`.

Decoders of hostile bytes may crash, hang or eat memory, and run arbitrary code where they have a fault. So each piece
of work has a process of its own, with limits and without its service's settings and secrets. Starting an interpreter
would cost each up to a second; this process has loaded MODULE and all that it needs, and a fork of it is there within
milliseconds. MODULE has `work(order, talk)`, which sets its own limits, and sends and receives any messages.

For each piece of work the service sends two descriptors over the socket FD (fork_client.py). The first is a socket,
over which it sends the order as one line of JSON, and then reads messages, one a line, until the end: those of `work`,
`{"failed": TRACEBACK}` for an exception, and `{"processor_s": SECONDS, "ended": STATUS}`: what the process and all that
it has waited for took. The second is a pipe, the leash: the process is
killed when the service closes it. Whatever a process has started is killed when it has ended.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import selectors
import signal
import socket
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TextIO

from capture2vr.process.parent_death import adopt_orphans, children_of, end_with_parent
from capture2vr.sentences.documents import with_codes, with_sentences


class Talk:
    """The work's end of the socket to the service."""

    def __init__(self, channel: socket.socket, lines: TextIO) -> None:
        self._channel, self._lines = channel, lines

    def send(self, message: dict[str, Any]) -> None:
        """Send a message, with the codes of its sentences. Raises BrokenPipeError where the service is gone."""
        _send(self._channel, message)

    def receive(self) -> dict[str, Any]:
        """Wait for a message of the service. Raises BrokenPipeError where it is gone, or wants no more."""
        line = self._lines.readline()
        if not line:
            raise BrokenPipeError
        message: dict[str, Any] = with_sentences(json.loads(line))
        return message


Work = Callable[[dict[str, Any], Talk], None]


@dataclass(slots=True)
class _Running:
    """Work that runs: its process (None once it has ended), and the descriptors that this server has of it.

    ended  a pipe whose other end only the process has: it closes when that process ends, however it does
    """

    process: int | None
    channel: socket.socket
    leash: int
    ended: int

    def close(self) -> None:
        self.channel.close()
        os.close(self.leash)
        os.close(self.ended)

    def kill(self) -> None:
        if self.process is not None:
            os.kill(self.process, signal.SIGKILL)


class _Server:
    """Starts work, ends what is not wanted any more, and tells how each has ended."""

    def __init__(self, control: socket.socket, work: Work) -> None:
        self._control = control
        self._work = work
        self._running: list[_Running] = []
        self._selector = selectors.DefaultSelector()
        self._selector.register(control, selectors.EVENT_READ)

    def run(self) -> None:
        """Serve until the service closes the control socket, then kill what runs."""
        while True:
            for key, _ in self._selector.select():
                if key.data is None:
                    if not self._receive():
                        self._end_all()
                        return
                elif key.data.process is None:
                    continue  # its end came in this same round, and its descriptors are closed
                elif key.fd == key.data.leash:
                    key.data.kill()
                    self._selector.unregister(key.fd)
                else:
                    self._report(key.data)

    def _receive(self) -> bool:
        """Start the work whose descriptors arrive; return False when the service has closed the socket."""
        message, descriptors, _, _ = socket.recv_fds(self._control, 1, 2)
        if not message:
            return False
        channel, leash = socket.socket(fileno=descriptors[0]), descriptors[1]
        ended, held = os.pipe()
        server = os.getpid()
        process = os.fork()
        if process == 0:
            end_with_parent(server)  # nobody else would hold the leash
            self._leave(ended, leash)
            _run(channel, self._work)
            os._exit(0)
        os.close(held)
        running = _Running(process, channel, leash, ended)
        self._running.append(running)
        for descriptor in (leash, ended):
            self._selector.register(descriptor, selectors.EVENT_READ, running)
        return True

    def _leave(self, *descriptors: int) -> None:
        """In a fork: close all that belongs to the server and to other work."""
        self._selector.close()
        self._control.close()
        for descriptor in descriptors:
            os.close(descriptor)
        for running in self._running:
            running.close()

    def _report(self, running: _Running) -> None:
        assert running.process is not None
        _, status, used = os.wait4(running.process, 0)
        running.process = None
        self._kill_orphans()
        for descriptor in (running.leash, running.ended):
            with suppress(KeyError):  # the leash has been closed before
                self._selector.unregister(descriptor)
        with suppress(OSError):  # nobody listens any more
            seconds = used.ru_utime + used.ru_stime
            _send(running.channel, {"processor_s": seconds, "ended": os.waitstatus_to_exitcode(status)})
        self._running.remove(running)
        running.close()

    def _end_all(self) -> None:
        """Kill what runs, and what that has started."""
        for running in self._running:
            running.kill()
            if running.process is not None:
                os.waitpid(running.process, 0)
                running.process = None
        self._kill_orphans()

    def _kill_orphans(self) -> None:
        """Kill what a process had started that has ended, and what that had started: they are this server's now."""
        ours = {each.process for each in self._running}
        while orphans := [each for each in children_of(os.getpid()) if each not in ours]:
            for orphan in orphans:
                with suppress(ProcessLookupError):
                    os.kill(orphan, signal.SIGKILL)
                os.waitpid(orphan, 0)


def serve(control: socket.socket, work: Work) -> None:
    """Fork a process for each piece of work that arrives over `control`, until the service closes it."""
    adopt_orphans()
    gc.freeze()  # else the garbage collections of each fork would copy all pages
    _Server(control, work).run()


def _run(channel: socket.socket, work: Work) -> None:
    with channel.makefile("r", encoding="utf-8") as lines:
        order = lines.readline()
        try:
            if order:
                work(json.loads(order), Talk(channel, lines))
        except BrokenPipeError:
            pass  # the service has been killed, or wants no more
        except BaseException:  # noqa: BLE001 - the service logs what it was
            with suppress(OSError):
                _send(channel, {"failed": traceback.format_exc()})


def _send(channel: socket.socket, message: dict[str, Any]) -> None:
    channel.sendall(json.dumps(with_codes(message)).encode() + b"\n")


if __name__ == "__main__":
    serve(socket.socket(fileno=int(sys.argv[2])), importlib.import_module(sys.argv[1]).work)
