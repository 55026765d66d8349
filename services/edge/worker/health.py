"""`python -m capture2vr.edge.worker.health`: a container's health check; exit 0 when the worker on EDGE_PORT serves."""

from __future__ import annotations

import sys

import grpc
from grpc_health.v1 import health_pb2, health_pb2_grpc

from capture2vr.edge.worker.settings import EdgeSettings, server_security
from capture2vr.process.grpc_security import NO_SECURITY, ClientCredentials, ServerSecurity, certificate_host

_TIMEOUT_S = 2.0  # less than the timeout of the container's health check


def is_serving(address: str, security: ServerSecurity = NO_SECURITY) -> bool:
    """Whether the worker at this address answers SERVING. Needs no token; `security` has the worker's certificate."""
    # The worker's own certificate is used as the trusted root, under a host name that it is for: no CA is needed.
    name = [("grpc.ssl_target_name_override", certificate_host(security.cert))] if security.cert else []
    with ClientCredentials(security.cert).channel(address, name) as channel:
        try:
            stub = health_pb2_grpc.HealthStub(channel)
            answer = stub.Check(health_pb2.HealthCheckRequest(), timeout=_TIMEOUT_S)
        except grpc.RpcError:
            return False
    return bool(answer.status == health_pb2.HealthCheckResponse.SERVING)


if __name__ == "__main__":
    _settings = EdgeSettings()
    sys.exit(0 if is_serving(f"127.0.0.1:{_settings.port}", server_security(_settings)) else 1)
