"""Fewer triangles, same openings: levels of detail by quadric edge collapse (Garland & Heckbert 1997).

meshoptimizer where it is installed: a 400k-face mesh takes a second to 100k, 25k and 5k faces, and borders may thin out
along themselves. fast-simplification otherwise: it can only leave borders as they are, so a mesh with long ones stays
above a small budget.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from ctypes import c_float, c_size_t, c_uint
from functools import partial
from itertools import pairwise, product
from threading import Lock

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Bools, Ints, Tick, no_tick, part_of
from capture2vr.edge.mesh.edges import border_edges
from capture2vr.edge.mesh.manifold import crowded_edges, to_manifold, without_fins
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.spatial_order import by_place
from capture2vr.edge.mesh.topology import compact, facing_as, orient, reseamed, seam_length
from capture2vr.edge.srgb import to_linear, to_srgb

BUDGETS = (100_000, 25_000, 5_000)  # triangles: what a standalone headset draws near, across a room, and far off
_FEWEST = 100  # faces under which a mesh is not worth a coarser level
# Vertices that may be held so that an edge gets no third face, per face asked for: about a tenth of all that stay. Held
# ones are detail that everything else pays for, so a very rough mesh is cut there instead.
_MOST_HELD = 0.05
# What a step from black to white counts against the longest side: a print keeps its outlines, and the surface of a
# 1.1 m dress moves 0.04 mm more on average at 25k faces, 0.4 mm at 5k.
_COLOUR_WEIGHT = 0.15
# Faces from which a collapse takes most of a second: such a mesh is first brought to half as many and cut where that
# pinches it, so that what is repeated because of pinches is shorter.
_AT_ONCE = 600_000
# Of the faces asked for: a collapse works on neighbours that are wound alike, so along the seams of a one-sided surface
# nothing goes, and all else pays for it. Down to this many with one set of seams, and the rest with another.
_BEFORE = 1.6
_SEAM = 0.02  # edges of seams per face asked for, up to which they cost nothing
_ONE_AT_A_TIME = Lock()  # fast-simplification keeps its mesh in a global between load and result
# A mesh full of handles and openings (a car with its interior) stops at three times a small budget. A level of half
# as much again is no level, so the budget wins and openings may close; not for budgets that could hold no shape at all.
_OVER, _FORCED_FROM = 1.5, 1_000
_FORCED_TRIES = 3  # cutting to a manifold adds some faces, so fewer are asked for each time
_ANY_ERROR = 1e3  # in extents: the face budget decides, not the error

Collapse = Callable[[Mesh, int], Mesh]
"""A mesh and a face budget that it exceeds -> a coarser mesh; colours may guide it, the result needs none."""

Hold = Callable[[Mesh], Bools]
"""Mask (V,) of a mesh's vertices that must stay where they are, as those along a seam to another tile."""


