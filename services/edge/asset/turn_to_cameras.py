"""Turn the pieces of a surface so that their fronts are what cameras saw.

The volume that a piece encloses tells its outside only where it is nearly closed: a corner of floor and wall bulges
away from every photo, and by its volume was shown from behind.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capture2vr.edge.closing.oriented_points import seen_sides
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.topology import pieces_of, some_of_each, turned
from capture2vr.edge.render.posed_picture import PosedPicture


def turn_to_cameras(mesh: Mesh, pictures: Sequence[PosedPicture]) -> Mesh:
    """Turn over each piece of a mesh whose back most of the pictures' depth lies on; all in one frame.

    A piece that no picture has depth of, and one whose two sides were seen alike, stays as it is.
    """
    if not pictures:
        return mesh
    piece = pieces_of(mesh.faces)
    asked = some_of_each(piece)
    corners = mesh.faces[asked]
    normals = face_normals(mesh.vertices, corners)
    doubled = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(doubled, 1e-300)[:, None]
    sides = seen_sides(mesh.vertices[corners].mean(axis=1), normals, pictures)
    towards = np.zeros(len(piece))
    towards[asked] = doubled * sides
    return turned(mesh, piece, towards)
