"""Send an order to a process of fork_server.py, and collect its messages, without blocking the event loop."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Mapping
from typing import Any

from capture2vr.process.fork_client import Forked
from capture2vr.sentences.documents import with_sentences


async def talk(forked: Forked, order: Mapping[str, Any]) -> dict[str, Any]:
    """Send the order and return all that the process says, by name, the last of each.

    When cancelled, ends the process and waits for that.
    """
    reader, writer = await asyncio.open_unix_connection(sock=forked.channel)
    writer.write(json.dumps(order).encode() + b"\n")
    answer = asyncio.ensure_future(reader.read())
    try:
        lines = (await asyncio.shield(answer)).splitlines()
        return dict(with_sentences({name: value for line in lines for name, value in json.loads(line).items()}))
    except ConnectionError:
        return {}
    finally:
        os.close(forked.leash)
        await asyncio.gather(answer, return_exceptions=True)
        writer.close()
