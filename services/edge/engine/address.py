"""The engine that the setting EDGE_ENGINE names: `local`, or `ray://host:port`."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from threading import Lock

from capture2vr.edge.engine.local_engine import LocalEngine
from capture2vr.edge.engine.nouns import Engine, Needs, OpenEngine
from capture2vr.edge.errors import EdgeError

LOCAL = "local"
ADDRESS = re.compile(r"ray://(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9]([A-Za-z0-9._-]*[A-Za-z0-9])?):\d{1,5}", re.ASCII)


def check_engine(value: str) -> str:
    """Return the setting unchanged. Raises ValueError for one that names no engine."""
    if value != LOCAL and not ADDRESS.fullmatch(value):
        raise ValueError("must be local, or ray://host:port, as in ray://head.example:10001")
    return value


@contextmanager
def open_engine(setting: str, room: Needs) -> Iterator[Engine]:
    """Open the engine that the setting names; at the end what has not ended is cancelled.

    room  of this machine, that local tasks may take together
    Raises EdgeError ENGINE_LOST where the cluster cannot be reached, ENGINE_MISSING where Ray is not installed.
    """
    engine = LocalEngine(room) if setting == LOCAL else _open_ray(setting)
    try:
        yield engine
    finally:
        engine.close()


def _open_ray(address: str) -> Engine:
    # Else Ray's calls would start a cluster of their own on this machine once they have lost the one that they had.
    os.environ["RAY_ENABLE_AUTO_CONNECT"] = "0"
    try:
        from capture2vr.edge.engine.ray_engine import RayEngine  # here, because Ray takes half a second to import
    except ImportError as error:
        raise EdgeError(
            "ENGINE_MISSING", f"EDGE_ENGINE={address} needs Ray ({error})", hints=("pip install 'capture2vr[ray]'",)
        ) from error
    return RayEngine(address)


def engine_for_parts(setting: str, room: Needs) -> OpenEngine | None:
    """Return a function that opens the engine for the parts of a job, side by side; None where there is one core alone.

    room  of this machine, for one job

    The cluster is connected to for the first of several jobs, and let go after the last: Ray's client is one for a
    process.
    """
    if setting != LOCAL:
        return _SharedCluster(setting).use
    return partial(open_engine, LOCAL, room) if room.cpus > 1 else None


class _SharedCluster:
    """A connection that several jobs of a worker share."""

    def __init__(self, address: str) -> None:
        self._address = address
        self._lock = Lock()
        self._users = 0
        self._engine: Engine | None = None

    @contextmanager
    def use(self) -> Iterator[Engine]:
        """Connect to the Ray cluster, or share the connection of another user. Raises EdgeError ENGINE_LOST."""
        with self._lock:
            engine = self._engine = self._engine or _open_ray(self._address)
            self._users += 1
        try:
            yield engine
        finally:
            with self._lock:
                self._users -= 1
                if not self._users:
                    self._engine = None
                    engine.close()
