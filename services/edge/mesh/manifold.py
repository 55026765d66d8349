"""Make a mesh manifold: cut it at edges of three or more faces, and at vertices where fans of faces touch."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints
from capture2vr.edge.mesh.edges import Edges, edges_of, next_half
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.topology import component_labels

# A vertex that is cut in two leaves two at one place. Each draws back by this share of the way into its own faces, so
# that a program which welds equal positions does not undo the cut.
DRAW_BACK = 0.02


def to_manifold(mesh: Mesh, at: Bools | None = None) -> Mesh:
    """Cut the mesh where more than two faces share an edge, or more than one fan of faces a vertex. No face is lost.

    at (V,) are the vertices where that may be needed, both ends of such edges among them; all by default. Vertices keep
    their numbers, new ones follow them.
    """
    faces = mesh.faces[(mesh.faces != mesh.faces[:, [1, 2, 0]]).all(axis=1)]
    if at is None:
        at = np.ones(len(mesh.vertices), bool)
    near = at[faces].any(axis=1)
    part = _cut(Mesh(mesh.vertices, faces[near], mesh.rgb), at)
    while duplicates := _duplicate_sheets(part):
        part = _split_edges(part, duplicates)
    return Mesh(part.vertices, np.concatenate([faces[~near], part.faces]), part.rgb)


def _cut(mesh: Mesh, at: Bools) -> Mesh:
    """Split these vertices: faces stay joined along edges of two, and in the straightest pairs along edges of more."""
    vertices, faces = mesh.vertices, mesh.faces
    edges = edges_of(faces)
    sheets = [sheet for at_edge in _sheets(vertices, faces, edges) for sheet in at_edge if len(sheet) == 2]
    a, b = np.concatenate([edges.halves(2), *(sheet[None] for sheet in sheets)]).T
    same = faces.ravel()[a] == faces.ravel()[b]
    partner_start, partner_end = np.where(same, b, next_half(b)), np.where(same, next_half(b), b)
    links = np.concatenate([np.stack([a, partner_start], 1), np.stack([next_half(a), partner_end], 1)])
    fan = component_labels(links, faces.size)
    origin = np.empty(int(fan.max(initial=-1)) + 1, np.int64)
    origin[fan] = faces.ravel()
    split = np.flatnonzero(((np.bincount(origin, minlength=len(vertices)) > 1) & at)[origin])
    if len(split) == 0:
        return mesh
    first = np.zeros(len(split), bool)
    first[np.unique(origin[split], return_index=True)[1]] = True
    name = origin.copy()
    name[split[~first]] = len(vertices) + np.arange(np.count_nonzero(~first))
    source = origin[split[~first]]
    placed = np.concatenate([vertices, vertices[source]])
    named = name[fan].reshape(-1, 3)
    _draw_back(placed, named, vertices[faces].mean(axis=1), name[split])
    return Mesh(placed, named, _more_rgb(mesh, source))


def _draw_back(vertices: Floats, faces: Ints, centres: Floats, split: Ints) -> None:
    """Move the split vertices, in place, towards the mean centre of their faces."""
    place = np.full(len(vertices), -1)
    place[split] = np.arange(len(split))
    corner = np.flatnonzero(place[faces.ravel()] >= 0)
    owner = place[faces.ravel()[corner]]
    sums = np.stack([np.bincount(owner, centres[corner // 3, axis], len(split)) for axis in range(3)], axis=1)
    mean = sums / np.bincount(owner, minlength=len(split))[:, None]
    vertices[split] += DRAW_BACK * (mean - vertices[split])


def _sheets(vertices: Floats, faces: Ints, edges: Edges) -> Iterator[list[Ints]]:
    """Yield for each edge of more than two faces its half-edges: the straightest pairs, then those left alone."""
    for start, size in zip(edges.start[edges.size > 2], edges.size[edges.size > 2], strict=True):
        half = edges.order[start : start + size]
        a, b, c = (vertices[faces.ravel()[h]] for h in (half, next_half(half), next_half(next_half(half))))
        along = (b - a) / max(float(np.linalg.norm(b[0] - a[0])), 1e-18)
        side = c - a - np.einsum("hx,hx->h", c - a, along)[:, None] * along
        side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-18)
        cos = side @ side.T + 4 * np.tri(size)
        sheets, alone = [], set(range(size))
        for _ in range(size // 2):
            i, j = np.unravel_index(np.argmin(cos), cos.shape)
            sheets.append(half[[i, j]])
            alone -= {int(i), int(j)}
            cos[[i, j]] = cos[:, [i, j]] = 4
        yield sheets + [half[[i]] for i in alone]


def _duplicate_sheets(mesh: Mesh) -> list[Ints]:
    """Find sheets that share an edge -> the half-edges of all but the first of each edge. No face comes twice."""
    busy, duplicates = set[int](), []
    for sheets in _sheets(mesh.vertices, mesh.faces, edges_of(mesh.faces)):
        for sheet in sheets[1:]:
            touched = set((sheet // 3).tolist())
            if not touched & busy:
                busy |= touched
                duplicates.append(sheet)
    return duplicates


def _split_edges(mesh: Mesh, sheets: list[Ints]) -> Mesh:
    """Split the edge of each sheet: the sheet gets a vertex of its own in the middle."""
    faces, half = mesh.faces, np.concatenate(sheets)
    one = np.array([sheet[0] for sheet in sheets])
    middle = mesh.vertices[faces.ravel()[np.stack([one, next_half(one)])]].mean(axis=0)
    new = np.repeat(len(mesh.vertices) + np.arange(len(sheets)), [len(sheet) for sheet in sheets])
    first, second = faces[half // 3], faces[half // 3]
    rows = np.arange(len(half))
    first[rows, (half % 3 + 1) % 3] = new
    second[rows, half % 3] = new
    kept = np.delete(faces, half // 3, axis=0)
    rgb = _more_rgb(mesh, faces.ravel()[one])
    return Mesh(np.concatenate([mesh.vertices, middle]), np.concatenate([kept, first, second]), rgb)


def _more_rgb(mesh: Mesh, source: Ints) -> Bytes | None:
    """Colours with those of new vertices, each copied from its (K,) source vertex."""
    return None if mesh.rgb is None else np.concatenate([mesh.rgb, mesh.rgb[source]])


def crowded_edges(faces: Ints) -> Ints:
    """Edges (C,2) of three or more faces, ends rising."""
    edges = edges_of(faces)
    return edges.ends[edges.size > 2]


def without_fins(faces: Ints) -> Ints:
    """Drop pairs of faces over the same three vertices that stand out of the surface: folds that were pressed flat.

    Of the edges of three or more faces that a collapse makes, nearly all come from these. A pair that touches no such
    edge is a flat piece of its own, and stays.
    """
    crowded = crowded_edges(faces)
    if len(crowded) == 0:
        return faces
    number = np.array([faces.max() + 1, 1])
    ends = np.sort(faces, axis=1)
    sides = ends[:, [[0, 1], [0, 2], [1, 2]]] @ number
    near = np.flatnonzero(np.isin(sides, crowded @ number).any(axis=1))
    _, which, times = np.unique(ends[near], axis=0, return_inverse=True, return_counts=True)
    kept = np.ones(len(faces), dtype=np.bool_)
    kept[near[times[which] == 2]] = False
    return faces[kept]
