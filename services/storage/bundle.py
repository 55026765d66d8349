"""`Bundle`: the files and the manifest of one asset version, before they are written to a store."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from capture2vr.sentences.sentence import say

Json = Any
"""Any value that `json` can write. The pipeline decides what a manifest contains."""

State = Literal["preview", "refined"]

CONTENT_TYPES = {
    ".glb": "model/gltf-binary",
    ".json": "application/json",
    ".ktx2": "image/ktx2",
    ".laz": "application/octet-stream",
    ".ply": "application/octet-stream",
    ".spz": "application/octet-stream",
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".stl": "model/stl",
    ".usdz": "model/vnd.usdz+zip",
    ".webp": "image/webp",
    ".zip": "application/zip",
}

_HASH = re.compile(r"\.([0-9a-f]{64})(\.[^./]*)?$")
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, slots=True)
class Bundle:
    """The result of a reconstruction.

    files     contents by plain file name: "lod0.glb", "lod1.glb", "preview.png", "mesh.ply"; `FilesOnDisk` for many
    manifest  JSON with everything about the asset except where its files are stored
    private   files for whoever reconstructs, which are never published: they show the capture's own photos
    last      whether the job publishes nothing after it; a job may publish two previews, the second with textures
    """

    state: State
    files: Mapping[str, bytes]
    manifest: Mapping[str, Json]
    private: Mapping[str, bytes] = field(default_factory=dict)
    last: bool = False


class FilesOnDisk(Mapping[str, bytes]):
    """Contents of a bundle that is too large for memory: some are in memory, the others are read when asked for."""

    def __init__(self, files: Mapping[str, bytes], paths: Mapping[str, Path]) -> None:
        self._files, self._paths = files, paths

    @property
    def paths(self) -> Mapping[str, Path]:
        """The files that are on disk, by name."""
        return self._paths

    def __getitem__(self, file: str) -> bytes:
        return self._paths[file].read_bytes() if file in self._paths else self._files[file]

    def __iter__(self) -> Iterator[str]:
        yield from self._files
        yield from (file for file in self._paths if file not in self._files)

    def __len__(self) -> int:
        return len(self._files.keys() | self._paths.keys())


def publishing(state: State) -> str:
    """Return the message of the stage PUBLISHING."""
    return say("publishing", state=say("word_preview" if state == "preview" else "word_refined"))


def content_name(file: str, sha256: str) -> str:
    """Add the content's hash to a file name: `lod0.glb` → `lod0.<sha256>.glb`. Such a name always means these bytes.

    A name that has the hash already stays: a tileset's files name each other by it.
    """
    if hash_in_name(file) == sha256:
        return file
    path = PurePosixPath(file)
    return f"{path.stem}.{sha256}{path.suffix}"


def hash_in_name(name: str) -> str | None:
    """Return the sha256 in an object's name that `content_name` has made; None for another name."""
    found = _HASH.search(name)
    return found[1] if found else None


def content_type(file: str) -> str:
    """Return the media type of a file by its extension."""
    return CONTENT_TYPES.get(PurePosixPath(file).suffix.lower(), "application/octet-stream")


def sha256_hex(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def sha256_of(path: Path) -> str:
    """Return the sha256 of a file as `sha256_hex` writes it. Raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def is_sha256(text: str) -> bool:
    """Whether a text is a SHA-256 as `sha256_hex` writes it: 64 lower-case hexadecimal digits."""
    return _SHA256.fullmatch(text) is not None
