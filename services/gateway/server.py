"""The gateway's HTTP server (uvicorn): settings are checked and the port is opened before anything is served."""

from __future__ import annotations

import json
import logging
import signal
import socket
import sys
import time
from functools import partial
from typing import Any

import uvicorn
from fastapi import FastAPI
from sqlalchemy.exc import SQLAlchemyError

from capture2vr.gateway.access.store import AccessStore
from capture2vr.gateway.app import create_app
from capture2vr.gateway.connections import ConnectionLimits, LimitedProtocol
from capture2vr.gateway.database.database import open_engine
from capture2vr.gateway.database.disk_reserve import DiskReserve
from capture2vr.gateway.database.instance_lock import FolderInUse
from capture2vr.gateway.database_faults import Fault, fault_of
from capture2vr.gateway.gateway import gateway_in
from capture2vr.gateway.running import lock_folder
from capture2vr.gateway.settings import GatewaySettings
from capture2vr.gateway.starting import StartingApp, answered_meanwhile, wait_for_schema
from capture2vr.process.logs import configure
from capture2vr.process.strict_settings import SettingsError
from capture2vr.process.traces import start_tracing
from capture2vr.storage.catalogue.signing import NO_KEYS, Keys
from capture2vr.storage.store import Store

_GRACE_S = 5  # for answers in progress when the gateway stops
# For which a busy thread keeps Python's lock while others wait. By default 5 ms, which beside a busy event loop each of
# a dozen statements of the jobs' thread waits for: then a claim took 114 ms, and with this 16.
_SWITCH_S = 0.0005

_log = logging.getLogger(__name__)


def serve(settings: GatewaySettings, store: Store, keys: Keys = NO_KEYS) -> int:
    """Serve until SIGTERM or SIGINT, and return the exit status: 0, or 1 when the gateway could not start."""
    configure(settings.log_level)
    sys.setswitchinterval(_SWITCH_S)
    try:
        start_tracing("capture2vr-gateway")
        app = create_app(settings, store, keys)
        listening = _listen_when_ready(settings)
    # ImportError: the database's driver is not installed
    except (FolderInUse, OSError, SQLAlchemyError, ImportError, SettingsError) as error:
        _log.error("cannot start: %s", _why(error, settings))
        return 1
    with listening:
        _announce(settings, listening.getsockname()[1])
        if not keys.verification_keys:
            _log.warning("signatures of collections are not checked: set STORAGE_SIGNING_KEY or STORAGE_TRUSTED_KEYS")
        return _run(uvicorn.Server(server_config(app, settings)), listening)


def _why(error: Exception, settings: GatewaySettings) -> str:
    """Return why the gateway cannot start."""
    if isinstance(error, SQLAlchemyError) and fault_of(error) is Fault.FULL:
        return f"the disk of {settings.data_dir} is full, so that its database cannot be opened: free some space"
    return str(error)


def _run(server: uvicorn.Server, listening: socket.socket) -> int:
    """Run the server until a signal stops it, and return the exit status."""
    # uvicorn raises the signal that stopped it again at the end; ignored, because a requested stop is no failure.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: None)
    server.run(sockets=[listening])
    return 0 if server.started else 1


def server_config(app: FastAPI, settings: GatewaySettings) -> uvicorn.Config:
    """Return the HTTP server's configuration for an app, with the limits of connections."""
    limits = ConnectionLimits(
        settings.limit_address_connections, lambda code: gateway_in(app).metrics.observe_refused_connection(code)
    )
    return _config(app, limits)


def _config(app: FastAPI | StartingApp, limits: ConnectionLimits, **more: Any) -> uvicorn.Config:
    protocol: Any = partial(LimitedProtocol, limits)
    return uvicorn.Config(
        app,
        http=protocol,
        ws="none",
        log_config=None,
        access_log=False,
        timeout_graceful_shutdown=_GRACE_S,
        server_header=False,
        **more,
    )


def refuse_without_keys(settings: GatewaySettings) -> None:
    """Raises SettingsError for a gateway that others could reach and nobody has to show a key to, unless that was told.

    Opens the database, brings its schema up to date, and stores the operator's key of the settings.
    """
    DiskReserve(settings.data_dir).give_up_if_full()
    engine = open_engine(settings.database)
    try:
        if secret := settings.operator_key.get_secret_value():
            try:
                stored = AccessStore(engine).ensure_key(secret, "GATEWAY_OPERATOR_KEY")
            except ValueError as error:
                raise SettingsError(f"GATEWAY_OPERATOR_KEY: {error}") from None
            if why := stored.refusal(time.time()):
                _log.warning("GATEWAY_OPERATOR_KEY: %s is %s, and stays so; name another one", stored.id, why)
        if settings.is_public and not settings.open and not AccessStore(engine).has_keys():
            raise SettingsError(
                f"other machines can reach {settings.reached_host}, and there are no access keys: create one with "
                "`capture2vr keys create`, or let everybody in with --open (GATEWAY_OPEN=true)"
            )
    finally:
        engine.dispose()


def _listen_when_ready(settings: GatewaySettings) -> socket.socket:
    """Open the listening socket, and return it once the database is ready and it is known who would be let in.

    Raises FolderInUse, SettingsError, OSError, SQLAlchemyError.
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))  # as a container's first process it would be ignored
    starting = StartingApp()
    with lock_folder(settings):  # another gateway is told of before its port is
        listening = _listen(settings)
    try:
        limits = ConnectionLimits(settings.limit_address_connections, lambda _: None)
        with answered_meanwhile(uvicorn.Server(_config(starting, limits, lifespan="off")), partial(_serve, listening)):
            wait_for_schema(partial(_check, settings), starting)
    except BaseException:
        listening.close()
        raise
    return listening


def _check(settings: GatewaySettings) -> None:
    with lock_folder(settings):
        refuse_without_keys(settings)


def _serve(listening: socket.socket, server: uvicorn.Server) -> None:
    """Serve on a socket of its own for the same port, as the server closes it."""
    with listening.dup() as own:
        server.run(sockets=[own])


def _listen(settings: GatewaySettings) -> socket.socket:
    """Open the listening socket. Raises OSError."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listening = socket.create_server((settings.host, settings.port), family=family)
    # asyncio sets this only for sockets that it opens itself. Without it, an answer of two TCP segments (head and body)
    # waits 40 ms for the client's delayed acknowledgement.
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listening


def _announce(settings: GatewaySettings, port: int) -> None:
    _log.info("settings: %s", json.dumps(settings.describe()))
    _log.info("listening on http://%s:%d", settings.host, port)
    if settings.open and settings.is_public:
        _log.warning("GATEWAY_OPEN: everybody who reaches this port owns all that is in it; no keys are asked for")
    elif not settings.is_public:
        _log.info("until the first access key is created, everybody on this machine is let in")
