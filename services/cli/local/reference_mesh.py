"""Read a mesh file that a result is compared with."""

from __future__ import annotations

from pathlib import Path
from typing import IO

import numpy as np

from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.errors import BadInput


def read_reference(path: Path) -> Mesh:
    """Read the reference mesh from a file. Raises BadInput."""
    try:
        mesh = _read_mesh_file(path)
    except Exception as error:  # the readers of a dozen formats raise any exception
        raise BadInput(f"{path} cannot be read as a mesh: {error}; name a mesh file with --reference") from error
    if not len(mesh.faces) or not np.isfinite(mesh.vertices).all():
        raise BadInput(
            f"{path} has {len(mesh.faces)} faces, or coordinates that are not finite; name a mesh with --reference"
        )
    return mesh


def _read_mesh_file(path: Path) -> Mesh:
    from capture2vr.edge.capture.files import Folder
    from capture2vr.edge.clouds.obj import read_obj

    if path.suffix.lower() == ".obj":  # trimesh takes relative indices for those of the whole file
        found = read_obj(Folder(path.parent, (path.name,)), path.name)
        return Mesh(found.vertices.xyz, np.zeros((0, 3), np.int64) if found.surface is None else found.surface.faces)
    with path.open("rb") as stream:
        return read_mesh(stream, path.suffix.lstrip(".").lower())


def read_mesh(stream: IO[bytes], kind: str) -> Mesh:
    """Read a mesh of a format that trimesh reads; kind: the file's suffix, without a dot."""
    import trimesh

    loaded = trimesh.load_mesh(stream, file_type=kind, process=False)
    return Mesh(np.asarray(loaded.vertices, np.float64), np.asarray(loaded.faces, np.int64))
