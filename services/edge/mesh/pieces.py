"""List the connected pieces of a mesh, kept and dropped, each with its share of the area and a reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.topology import pieces_of

_COLLAPSED = 1e-15  # of the area of all pieces: less is none
MOST_LISTED = 8
"""Pieces of a list that stand on lines of their own; the smaller ones are added up by their reasons."""


@dataclass(frozen=True, slots=True)
class Piece:
    """One connected piece of a mesh, or several with the same fate.

    share   of the area of all pieces, kept and dropped
    count   pieces that this line stands for
    kept    whether they are in the mesh
    reason  why, as a clause: "the largest", "no photo sees it"
    """

    share: float
    count: int
    kept: bool
    reason: str


@dataclass(frozen=True, slots=True)
class SplitMesh:
    """A mesh with the piece number (F,) of each face, and the area (P,) of each piece."""

    mesh: Mesh
    piece: Ints
    areas: Floats

    @classmethod
    def of(cls, mesh: Mesh) -> SplitMesh:
        """Find the connected pieces of a mesh that has faces."""
        piece = pieces_of(mesh.faces)
        doubled = np.linalg.norm(face_normals(mesh.vertices, mesh.faces), axis=1)
        return cls(mesh, piece, np.asarray(np.bincount(piece, doubled / 2), np.float64))


def list_pieces(areas: Sequence[float], kept: Sequence[bool], reasons: Sequence[str]) -> tuple[Piece, ...]:
    """List pieces with their areas, whether each is kept, and why: the largest first, the many small ones added up."""
    whole = max(float(np.sum(areas)), 1e-300)
    order = np.argsort(-np.asarray(areas, np.float64), kind="stable").tolist()
    lines = [Piece(float(areas[at]) / whole, 1, kept[at], reasons[at]) for at in order[:MOST_LISTED]]
    rest: dict[tuple[bool, str], Piece] = {}
    for at in order[MOST_LISTED:]:
        fate = (kept[at], reasons[at])
        before = rest.get(fate, Piece(0.0, 0, *fate))
        rest[fate] = Piece(before.share + float(areas[at]) / whole, before.count + 1, *fate)
    return (*lines, *sorted(rest.values(), key=lambda line: -line.share))


def without_collapsed(mesh: Mesh) -> Mesh:
    """Return a mesh without its pieces that have no area: tightening draws a tetrahedron that stands off the points
    together to one point."""
    doubled = np.linalg.norm(face_normals(mesh.vertices, mesh.faces), axis=1)
    if doubled.min(initial=np.inf) > _COLLAPSED * doubled.sum():
        return mesh  # as nearly always, in a tenth of the time
    split = SplitMesh.of(mesh)
    kept = split.areas > _COLLAPSED * split.areas.sum()
    return mesh if kept.all() else Mesh(mesh.vertices, mesh.faces[kept[split.piece]])
