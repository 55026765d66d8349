"""Receivers of webhooks: an HTTP server on this machine that keeps what it gets, and answers as it was told."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any


@dataclass
class Receiver:
    """got: headers and body of every request; answers: status of each request, the last for all further ones"""

    url: str = ""
    got: list[tuple[dict[str, str], str]] = field(default_factory=list)
    answers: list[int] = field(default_factory=lambda: [204])
    headers: str = ""
    delay_s: float = 0.0
    endless: bool = False

    @property
    def documents(self) -> list[dict[str, Any]]:
        """The bodies as JSON."""
        return [json.loads(body) for _, body in self.got]

    @property
    def ids(self) -> list[str]:
        """The messages' ids."""
        return [headers["webhook-id"] for headers, _ in self.got]

    async def wait(self, count: int, within_s: float = 60.0) -> None:
        """Wait until so many requests have come."""
        async with asyncio.timeout(within_s):
            while len(self.got) < count:
                await asyncio.sleep(0.02)


@asynccontextmanager
async def receiver() -> AsyncIterator[Receiver]:
    """A listening receiver."""
    made = Receiver()

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            head = (await reader.readuntil(b"\r\n\r\n")).decode()
            lines = head.split("\r\n")[1:]
            headers = {name.lower(): value for name, _, value in (line.partition(": ") for line in lines if line)}
            body = (await reader.readexactly(int(headers.get("content-length", "0")))).decode()
            status = made.answers[min(len(made.got), len(made.answers) - 1)]
            made.got.append((headers, body))
            await asyncio.sleep(made.delay_s)
            writer.write(f"HTTP/1.1 {status} Answer\r\n{made.headers}".encode())
            if made.endless:
                writer.write(b"Content-Length: 1000000000\r\n\r\n")
                while True:
                    writer.write(b"x" * 65_536)
                    await writer.drain()
            writer.write(b"Content-Length: 5\r\nConnection: close\r\n\r\nhello")
            await writer.drain()
        except (ConnectionError, asyncio.IncompleteReadError):
            return
        finally:
            writer.close()

    server = await asyncio.start_server(handle, "127.0.0.1", 0)
    made.url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}/hook"
    try:
        yield made
    finally:
        server.close()
