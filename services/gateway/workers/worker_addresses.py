"""Addresses of the workers that GATEWAY_WORKERS names.

`host:port` is one worker. `dns:///host:port` stands for every address that the name resolves to, as the DNS of compose
and a headless service of Kubernetes answer: it is looked up again every two seconds, so workers come and go without a
restart.
An address that a name resolves to is written `host/10.0.0.3:50051`, because a certificate is for the name.
"""

from __future__ import annotations

import asyncio
import logging
import math
import re
import socket
import time
from collections.abc import Sequence

_EVERY_S = 2.0  # between two lookups of a name: a worker that came or went is seen within 5 s
_WAIT_S = 1.0  # a slower lookup goes on, and the addresses of the last one are used meanwhile
_DNS = "dns:///"
_NAME = re.compile(r"(?P<host>[^/:\[\]]{1,200}):(?P<port>[0-9]{1,5})")  # 255 characters of an address are stored

_log = logging.getLogger(__name__)


def check_worker_address(address: str) -> str:
    """Return an address of GATEWAY_WORKERS. Raises ValueError for a `dns:///` one without a name and a port."""
    if address.startswith(_DNS) and not _NAME.fullmatch(address.removeprefix(_DNS)):
        raise ValueError(f"{address} names no workers: write {_DNS}HOST:PORT, such as {_DNS}edge:50051")
    return address


def target_and_name(address: str) -> tuple[str, str]:
    """Split `edge/10.0.0.3:50051` into where to connect and the name of the certificate, "" where that is the same."""
    name, slash, target = address.partition("/")
    return (target, name) if slash and ":" not in name else (address, "")


class WorkerAddresses:
    """The addresses of all workers, as far as they are known; `refresh` looks the names up again."""

    def __init__(self, named: Sequence[str]) -> None:
        """named: of GATEWAY_WORKERS, checked by `check_worker_address`"""
        self._named = tuple(named)
        self._found: dict[str, tuple[str, ...]] = {each: () for each in named if each.startswith(_DNS)}
        self._faults: dict[str, str] = {}
        self._lookup: asyncio.Task[None] | None = None
        self._began = -math.inf  # of the last lookup, monotonic seconds

    @property
    def current(self) -> tuple[str, ...]:
        """Return the resolved addresses of all workers, in the settings' order, without duplicates."""
        found: dict[str, str] = {}
        for named in self._named:
            for address in self._found.get(named, (named,)):
                found.setdefault(target_and_name(address)[0], address)
        return tuple(found.values())

    @property
    def unresolved(self) -> tuple[str, ...]:
        """Names that no address was found for at the last lookup."""
        return tuple(self._faults)

    async def refresh(self) -> None:
        """Look all names up, where the last lookup was long enough ago; wait for its end, but not for long."""
        if not self._found:
            return
        now = time.monotonic()
        if now - self._began >= _EVERY_S and (self._lookup is None or self._lookup.done()):
            self._began = now
            self._lookup = asyncio.create_task(self._look_up_all())
        assert self._lookup is not None
        await asyncio.wait([self._lookup], timeout=_WAIT_S)

    async def close(self) -> None:
        """End a lookup that is going on."""
        if self._lookup is not None:
            self._lookup.cancel()
            await asyncio.wait([self._lookup])

    async def _look_up_all(self) -> None:
        await asyncio.gather(*map(self._look_up, self._found))

    async def _look_up(self, named: str) -> None:
        """Find the addresses of a name. Where it has none now, the last ones stay: their workers answer, or do not."""
        host, _, port = named.removeprefix(_DNS).rpartition(":")
        try:
            answers = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
        except (OSError, UnicodeError) as error:
            if self._faults.get(named) != str(error):
                _log.warning("GATEWAY_WORKERS: %s resolves to no address: %s", named, error)
            self._faults[named] = str(error)
            return
        self._faults.pop(named, None)
        found = tuple(sorted({f"{host}/{_join(*answer[4][:2])}" for answer in answers}))
        if found != self._found[named]:
            _log.info("workers of %s: %s", named, ", ".join(found))
            self._found[named] = found


def _join(host: str | int, port: str | int) -> str:
    """Write an IP address and a port: the address in brackets where it has colons itself."""
    return f"[{host}]:{port}" if ":" in str(host) else f"{host}:{port}"
