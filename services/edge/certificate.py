"""Quality figures of a reconstructed surface, measured without a ground truth on held-out points of the cloud.

h_j   a held-out point, kept out of the field's input, with all its noise
s_j   the spacing of the input points around it
d_j   its distance to the mesh
q, q̂  a query near the surface and where the field pulls it: q̂ = q − f(q)·ĝ(q)

Everything is in the unit frame. A surface that follows the noise or bridges a fold is far from points that its field
was not given, so d shows which of two surfaces of one cloud is better. With noise σ in the points d cannot fall below
some 0.8 σ, for any surface. What d cannot show is surface where no point is: the stray area measures that.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import DistanceFn, Floats, Ints
from capture2vr.edge.capture.facts import Origin
from capture2vr.edge.mesh.distance import distance_to_mesh
from capture2vr.edge.mesh.edges import edges_of
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.pieces import Piece
from capture2vr.edge.mesh.sampling import area, sample
from capture2vr.edge.mesh.spacing import point_spacing
from capture2vr.edge.mesh.topology import component_count
from capture2vr.edge.render.photo_comparison import PhotoFigures
from capture2vr.edge.render.seen_around import fringe, largest_hole
from capture2vr.sentences.sentence import in_row, say

HELD_OUT_SHARE = 0.02  # of the points
HELD_OUT = (20, 2_000)  # least and most points: fewer say nothing, and 2,000 give their mean distance to within 2 %
HOLD_OUT_FROM = 500  # points; below it the least number would thin the cloud by more than 4 %: none is held out
INPUT_POINTS = 10_000  # of the input, for the distances that no field is judged by: 0.2 s
PROBES = 5_000  # queries for the consistency, and samples of the mesh: gives shares to within 1 %
NEAR = 0.5  # spacings: standard deviation of the queries' offset from a point, where the extraction queries too
STRAY = 2.0  # spacings: no disc of that radius is empty inside a surface (see `mesh/support.py`)
_TINY = 1e-12
_SEED = 0

Outcome = Literal["better", "even", "worse"]

# How much worse than the preview a refined mesh may be before it is called worse. Each is twice the difference between
# two samplings of one surface.
SIGNIFICANCE = 2.0  # standard errors of the mean of the paired differences
MAX_FARTHER = 0.01  # of the preview's mean distance: less cannot be seen
MAX_UNCOVERED = 0.005  # share of the held-out points
MAX_STRAY = 0.01  # share of the mesh's area
MAX_NON_MANIFOLD = 0.001  # non-manifold edges, of all edges
MAX_HOLES = 0.01  # share of what held-out photos show of the thing
MAX_PIECES = (2, 3)  # components: at most 2 × the preview's + 3, for thin parts that come apart or are found


@dataclass(frozen=True, slots=True)
class Evidence:
    """The points that surfaces of one cloud are compared with.

    xyz (N,3) the points that the fields were given, as measured or denoised, N ≥ 2; tree: KD-tree of `xyz`;
    held_out (H,3) points that they were not given, H = 0 for a cloud too small to spare any.
    """

    xyz: Floats
    tree: cKDTree
    held_out: Floats

    @classmethod
    def of(cls, xyz_unit: Floats, held_out: Floats) -> Evidence:
        """Build the KD-tree of a cloud, and keep it with the held-out points."""
        return cls(xyz_unit, cKDTree(xyz_unit), held_out)

    def spacing_of(self, index: Ints) -> Floats:
        """Estimate the spacing (M,) around some input points; for all of a large cloud it would take too long."""
        return point_spacing(self.xyz[index], self.tree)


@dataclass(frozen=True, slots=True)
class Certificate:
    """Quality figures of a surface, unit frame.

    held_out             number of points held out; 0: the cloud is too small, and its input points are used instead
    held_out_mean, _median, _p95   their distance to the mesh
    coverage             share of them within one local spacing of the mesh
    points_to_mesh_median, _p95    distance of the input points to the mesh
    consistency          mean of 1 − |cos(g(q), g(q̂))| near the surface: 0 where the field falls straight
    stray_area           share of the mesh farther than two spacings from every input point
    boundary_length      of all borders; boundary_loops: their connected chains; fringe: how many times as long they are
                         as when they are smoothed
    largest_hole         share of the mesh's pixels that show its inside, from the direction in which it is most
    distances            (H,) of the held-out points, for comparing two surfaces point by point
    photos               figures of the comparison with held-out photos; None where the capture could spare none, and
                         until they are compared: `certify` does not
    origin               of the points: figures of a guess, or of what was generated, are about it, and not about the
                         object
    pieces               of the surface, kept and dropped, with reasons; those dropped are not in the other figures
    """

    held_out: int
    held_out_mean: float
    held_out_median: float
    held_out_p95: float
    coverage: float
    points_to_mesh_median: float
    points_to_mesh_p95: float
    consistency: float
    stray_area: float
    area: float
    triangles: int
    components: int
    boundary_length: float
    boundary_loops: int
    non_manifold_edges: int
    fringe: float
    largest_hole: float
    distances: Floats = field(repr=False, compare=False)
    photos: PhotoFigures | None = None
    origin: Origin = "measured"
    pieces: tuple[Piece, ...] = ()

    @property
    def border_over_root(self) -> float:
        """Length of the borders over the root of the area: 0 for a closed surface, 6 for a dress, more in shreds."""
        return self.boundary_length / float(np.sqrt(max(self.area, 1e-300)))

    def as_json(self) -> dict[str, Any]:
        """Serialise the figures as JSON, without the distances, which only `compare` needs."""
        figures = asdict(self)
        del figures["distances"]
        return {**figures, "border_over_root": round(self.border_over_root, 3)}


@dataclass(frozen=True, slots=True)
class QualityVerdict:
    """Result of comparing the refined surface with the preview: the outcome, and a sentence with the figures."""

    outcome: Outcome
    because: str


def hold_out(count: int, sets: int = 1) -> Ints:
    """Choose held-out points at random: (N,) 0 for points that the fields may use, else the held-out set 1, 2, ...

    Each set is a fixed random 2 %, at least 20 and at most 2,000 points; of fewer than 500 points none is held out.
    """
    which = np.zeros(count, np.int64)
    if count >= HOLD_OUT_FROM:
        size = int(np.clip(HELD_OUT_SHARE * count, *HELD_OUT))
        drawn = np.random.default_rng(_SEED).permutation(count)[: sets * size]
        which[drawn] = 1 + np.arange(len(drawn)) // size
    return which


def certify(
    distance: DistanceFn,
    mesh_unit: Mesh,
    evidence: Evidence,
    pieces: tuple[Piece, ...] = (),
) -> Certificate:
    """Measure a field and its mesh, which has faces, against the evidence: 0.3 s at 10,000 points, 1 s at 200,000.

    pieces  of the surface, kept and dropped
    """
    rng = np.random.default_rng(_SEED)
    inputs = evidence.xyz[rng.permutation(len(evidence.xyz))[:INPUT_POINTS]]
    held_out = evidence.held_out if len(evidence.held_out) else inputs
    input_away, away = np.split(distance_to_mesh(np.concatenate([inputs, held_out]), mesh_unit), [len(inputs)])
    neighbour = evidence.tree.query(held_out, workers=-1)[1]
    mesh_away, nearest = evidence.tree.query(sample(mesh_unit, PROBES, rng).xyz, workers=-1)
    edges = edges_of(mesh_unit.faces)
    border = edges.border_ends
    return Certificate(
        held_out=len(evidence.held_out),
        held_out_mean=float(away.mean()),
        held_out_median=float(np.median(away)),
        held_out_p95=float(np.quantile(away, 0.95)),
        coverage=float((away <= evidence.spacing_of(neighbour)).mean()),
        points_to_mesh_median=float(np.median(input_away)),
        points_to_mesh_p95=float(np.quantile(input_away, 0.95)),
        consistency=consistency(distance, _near_surface(evidence, rng)),
        stray_area=float((mesh_away > STRAY * evidence.spacing_of(nearest)).mean()),
        area=area(mesh_unit),
        triangles=len(mesh_unit.faces),
        components=component_count(edges.ends),
        boundary_length=_length(mesh_unit, border),
        boundary_loops=component_count(border),
        non_manifold_edges=edges.crowded_count,
        fringe=fringe(mesh_unit, edges.border(mesh_unit.faces)),
        largest_hole=largest_hole(mesh_unit),
        distances=away,
        pieces=pieces,
    )


def compare(preview: Certificate, refined: Certificate) -> QualityVerdict:
    """Compare the figures of two surfaces of one cloud: is the refined one better, even or worse than the preview?

    Worse: significantly farther from the held-out points, fewer of them covered, more surface where no points are, more
    non-manifold edges, or more separate pieces. Better: not worse, and nearer to the held-out points on average. The
    distances are compared point by point, so that the noise, which both share, cancels.
    """
    farther = refined.distances - preview.distances
    mean, error = float(farther.mean()), float(farther.std() / np.sqrt(len(farther)))
    share = np.sqrt(preview.coverage * (1 - preview.coverage) / len(farther))
    edges = 1.5 * refined.triangles  # of a surface: three to a triangle, each shared by two
    limit = max(SIGNIFICANCE * error, MAX_FARTHER * preview.held_out_mean)
    judged_by = say("held_out_points") if refined.held_out else say("input_points")
    faults = {
        say("lies_farther", points=judged_by): mean > limit,
        say("covers_fewer_points"): refined.coverage < preview.coverage - MAX_UNCOVERED - SIGNIFICANCE * share,
        say("has_more_surface_where"): refined.stray_area > preview.stray_area + MAX_STRAY,
        say("has_more_non_manifold_edges"): refined.non_manifold_edges
        > preview.non_manifold_edges + MAX_NON_MANIFOLD * edges,
        say("shows_more_holes_in_held"): _holes(refined) > _holes(preview) + MAX_HOLES,
        say("has_more_separate_pieces"): refined.components > MAX_PIECES[0] * preview.components + MAX_PIECES[1],
    }
    figures = say(
        "mean_distance_to_coverage_pieces",
        count=len(farther),
        which=judged_by,
        number=refined.held_out_mean,
        before=preview.held_out_mean,
        error=error,
        coverage=refined.coverage,
        earlier=preview.coverage,
        pieces=refined.components,
        pieces_before=preview.components,
    )
    if any(faults.values()):
        faulty = in_row(", ", (fault for fault, found in faults.items() if found))
        return QualityVerdict("worse", say("refined_surface", faulty=faulty, figures=figures))
    return QualityVerdict("better" if mean < 0 else "even", figures)


def _holes(certificate: Certificate) -> float:
    """Share of what held-out photos show of the thing that the mesh lacks or shows from inside; 0 without photos."""
    photos = certificate.photos
    return 0.0 if photos is None else max(photos.lace, 1 - photos.cover) + photos.inside_out


def consistency(distance: DistanceFn, queries: Floats) -> float:
    """Mean of 1 − |cos(g(q), g(q̂))| over near-surface queries q (M,3), with q̂ = q − f(q)·ĝ(q) where the field pulls q.

    0 where the level sets of the field run parallel, as those of a true distance do between a surface and its medial
    axis. A gradient of length 0 counts as 1. Raises ValueError without queries.
    """
    if len(queries) == 0:
        raise ValueError("queries is empty: the consistency of a field needs at least one")
    f, gradient = distance(queries)
    direction = _directions(gradient)
    _, at_pull = distance(queries - f[:, None] * direction)
    return float(np.mean(1 - np.abs(np.einsum("mx,mx->m", direction, _directions(at_pull)))))


def _near_surface(evidence: Evidence, rng: np.random.Generator) -> Floats:
    """(M,3) queries near the surface: random input points, with a normally distributed offset of σ = half a spacing."""
    chosen = rng.integers(len(evidence.xyz), size=PROBES)
    offset = rng.normal(size=(PROBES, 3)) * (NEAR * evidence.spacing_of(chosen)[:, None])
    queries: Floats = evidence.xyz[chosen] + offset
    return queries


def _directions(gradient: Floats) -> Floats:
    """(N,3) unit vectors of gradients (N,3)."""
    g = np.asarray(gradient, np.float64)
    direction: Floats = g / (np.linalg.norm(g, axis=1, keepdims=True) + _TINY)
    return direction


def _length(mesh: Mesh, edges: Ints) -> float:
    """Total length of edges (E,2)."""
    ends = mesh.vertices[edges]
    return float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).sum())
