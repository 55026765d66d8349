"""Put several meshes into one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capture2vr.edge.mesh.nouns import Mesh


def concatenate(meshes: Sequence[Mesh]) -> Mesh:
    """Put at least one mesh into one, the vertices one behind the other; coloured if all of them are."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)])
    colours = [mesh.rgb for mesh in meshes if mesh.rgb is not None]
    rgb = np.concatenate(colours) if len(colours) == len(meshes) else None
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), faces, rgb)
