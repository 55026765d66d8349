"""A `Bundle`: the files of one asset in one state, before they have names on a store."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any, Literal

Json = Any
"""What `json` can write; the manifest's shape is the pipeline's business."""

State = Literal["preview", "refined"]

CONTENT_TYPES = {
    ".glb": "model/gltf-binary",
    ".json": "application/json",
    ".ktx2": "image/ktx2",
    ".ply": "application/octet-stream",
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".usdz": "model/vnd.usdz+zip",
    ".webp": "image/webp",
    ".zip": "application/zip",
}


@dataclass(frozen=True, slots=True)
class Bundle:
    """What a reconstruction yields.

    files     by plain name: "lod0.glb", "lod1.glb", "preview.png", "mesh.ply"
    manifest  everything there is to know about the asset except where its files are, as JSON
    """

    state: State
    files: Mapping[str, bytes]
    manifest: Mapping[str, Json]


def content_name(file: str, sha256: str) -> str:
    """`lod0.glb` → `lod0.<sha256>.glb`: a name that never means other bytes."""
    path = PurePosixPath(file)
    return f"{path.stem}.{sha256}{path.suffix}"


def content_type(file: str) -> str:
    """The media type of a file by its ending."""
    return CONTENT_TYPES.get(PurePosixPath(file).suffix.lower(), "application/octet-stream")


def sha256_hex(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