def lods(
    mesh: Mesh, budgets: Sequence[int] = BUDGETS, *, binding: bool = False, tick: Tick = no_tick
) -> tuple[Mesh, ...]:
    """One mesh per budget, finest first, each made from the one before. `tick` is called before every collapse.

    A mesh within the first budget is its own first level; a later level within its budget already is halved instead,
    so that every level is cheaper than the one before unless borders or `_FEWEST` faces forbid it.
    binding: as in `simplify`. Raises ValueError where the budgets do not fall.
    """
    if not budgets or any(coarse >= fine for fine, coarse in pairwise(budgets)):
        raise ValueError(f"budgets must fall from level to level, not {tuple(budgets)}")
    share = 1 / len(budgets)
    if len(mesh.faces) > budgets[0]:
        mesh = by_place(mesh)
    levels = [simplify(mesh, budgets[0], binding=binding, tick=part_of(tick, 0, share))]
    for done, budget in enumerate(budgets[1:], start=1):
        finer = levels[-1]
        half = max(len(finer.faces) // 2, _FEWEST)
        target = budget if budget < len(finer.faces) else half
        inside = part_of(tick, done * share, (done + 1) * share)
        levels.append(simplify(finer, target, binding=binding and target == budget, tick=inside))
    tick(1)
    return tuple(levels)


def simplify(
    mesh: Mesh,
    faces: int,
    *,
    binding: bool = False,
    collapse: Collapse | None = None,
    hold: Hold | None = None,
    tick: Tick = no_tick,
) -> Mesh:
    """Simplify the mesh to at most `faces` faces, or to as few as its borders allow.

    Every border loop survives unless the budget cannot be met with all of them, and no edge gets a third face that had
    none: where nothing else helps, the mesh is cut there. Colours are averaged in linear light over the vertices that a
    kept vertex stands for. `collapse` is the best one installed unless given; `tick` is called before each that it
    makes, how many is not known. binding: openings close as soon as they keep the mesh above the budget, rather than
    above half as much again. hold: vertices that stay, whatever the budget; without meshoptimizer all borders do.
    Raises ValueError for a budget below 1.
    """
    if faces < 1:
        raise ValueError(f"a budget of {faces} faces leaves no mesh")
    if len(mesh.faces) <= faces:
        return mesh
    tick(0)
    coarse = (collapse or _best_collapse(hold, tick))(mesh, faces)
    if hold is None and len(coarse.faces) > (1.0 if binding else _OVER) * faces and faces >= _FORCED_FROM:
        forced = _forced(mesh, faces)
        coarse = forced if len(forced.faces) < len(coarse.faces) else coarse
    return coarse if mesh.rgb is None else _coloured(coarse, mesh)


def _best_collapse(hold: Hold | None, tick: Tick) -> Collapse:
    try:
        import meshoptimizer  # noqa: F401 - asked only whether it is there and loads
    except (ImportError, OSError):
        return by_fast_simplification
    return partial(by_meshoptimizer, hold=hold, tick=tick)


def by_meshoptimizer(mesh: Mesh, faces: int, hold: Hold | None = None, tick: Tick = no_tick) -> Mesh:
    """Simplify by collapses that keep a subset of the vertices; where they pinch it, vertices are locked or cut."""
    if len(mesh.faces) > _AT_ONCE and faces < _AT_ONCE // 2:
        kept = _collapse(mesh, _AT_ONCE // 2, _locked(mesh, hold))
        tick(0)
        mesh = to_manifold(compact(Mesh(mesh.vertices, kept, mesh.rgb)))
        tick(0)
    if seam_length(mesh.faces) <= _SEAM * faces:
        return _held(mesh, faces, hold, tick)
    turned = reseamed(mesh)
    if len(mesh.faces) > _BEFORE * faces:
        kept = _collapse(turned, int(_BEFORE * faces), _locked(mesh, hold))
        tick(0)
        turned = reseamed(to_manifold(compact(Mesh(mesh.vertices, kept, mesh.rgb))))
    return facing_as(orient(_held(turned, faces, hold, tick)), mesh)


def _locked(mesh: Mesh, hold: Hold | None) -> Bools:
    """(V,) True at vertices that a collapse must leave: corners of the border, and those that are to be held."""
    corners = _loop_corners(mesh)
    return corners if hold is None else corners | hold(mesh)


def _held(mesh: Mesh, faces: int, hold: Hold | None, tick: Tick) -> Mesh:
    """Collapse, with the vertices locked around which the surface would be pinched, or cut there if they are many."""
    locked = _locked(mesh, hold)
    allowed = len(crowded_edges(mesh.faces))
    kept = _collapse(mesh, faces, locked)
    while len(crowded := crowded_edges(kept)) > allowed:
        more = locked | _around(mesh.faces, crowded, len(mesh.vertices))
        if more.sum() > _MOST_HELD * faces or (more == locked).all():
            tick(0)
            return _cut(mesh, kept, faces, locked)
        locked = more
        tick(0)
        kept = _collapse(mesh, faces, locked)
    return compact(Mesh(mesh.vertices, kept))


def _cut(mesh: Mesh, kept: Ints, faces: int, locked: Bools) -> Mesh:
    """Cut a collapsed mesh open along edges of three or more faces; if that adds too many faces, collapse further."""
    coarse = to_manifold(compact(Mesh(mesh.vertices, kept)))
    added = len(coarse.faces) - len(kept)
    if len(coarse.faces) <= faces or len(kept) > faces:
        return coarse
    return to_manifold(compact(Mesh(mesh.vertices, _collapse(mesh, max(faces - 2 * added, 1), locked))))


def _collapse(mesh: Mesh, faces: int, locked: Bools) -> Ints:
    """(F,3) faces over the mesh's own vertices, after meshoptimizer's collapses."""
    import meshoptimizer

    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    # Centred and scaled, so that float32 spends its digits on the shape.
    xyz = np.ascontiguousarray((mesh.vertices - low) / max((high - low).max(), 1e-30), dtype=np.float32)
    shade = np.zeros((len(xyz), 3), np.float32) if mesh.rgb is None else (mesh.rgb / 255.0).astype(np.float32)
    out = np.empty(mesh.faces.size, dtype=np.uint32)
    # The alpha declares no C types for this call: plain ints would pass as 32 bits where it reads 64.
    count = meshoptimizer.simplify_with_attributes(
        out,
        mesh.faces.astype(np.uint32).ravel(),
        xyz,
        vertex_attributes=shade,
        attribute_weights=np.full(3, _COLOUR_WEIGHT, dtype=np.float32),
        index_count=c_size_t(mesh.faces.size),
        vertex_count=c_size_t(len(xyz)),
        vertex_positions_stride=c_size_t(xyz.strides[0]),
        vertex_attributes_stride=c_size_t(shade.strides[0]),
        attribute_count=c_size_t(3),
        vertex_lock=locked.astype(np.uint8),
        target_index_count=c_size_t(3 * faces),
        target_error=c_float(_ANY_ERROR),
        options=c_uint(0),
    )
    return without_fins(out[:count].reshape(-1, 3).astype(np.int64))


def _forced(mesh: Mesh, faces: int) -> Mesh:
    """Collapse without regard to openings, then cut to a manifold."""
    asked = faces
    for _ in range(_FORCED_TRIES):
        coarse = to_manifold(by_fast_simplification(mesh, asked, keep_borders=False))
        if len(coarse.faces) <= faces:
            break
        asked = int(0.98 * asked * faces / len(coarse.faces))
    return coarse


def by_fast_simplification(mesh: Mesh, faces: int, *, keep_borders: bool = True) -> Mesh:
    """Simplify by collapses that move vertices; those at borders stay if `keep_borders`."""
    import fast_simplification

    with _ONE_AT_A_TIME:
        vertices, kept = fast_simplification.simplify(
            mesh.vertices, mesh.faces.astype(np.int32), target_count=faces, preserve_border=keep_borders
        )
    return compact(Mesh(np.asarray(vertices, dtype=np.float64), np.asarray(kept, dtype=np.int64)))


def _coloured(coarse: Mesh, fine: Mesh) -> Mesh:
    """Each vertex of `coarse` with the mean light of the vertices of `fine` that are nearest to it."""
    assert fine.rgb is not None
    owner = cKDTree(coarse.vertices).query(fine.vertices, workers=-1)[1]
    light = to_linear(fine.rgb)
    count = np.bincount(owner, minlength=len(coarse.vertices))
    summed = np.stack([np.bincount(owner, light[:, band], len(count)) for band in range(3)], axis=1)
    # Nobody's nearest (a vertex that coincides with another): then it takes what lies nearest to it.
    alone = count == 0
    if alone.any():
        summed[alone] = light[cKDTree(fine.vertices).query(coarse.vertices[alone])[1]]
    return Mesh(coarse.vertices, coarse.faces, to_srgb(summed / np.maximum(count, 1)[:, None]))


def _loop_corners(mesh: Mesh) -> Bools:
    """(V,) True at the extremes of every border loop: locked, they keep a loop from shrinking to nothing."""
    vertices, border = mesh.vertices, border_edges(mesh.faces)
    corners = np.zeros(len(vertices), dtype=np.bool_)
    if len(border) == 0:
        return corners
    used, ends = np.unique(border, return_inverse=True)
    a, b = ends.reshape(-1, 2).T
    graph = coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(len(used), len(used)))
    loop = connected_components(graph, directed=False)[1]
    # The axes and the space diagonals: seven directions, so that even a skew triangle shows all its corners.
    for direction in [*np.eye(3), *(np.array([1.0, y, z]) for y, z in product((-1, 1), repeat=2))]:
        order = np.lexsort((vertices[used] @ direction, loop))
        changes = np.flatnonzero(np.diff(loop[order])) + 1
        corners[used[order[np.concatenate([[0], changes])]]] = True
        corners[used[order[np.concatenate([changes - 1, [len(order) - 1]])]]] = True
    return corners


def _around(faces: Ints, crowded: Ints, count: int) -> Bools:
    """(V,) True at the ends of the crowded edges and at their neighbours in the fine mesh."""
    ends = np.zeros(count, dtype=np.bool_)
    ends[crowded.ravel()] = True
    near = ends.copy()
    near[faces[ends[faces].any(axis=1)].ravel()] = True
    return near
