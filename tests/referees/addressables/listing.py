"""Runs under the newer Python, beside addressablestools: a catalogue as one JSON text."""

from __future__ import annotations

import json
from typing import Any

import addressablestools


def listed(path: str, data: Any) -> str:
    """What addressablestools finds in the catalogue; `data` is a buffer."""
    content = bytes(data)
    catalogue = addressablestools.parse(content.decode() if path.endswith(".json") else content, backend="python")
    return json.dumps(
        {
            "version": catalogue.version,
            "locator_id": catalogue.locator_id,
            "providers": [_type(each.object_type) for each in catalogue.resource_provider_data],
            "keys": {
                key: [_location(catalogue, each) for each in places]
                for key, places in catalogue.resources.items()
                if isinstance(key, str)
            },
        }
    )


def _location(catalogue: Any, location: Any) -> dict[str, Any]:
    dependencies = location.dependencies or catalogue.resources.get(location.dependency_key, ())
    return {
        "key": location.primary_key,
        "id": location.internal_id,
        "provider": location.provider_id,
        "type": _type(location.type),
        "data": location.data if isinstance(location.data, str) else _options(location.data),
        "dependencies": [each.primary_key for each in dependencies],
    }


def _options(options: Any) -> dict[str, Any]:
    return {"hash": options.hash, "crc": options.crc, "name": options.bundle_name, "size": options.bundle_size}


def _type(serialized: Any) -> list[str]:
    return [serialized.assembly_name or "", serialized.class_name]
