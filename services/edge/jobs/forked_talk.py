"""Talk with a process of fork_server.py from a thread, and kill it when nobody waits any more."""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

from capture2vr.edge.arrays import Tick, no_tick
from capture2vr.process.fork_client import ForkServer
from capture2vr.sentences.documents import with_codes, with_sentences

_POLL_S = 0.1  # between two ticks: the longest time that work goes on that nobody waits for
_MOST_LINE_BYTES = 64 << 20  # of a message: a process that a capture has taken over may send anything


class ForkedTalk:
    """The worker's end of the socket to a process."""

    def __init__(self, channel: socket.socket, leash: int, tick: Tick) -> None:
        self._channel, self._tick = channel, tick
        self._leash: int | None = leash
        self._ticked = 0.0
        self._read = bytearray()
        channel.settimeout(_POLL_S)

    def send(self, message: Mapping[str, Any]) -> None:
        """Send a message. A process that has just ended tells so among its messages."""
        self._channel.settimeout(None)
        with suppress(ConnectionError):
            self._channel.sendall(json.dumps(with_codes(message)).encode() + b"\n")
        self._channel.settimeout(_POLL_S)

    def messages(self) -> Iterator[tuple[str, Any]]:
        """Yield what the process says, by name, until it has ended, the last as "ended": its exit status.

        Raises what `tick` raises.
        """
        while (line := self._line()) is not None:
            yield from with_sentences(json.loads(line)).items()

    def kill(self) -> None:
        """Kill the process."""
        if self._leash is not None:
            os.close(self._leash)
            self._leash = None

    def end(self) -> None:
        """Kill the process, and wait until it has ended: its folder may be removed then."""
        self.kill()
        self._tick = no_tick
        while self._line() is not None:
            pass

    def _line(self) -> bytes | None:
        """The next line; None where the other end has closed."""
        while (end := self._read.find(b"\n")) < 0:
            if (now := time.monotonic()) - self._ticked >= _POLL_S:  # also while a process talks without a pause
                self._ticked = now
                self._tick(0.5)  # how far it is nobody knows
            if len(self._read) > _MOST_LINE_BYTES:
                self.kill()
                self._read.clear()
            try:
                block = self._channel.recv(1 << 16)
            except TimeoutError:
                continue
            except ConnectionError:  # killed before it had read its order
                return None
            if not block:
                return None
            self._read += block
        line = bytes(self._read[:end])
        del self._read[: end + 1]
        return line


@contextmanager
def talking(server: ForkServer, order: Mapping[str, Any], tick: Tick) -> Iterator[ForkedTalk]:
    """Start a process with an order for the block, at whose end it is killed, and has ended.

    `tick` is called often; what it raises ends the block.
    """
    forked = server.fork()
    with forked.channel as channel:
        talk = ForkedTalk(channel, forked.leash, tick)
        try:
            talk.send(order)
            yield talk
        finally:
            talk.end()
