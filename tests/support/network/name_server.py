"""A name server (DNS over UDP) with the addresses that a test wants, as Docker's has those of a service's replicas."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

_ADDRESS, _INTERNET = 1, 1  # record type A, class IN
_HEAD_BYTES = 12


class NameServer:
    """Answers every question with `addresses`, IPv4, good for a second."""

    def __init__(self, addresses: Sequence[str]) -> None:
        self.addresses = list(addresses)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.port = int(self.socket.getsockname()[1])

    def serve(self) -> None:
        """Answer until the socket is shut down, which an empty packet announces."""
        while True:
            query, caller = self.socket.recvfrom(512)
            if not query:
                return
            self.socket.sendto(self._answer(query), caller)

    def _answer(self, query: bytes) -> bytes:
        question = query[_HEAD_BYTES : query.index(b"\0", _HEAD_BYTES) + 5]
        # 0x8180: an answer without errors, by a server that asks others; 0xC00C: the name that the question has.
        head = query[:2] + struct.pack("!HHHHH", 0x8180, 1, len(self.addresses), 0, 0)
        rows = (
            struct.pack("!HHHIH", 0xC00C, _ADDRESS, _INTERNET, 1, 4) + socket.inet_aton(address)
            for address in self.addresses
        )
        return head + question + b"".join(rows)


@contextmanager
def name_server(*addresses: str) -> Iterator[NameServer]:
    """A name server on a free port of loopback; it stops on leaving."""
    server = NameServer(addresses)
    thread = threading.Thread(target=server.serve)
    thread.start()
    try:
        yield server
    finally:
        server.socket.sendto(b"", server.socket.getsockname())
        thread.join()
        server.socket.close()
