"""`python -m capture2vr.edge.worker.health`: a container's health check; exit 0 when the worker on EDGE_PORT serves.

With `--alive`: when it answers at all, be it that it drains. A container is restarted by that check alone.
"""

from __future__ import annotations

import sys

import grpc
from grpc_health.v1 import health_pb2, health_pb2_grpc

from capture2vr.edge.worker.settings import EdgeSettings, server_security
from capture2vr.process.grpc_security import NO_SECURITY, ClientCredentials, ServerSecurity, certificate_host

_TIMEOUT_S = 2.0  # less than the timeout of the container's health check
_ALIVE_TIMEOUT_S = 20.0  # a machine that is slow for a while is no reason to kill what it runs


def is_serving(address: str, security: ServerSecurity = NO_SECURITY) -> bool:
    """Whether the worker at this address answers SERVING. Needs no token; `security` has the worker's certificate."""
    return bool(_ask(address, security, _TIMEOUT_S) == health_pb2.HealthCheckResponse.SERVING)


def is_alive(address: str, security: ServerSecurity = NO_SECURITY, timeout_s: float = _ALIVE_TIMEOUT_S) -> bool:
    """Whether the worker at this address answers, whatever it says."""
    return _ask(address, security, timeout_s) is not None


def _ask(address: str, security: ServerSecurity, timeout_s: float) -> int | None:
    """Return the status that the worker answers; None where it gives no answer in time."""
    # The worker's own certificate is used as the trusted root, under a host name that it is for: no CA is needed.
    name = [("grpc.ssl_target_name_override", certificate_host(security.cert))] if security.cert else []
    with ClientCredentials(security.cert).channel(address, name) as channel:
        try:
            stub = health_pb2_grpc.HealthStub(channel)
            return int(stub.Check(health_pb2.HealthCheckRequest(), timeout=timeout_s).status)
        except grpc.RpcError:
            return None


if __name__ == "__main__":
    _settings = EdgeSettings()
    _check = is_alive if sys.argv[1:] == ["--alive"] else is_serving
    sys.exit(0 if _check(f"127.0.0.1:{_settings.port}", server_security(_settings)) else 1)
