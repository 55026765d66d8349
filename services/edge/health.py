"""`python -m services.edge.health`: exit 0 when the worker of EDGE_PORT is serving; a container's health check."""

from __future__ import annotations

import sys

import grpc
from grpc_health.v1 import health_pb2, health_pb2_grpc

from services.edge.settings import EdgeSettings

_TIMEOUT_S = 2.0  # less than the container's own


def is_serving(address: str) -> bool:
    """Whether a worker answers SERVING at this address."""
    with grpc.insecure_channel(address) as channel:
        try:
            stub = health_pb2_grpc.HealthStub(channel)
            answer = stub.Check(health_pb2.HealthCheckRequest(), timeout=_TIMEOUT_S)
        except grpc.RpcError:
            return False
    return bool(answer.status == health_pb2.HealthCheckResponse.SERVING)


if __name__ == "__main__":
    sys.exit(0 if is_serving(f"127.0.0.1:{EdgeSettings().port}") else 1)
