"""`python -m services.edge.health`: exit 0 when the worker of EDGE_PORT is serving; a container's health check."""

from __future__ import annotations

import sys

import grpc
from grpc_health.v1 import health_pb2, health_pb2_grpc

from services.edge.settings import EdgeSettings, open_door
from services.link import OPEN, Caller, Door, name_in

_TIMEOUT_S = 2.0  # less than the container's own


def is_serving(address: str, door: Door = OPEN) -> bool:
    """Whether the worker behind this door answers SERVING at this address; health asks for no token."""
    # Its own certificate vouches for itself, under a name that it is for: nobody has to know who signed it.
    name = [("grpc.ssl_target_name_override", name_in(door.cert))] if door.cert else []
    with Caller(door.cert).channel(address, name) as channel:
        try:
            stub = health_pb2_grpc.HealthStub(channel)
            answer = stub.Check(health_pb2.HealthCheckRequest(), timeout=_TIMEOUT_S)
        except grpc.RpcError:
            return False
    return bool(answer.status == health_pb2.HealthCheckResponse.SERVING)


if __name__ == "__main__":
    _settings = EdgeSettings()
    sys.exit(0 if is_serving(f"127.0.0.1:{_settings.port}", open_door(_settings)) else 1)
