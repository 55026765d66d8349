"""Unwrap a mesh: cut it into flat charts, pack them into a square, and return texture coordinates (UV), by xatlas.

1. drop    slivers without an area, which no chart can hold
2. smooth  a copy, which only decides where to cut: a scan's noise would cut the mesh into thousands of charts
3. divide  into patches of neighbours: the time of xatlas grows with the square of a mesh (50,000 triangles of a scanned
           truck take 78 s whole, 3 s in patches, and get no more charts)
4. unwrap  in a child process, which is killed when it takes too long or the job is cancelled
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

from capture2vr.edge.arrays import Floats, Ints, Tick, no_tick
from capture2vr.edge.child_process import ChildError, run_child
from capture2vr.edge.mesh.edges import border_edges
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.topology import compact
from capture2vr.process.child_start import python_command
from capture2vr.sentences.sentence import say

MOST_FACES = 75_000
"""Most triangles that are unwrapped: 50,000 take seconds; a mesh of many openings cannot be brought down to them."""

_PATCH = 1_000  # faces: 2,000 take a third longer for 3 % fewer charts, 500 give a sixth more charts
_PADDING = 2  # texels between charts: they are still apart in the next mip
_WIDER_FROM = 1024  # texels along a side from which twice the padding costs little: of 512 it would be a third
_ROUNDS = 5  # of smoothing: 450 instead of 3,800 charts of a hemisphere whose noise is a third of its edges
_SHRINK, _GROW = 0.5, -0.53  # Taubin smoothing, 1995: the second step restores the volume that the first takes
_LEAST_AREA = 1e-6  # of the mean face's area: xatlas leaves out smaller faces, and they would show nothing
_LONGEST_SECONDS = 90.0  # 50,000 triangles in 25,000 pieces take 4 s; a machine may be twenty times as busy


class UnwrapError(Exception):
    """A mesh cannot be unwrapped; the message goes into a warning of the report."""


@dataclass(frozen=True, slots=True)
class Unwrapped:
    """A mesh with texture coordinates; vertices on the seams between charts are duplicated.

    mesh    with the rgb of the original vertices
    uv      (V,2) float64 in [0,1], as in glTF: (0,0) is the upper left corner
    charts  number of charts
    """

    mesh: Mesh
    uv: Floats
    charts: int


def unwrap(mesh: Mesh, *, side: int, tick: Tick = no_tick, most_seconds: float = _LONGEST_SECONDS) -> Unwrapped:
    """Unwrap a mesh for a texture of side × side texels, with a few free texels between its charts.

    Any mesh of at most `MOST_FACES` triangles: open, in pieces, of two sheets, non-manifold. Raises UnwrapError where
    it cannot be unwrapped within `most_seconds`. `tick` is called all the while; when it raises, the child process is
    killed at once.
    """
    if len(mesh.faces) > MOST_FACES:
        raise UnwrapError(say("triangles_more_than", count=len(mesh.faces), most=MOST_FACES))
    mesh = _drop_slivers(mesh)
    order, ends = _patches(mesh)
    try:
        found = _run_xatlas(mesh, order, ends, side, tick, most_seconds)
    except OSError as error:  # the disk is full, or no process can be started: the asset then has vertex colours
        raise UnwrapError(say("xatlas_could_not_be_run", why=error.strerror or error)) from None
    faces = np.empty_like(mesh.faces)
    faces[order] = found["faces"]
    # Both axes are divided by the longer side, so that charts are not stretched; at the shorter side a strip is free.
    uv = np.clip(found["texel"].astype(np.float64) / max(float(found["size"].max()), 1.0), 0.0, 1.0)
    return Unwrapped(*_drop_unplaced(mesh, found["was"].astype(np.int64), faces, uv), int(found["charts"]))


def _run_xatlas(
    mesh: Mesh, order: Ints, ends: Ints, side: int, tick: Tick, most_seconds: float
) -> dict[str, NDArray[Any]]:
    """Run the child process; return the arrays of its answer: was, faces in the given order, texel, size, charts."""
    with tempfile.TemporaryDirectory(prefix="unwrap-") as name:
        folder = Path(name)
        np.savez(
            folder / "problem.npz",
            vertices=_smooth(mesh).astype(np.float32),
            faces=mesh.faces.astype(np.uint32),
            order=order,
            ends=ends,
            side=side,
            padding=_PADDING * (2 if side >= _WIDER_FROM else 1),
        )
        _run_program(folder, tick, most_seconds)
        with np.load(folder / "answer.npz") as answer:
            return {name: answer[name] for name in answer.files}


def _drop_slivers(mesh: Mesh) -> Mesh:
    """Drop faces without an area. Raises UnwrapError where none is left, and for vertices that are not finite."""
    if not np.isfinite(mesh.vertices).all():
        raise UnwrapError(say("has_vertices_not_finite"))
    area = np.linalg.norm(face_normals(mesh.vertices, mesh.faces), axis=1)
    mean = float(area.mean()) if len(area) else 0.0
    if not mean > 0:
        raise UnwrapError(say("has_no_triangle_with_area"))
    return compact(mesh, np.flatnonzero(area > _LEAST_AREA * mean))


def _smooth(mesh: Mesh) -> Floats:
    """(V,3) positions after Taubin smoothing, scaled so that a face has an area of about 1; borders stay fixed."""
    faces, count = mesh.faces, len(mesh.vertices)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.concatenate([ends, ends[:, ::-1]])
    near = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count)).tocsr()
    degree = np.maximum(near.sum(axis=1), 1)[:, None]
    free = np.ones((count, 1))
    free[border_edges(faces)] = 0
    scale = 1 / np.sqrt(np.linalg.norm(face_normals(mesh.vertices, faces), axis=1).mean())
    xyz: Floats = (mesh.vertices - mesh.vertices.mean(axis=0)) * scale
    for _ in range(_ROUNDS):
        for step in (_SHRINK, _GROW):
            xyz = xyz + step * free * (near @ xyz / degree - xyz)
    return xyz


def _patches(mesh: Mesh) -> tuple[Ints, Ints]:
    """Divide faces into patches of neighbours: the faces' indices patch by patch, and where each patch ends."""
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    done: list[Ints] = []
    waiting = [np.arange(len(middles))]
    while waiting:
        part = waiting.pop()
        if len(part) <= _PATCH:
            done.append(part)
            continue
        axis = np.ptp(middles[part], axis=0).argmax()
        part = part[np.argsort(middles[part, axis], kind="stable")]
        waiting += [part[: len(part) // 2], part[len(part) // 2 :]]
    return np.concatenate(done), np.cumsum([len(part) for part in done])


def _run_program(folder: Path, tick: Tick, most_seconds: float) -> None:
    """Run unwrap_child.py to its end."""
    program = Path(__file__).with_name("unwrap_child.py")
    try:
        run_child(python_command(program, folder), "xatlas", folder / "log", tick, most_seconds=most_seconds)
    except ChildError as error:
        raise UnwrapError(str(error)) from None


def _drop_unplaced(mesh: Mesh, was: Ints, faces: Ints, uv: Floats) -> tuple[Mesh, Floats]:
    """Drop the faces that have no area in the texture; return the mesh and its UV (V,2).

    was (V,) index in `mesh` of each vertex of `faces`
    """
    a, b, c = (uv[faces[:, corner]] for corner in range(3))
    ab, ac = b - a, c - a
    placed = np.flatnonzero(ab[:, 0] * ac[:, 1] != ab[:, 1] * ac[:, 0])
    if len(placed) == 0:
        raise UnwrapError(say("xatlas_placed_none_triangles"))
    used = np.zeros(len(was), bool)
    used[faces[placed]] = True
    return compact(mesh.with_vertices(was, faces), placed), uv[used]
