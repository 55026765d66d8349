"""`capture2vr edge` and `capture2vr gateway`: one service, configured by the environment."""

from __future__ import annotations

from services.cli.errors import BadInput
from services.logs import configure
from services.storage.settings import StorageSettings, open_keys, open_publish, open_store

_VARIABLES = {"PRESET_INVALID": "EDGE_PRESETS", "KTX2_UNAVAILABLE": "EDGE_KTX2"}  # at fault, by an error's code


def serve_edge() -> int:
    """Serve a worker until SIGTERM has drained it; the exit code."""
    from services.edge.central import Central
    from services.edge.errors import EdgeError
    from services.edge.field.device import find_device
    from services.edge.memory import Memory, machine_bytes
    from services.edge.mesh.ktx2 import Ktx2Encoder
    from services.edge.server import serve
    from services.edge.settings import EdgeSettings, open_door, open_way_to_central
    from services.edge.stock import known_presets
    from services.edge.work import RealWork

    try:
        settings, storage = EdgeSettings(), StorageSettings()
        store, publish = open_store(storage), open_publish(storage)
        open_door(settings)  # before anything is loaded that takes time
        way = open_way_to_central(settings)
        device = find_device(settings.device)
        presets = known_presets(settings.presets)
        ktx2 = Ktx2Encoder.at(settings.ktx2) if settings.ktx2 else None
    except ValueError as error:
        raise BadInput(str(error)) from error
    except EdgeError as error:
        raise BadInput(f"{_VARIABLES.get(error.code, 'EDGE_DEVICE')}: {error.message}") from error
    configure(settings.log_level)
    memory = Memory(settings.memory or device.memory_bytes or machine_bytes())
    central = Central(settings.central, caller=way) if settings.central else None
    return serve(settings, RealWork(store, presets, device, memory, central, publish, storage.collection, ktx2))


def serve_gateway() -> int:
    """Serve a gateway until SIGTERM; the exit code."""
    from services.gateway.app import serve
    from services.gateway.settings import GatewaySettings

    try:
        settings, storage = GatewaySettings(), StorageSettings()
        store, keys = open_store(storage), open_keys(storage)
    except ValueError as error:
        raise BadInput(str(error)) from error
    return serve(settings, store, keys)
