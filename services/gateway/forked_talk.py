"""Send an order to a process of fork_server.py, and collect its messages, without blocking the event loop."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Callable, Mapping
from typing import Any

from capture2vr.process.fork_client import Forked
from capture2vr.sentences.documents import with_sentences


def no_spend(seconds: float) -> None:
    """Count no processor seconds."""


async def talk(forked: Forked, order: Mapping[str, Any], spend: Callable[[float], None] = no_spend) -> dict[str, Any]:
    """Send the order and return all that the process says, by name, the last of each.

    When cancelled, ends the process and waits for that. `spend` is told the processor seconds that it took, then too.
    """
    reader, writer = await asyncio.open_unix_connection(sock=forked.channel)
    writer.write(json.dumps(order).encode() + b"\n")
    answer = asyncio.ensure_future(_messages(reader))
    try:
        return dict(with_sentences(await asyncio.shield(answer)))
    finally:
        os.close(forked.leash)
        said = await answer
        spend(said.get("processor_s", 0.0))
        writer.close()


async def _messages(reader: asyncio.StreamReader) -> dict[str, Any]:
    """Read messages until the process has ended; none where it was killed before it had read its order."""
    try:
        lines = (await reader.read()).splitlines()
    except ConnectionError:
        return {}
    return {name: value for line in lines for name, value in json.loads(line).items()}
