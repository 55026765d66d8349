"""Cleaning: the whole way from points to a mesh has the truth's topology, and each step keeps its promise."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.arrays import DistanceFn, Floats
from capture2vr.edge.errors import Cancelled
from capture2vr.edge.field.local import local_field
from capture2vr.edge.mesh.clean import clean
from capture2vr.edge.mesh.clip import clip
from capture2vr.edge.mesh.edges import border_edges, border_loops, edges_of
from capture2vr.edge.mesh.extract import extract
from capture2vr.edge.mesh.holes import fill_holes, zip_tears
from capture2vr.edge.mesh.manifold import to_manifold
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.pieces import without_collapsed
from capture2vr.edge.mesh.sampling import area
from capture2vr.edge.mesh.topology import orient, pieces_of, reseamed, seam_length
from tests.support import surfaces
from tests.support.mesh_metrics import compare

TETRAHEDRON = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])


def meshed(truth: Mesh, points: int, resolution: int, seed: int = 0) -> Mesh:
    near = surfaces.sampled(truth, points, seed=seed)
    return clean(extract(local_field(near), near, resolution=resolution), near)


def worst_edge(faces: np.ndarray) -> int:
    return int(edges_of(faces).size.max(initial=0))


def flips(mesh: Mesh) -> int:
    """Edges that two faces walk in the same direction."""
    half = edges_of(mesh.faces).halves(2)
    return int((mesh.faces.ravel()[half[:, 0]] == mesh.faces.ravel()[half[:, 1]]).sum())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "components", "loops"),
    [
        (surfaces.sphere, 1, 0),
        (surfaces.hemisphere, 1, 1),
        (surfaces.disk, 1, 1),
        (surfaces.cylinder, 1, 2),
        (surfaces.mobius, 1, 1),
        (surfaces.two_sheets, 2, 2),
        (surfaces.smooth_sheet, 1, 1),
        (surfaces.grid_with_holes, 1, 10),
    ],
)
def test_random_points_come_back_with_the_topology_of_the_truth(
    make: Callable[[], Mesh], components: int, loops: int
) -> None:
    mesh = meshed(make(), 10_000, 88)
    quality = compare(mesh, make(), 30_000)
    assert (quality.components, quality.boundary_loops, quality.non_manifold_edges) == (components, loops, 0)
    assert quality.chamfer_l1 < 1.1 * quality.floor
    assert quality.area_ratio == pytest.approx(1, abs=0.03)
    assert (flips(mesh) > 0) == (make is surfaces.mobius)


@pytest.mark.slow
@pytest.mark.parametrize("points", [1_000, 40_000])
def test_the_same_numbers_serve_any_density(points: int) -> None:
    quality = compare(meshed(surfaces.hemisphere(), points, 64), surfaces.hemisphere(), 20_000)
    assert (quality.components, quality.boundary_loops, quality.non_manifold_edges) == (1, 1, 0)


@pytest.mark.slow
@pytest.mark.parametrize(("points", "share"), [(20_000, 0.2), (40_000, 0.06)])
def test_no_hole_is_punched_where_the_points_grow_sparse(points: int, share: float) -> None:
    """Half of the disk has so few of the points: a fixed distance would tear one half or let the other overshoot."""
    near = surfaces.sampled(surfaces.disk(), points)
    rng = np.random.default_rng(1)
    near = near[(near[:, 0] > 0) | (rng.random(len(near)) < share)]
    mesh = clean(extract(local_field(near), near, resolution=96), near)
    quality = compare(mesh, surfaces.disk(), 20_000)
    assert (quality.components, quality.boundary_loops) == (1, 1)
    assert quality.area_ratio == pytest.approx(1, abs=0.03)


@pytest.mark.slow
def test_no_hole_is_cut_into_close_sheets_of_few_points() -> None:
    """1.3 spacings apart, so that each has the other's points among its neighbours."""
    quality = compare(meshed(surfaces.two_sheets(), 1_000, 64), surfaces.two_sheets(), 20_000)
    assert (quality.components, quality.boundary_loops, quality.non_manifold_edges) == (2, 2, 0)


@pytest.mark.slow
def test_what_no_points_back_is_trimmed_and_specks_go() -> None:
    near = surfaces.sampled(surfaces.disk(), 5_000)
    wide = surfaces.patch(lambda u, v: [u, v, 0 * u], 150, 150)
    far = surfaces.moved(Mesh(surfaces.disk().vertices * 0.01, surfaces.disk().faces), (0, 0, 0.4))
    both = Mesh(
        np.concatenate([wide.vertices * 1.2, far.vertices]),
        np.concatenate([wide.faces, far.faces + len(wide.vertices)]),
    )
    mesh = clean(both, near)
    assert len(np.unique(pieces_of(mesh.faces))) == 1
    assert np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1]).max() < 0.52
    assert area(mesh) == pytest.approx(np.pi / 4, rel=0.03)


@pytest.mark.slow
def test_leaves_of_few_points_are_no_specks() -> None:
    """Their neighbours lie on other leaves, so their own spacing looks wider than it is."""
    rng = np.random.default_rng(0)
    leaf = surfaces.disk()
    at = rng.uniform(-0.5, 0.5, (12, 3))
    leaves = surfaces.joined(*(surfaces.moved(Mesh(0.2 * leaf.vertices, leaf.faces), tuple(place)) for place in at))
    near = surfaces.sampled(leaves, 12 * 25, seed=1)
    mesh = clean(leaves, near)
    assert area(mesh) > 0.9 * area(leaves)


def test_fins_that_stand_off_the_points_are_drawn_tight() -> None:
    near = surfaces.sampled(surfaces.disk(), 5_000)  # spaced 0.0125 apart
    sheet = surfaces.patch(lambda u, v: [u, v, 0 * u], 100, 100)
    across = np.abs(sheet.vertices[:, 0])
    sheet.vertices[:, 2] = np.maximum(0.02 - across, 0) * (np.abs(sheet.vertices[:, 1]) < 0.2)
    mesh = clean(sheet, near)
    assert sheet.vertices[:, 2].max() == pytest.approx(0.02)
    assert mesh.vertices[:, 2].max() < 0.005
    assert len(border_loops(mesh.faces)) == 1


def test_a_piece_that_was_drawn_together_to_a_point_goes() -> None:
    ball = surfaces.sphere()
    assert without_collapsed(ball) is ball
    point = Mesh(np.full((4, 3), 3.0), TETRAHEDRON)
    left = without_collapsed(surfaces.joined(ball, point))
    np.testing.assert_array_equal(left.faces, ball.faces)


def test_a_bend_between_points_is_not_drawn_flat() -> None:
    """Far from the few points the field's smooth bend stands, where a fin would not."""
    dome = surfaces.hemisphere()
    mesh = clean(dome, surfaces.sampled(dome, 400))
    inner = np.delete(mesh.vertices, np.unique(border_edges(mesh.faces)), axis=0)
    assert np.linalg.norm(inner - np.array([0, 0, -0.25]), axis=1).min() > 0.498


def test_tick_rises_to_one_and_cancels() -> None:
    near = surfaces.sampled(surfaces.disk(), 1_000)
    raw, heard = extract(local_field(near), near, resolution=32), list[float]()
    clean(raw, near, tick=heard.append)
    assert heard == sorted(heard)
    assert (heard[0], heard[-1]) == (0, 1)

    def stop(fraction: float) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        clean(raw, near, tick=stop)


def test_an_empty_mesh_stays_empty() -> None:
    empty = Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))
    assert len(clean(empty, surfaces.sampled(surfaces.disk(), 100)).faces) == 0


@settings(max_examples=40)
@given(seed=st.integers(0, 2**31))
def test_any_soup_is_cut_to_a_manifold_without_losing_area(seed: int) -> None:
    rng = np.random.default_rng(seed)
    soup = Mesh(rng.random((8, 3)), rng.integers(0, 8, (24, 3)))
    proper = (np.diff(np.sort(soup.faces, axis=1), axis=1) > 0).all(axis=1)
    whole = Mesh(soup.vertices, soup.faces[proper])
    mesh = to_manifold(whole)
    assert worst_edge(mesh.faces) <= 2
    assert area(mesh) == pytest.approx(area(whole), rel=0.2)  # the cut vertices draw back a little
    ends, uses = np.unique(border_edges(mesh.faces), return_counts=True)
    assert (uses == 2).all()
    assert sum(len(loop) for loop in border_loops(mesh.faces)) == len(ends)


def test_two_tetrahedra_on_one_edge_and_two_on_one_vertex_are_parted() -> None:
    rng = np.random.default_rng(0)
    on_edge = Mesh(rng.random((6, 3)), np.concatenate([TETRAHEDRON, np.array([0, 1, 4, 5])[TETRAHEDRON]]))
    assert worst_edge(on_edge.faces) == 4
    assert worst_edge(to_manifold(on_edge).faces) == 2
    on_vertex = Mesh(rng.random((7, 3)), np.concatenate([TETRAHEDRON, np.array([0, 4, 5, 6])[TETRAHEDRON]]))
    assert len(to_manifold(on_vertex).vertices) == 8


def test_a_seam_moves_and_leaves_no_trace() -> None:
    band = orient(to_manifold(_welded(surfaces.mobius())))
    moved = reseamed(band)
    assert seam_length(band.faces) > 0
    assert seam_length(moved.faces) > 0
    assert not _seam(band) & _seam(moved)
    assert (np.sort(moved.faces, axis=1) == np.sort(band.faces, axis=1)).all()


def test_what_has_two_sides_has_no_seam_once_it_is_moved() -> None:
    ball = surfaces.sphere()
    turned = np.where(np.random.default_rng(0).random((len(ball.faces), 1)) < 0.5, ball.faces[:, ::-1], ball.faces)
    assert seam_length(turned) > 0
    assert seam_length(reseamed(Mesh(ball.vertices, turned)).faces) == 0


def _seam(mesh: Mesh) -> set[tuple[int, int]]:
    """Edges that two faces walk in the same direction."""
    walked = Counter(edge for face in mesh.faces.tolist() for edge in zip(face, face[1:] + face[:1], strict=True))
    return {(min(edge), max(edge)) for edge, times in walked.items() if times > 1}


@pytest.mark.parametrize("open_below", [-1.0, -0.2, 0.0], ids=["closed", "a bowl", "half a ball"])
def test_orient_winds_alike_and_hollow_pieces_outwards(open_below: float) -> None:
    ball = extract(*_ball(), resolution=24)
    rng = np.random.default_rng(0)
    turned = np.where((rng.random(len(ball.faces)) < 0.5)[:, None], ball.faces[:, ::-1], ball.faces)
    kept = ball.vertices[ball.faces][:, :, 2].mean(axis=1) > open_below * ball.vertices[:, 2].max()
    mesh = orient(Mesh(ball.vertices, turned[kept]))
    corners = mesh.vertices[mesh.faces]
    outward = np.einsum(
        "fx,fx->f", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), corners[:, 0]
    )
    assert flips(mesh) == 0
    assert (outward > 0).all()


def test_a_mobius_strip_keeps_a_single_short_seam() -> None:
    strip = to_manifold(_welded(surfaces.mobius()))
    assert 0 < flips(orient(strip)) < 40  # across 32 cells


def test_clip_follows_the_level_through_faces() -> None:
    sheet = surfaces.patch(lambda u, v: [u, v, 0 * u], 40, 40)
    distance = np.hypot(sheet.vertices[:, 0], sheet.vertices[:, 1])
    mesh = to_manifold(clip(sheet, distance - 0.3))
    rim = np.unique(border_edges(mesh.faces))
    assert area(mesh) == pytest.approx(np.pi * 0.09, rel=0.02)
    assert np.abs(np.hypot(*mesh.vertices[rim, :2].T) - 0.3).max() < 0.01  # a cut near a vertex snaps to it
    assert worst_edge(mesh.faces) == 2
    assert len(clip(sheet, distance + 1).faces) == 0
    assert len(clip(sheet, distance - 1).faces) == len(sheet.faces)


def test_pin_holes_close_and_real_holes_stay() -> None:
    sheet = surfaces.patch(lambda u, v: [u, v, 0 * u], 40, 40)
    middle = sheet.vertices[sheet.faces].mean(axis=1)[:, :2]
    small = np.linalg.norm(middle - [0.2, 0.2], axis=1) < 0.04
    large = np.linalg.norm(middle - [-0.2, -0.2], axis=1) < 0.15
    torn = to_manifold(Mesh(sheet.vertices, sheet.faces[~small & ~large]))
    assert len(border_loops(torn.faces)) == 3
    filled = fill_holes(torn, np.full(len(torn.vertices), 0.5))
    assert len(border_loops(filled.faces)) == 2
    assert area(filled) == pytest.approx(area(sheet) - 0.15**2 * np.pi, rel=0.02)


@pytest.mark.parametrize("bend", [0.0, 1.0], ids=["flat", "along a crease"])
def test_long_slits_close_by_their_area(bend: float) -> None:
    sheet = surfaces.patch(lambda u, v: [u, v, bend * np.abs(u - 0.5)], 60, 60)
    middle = sheet.vertices[sheet.faces].mean(axis=1)
    slit = (np.abs(middle[:, 0]) < 0.03) & (np.abs(middle[:, 1]) < 0.25)
    torn = to_manifold(Mesh(sheet.vertices, sheet.faces[~slit]))
    shorter = np.full(len(torn.vertices), 0.1)
    missing = area(sheet) - area(torn)

    def filled(most: float) -> Mesh:
        return fill_holes(torn, shorter, largest=np.full(len(torn.vertices), most))

    assert len(filled(0.5 * missing).faces) == len(torn.faces)
    mended = filled(1.2 * missing)
    assert len(border_loops(mended.faces)) == 1
    assert worst_edge(mended.faces) == 2
    assert flips(mended) == 0
    assert area(sheet) * 0.96 < area(mended) <= area(sheet) * 1.001


def test_a_slit_is_not_closed_over_an_edge_that_is_there() -> None:
    sheet = surfaces.patch(lambda u, v: [u, v, np.abs(u - 0.5)], 60, 60)
    middle = sheet.vertices[sheet.faces].mean(axis=1)
    torn = Mesh(sheet.vertices, sheet.faces[(np.abs(middle[:, 0]) > 0.03) | (np.abs(middle[:, 1]) > 0.25)])
    border, count = border_edges(torn.faces), len(torn.vertices)
    zero, enough = np.zeros(count + 1), np.full(count + 1, 0.1)
    closed = fill_holes(torn, zero, border, largest=enough)
    chord = closed.faces[len(torn.faces) + 5, :2]
    flap = Mesh(np.concatenate([torn.vertices, [[0, 0, 1]]]), np.concatenate([torn.faces, [[*chord, count]]]))
    again = fill_holes(flap, zero, border, largest=enough)
    assert len(again.faces) == len(closed.faces) + 1
    assert worst_edge(again.faces) == 2


@pytest.mark.slow
def test_a_cube_of_random_points_has_no_slits_along_its_edges() -> None:
    near = surfaces.sampled(surfaces.cube(), 4_000, seed=3)
    mesh = clean(extract(local_field(near), near, resolution=96), near)
    longest = max((len(loop) for loop in border_loops(mesh.faces)), default=0)
    assert longest < 40  # a gap by chance may stay open; slits had 60 and more
    assert area(mesh) == pytest.approx(6, rel=0.02)


def test_a_tear_along_a_fold_is_zipped_and_outer_corners_are_not() -> None:
    folded = surfaces.patch(lambda u, v: [u, v, np.abs(u - 0.5)], 60, 60)
    middle = folded.vertices[folded.faces].mean(axis=1)
    tear = (np.abs(middle[:, 0]) < 0.04) & (np.abs(middle[:, 1]) < 0.3)
    torn = to_manifold(Mesh(folded.vertices, folded.faces[~tear]))
    mesh = to_manifold(zip_tears(torn, np.full(len(torn.vertices), 0.15)))
    assert len(border_loops(torn.faces)) == 2
    assert len(border_loops(mesh.faces)) == 1
    assert area(mesh) == pytest.approx(area(folded), rel=0.03)


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize(
    ("file", "points", "resolution", "most", "pieces"),
    [
        ("dress/dress-v17k-f34k.obj", 10_000, 112, 0.0034, 20),
        ("tshirt_folded/tshirt1900-folding-triFolded.obj", 10_000, 112, 0.0043, 75),
        ("car/vehicle_example.gltf", 10_000, 112, 0.0038, 31),
        ("moebius/moebius-160-10.ply", 10_000, 112, 0.00115, 1),
        ("open_surfaces/hemisphere.obj", 10_000, 112, 0.0022, 1),
    ],
)
def test_real_shapes_beat_the_best_known_figures(
    data_dir: Path, file: str, points: int, resolution: int, most: float, pieces: int
) -> None:
    truth = surfaces.read_unit(data_dir / file)
    quality = compare(meshed(truth, points, resolution, seed=1), truth)
    assert quality.chamfer_l1 < most
    assert quality.components <= pieces
    assert quality.non_manifold_edges <= 1e-3 * quality.edges


def _ball() -> tuple[DistanceFn, Floats]:
    def distance(q: Floats) -> tuple[Floats, Floats]:
        away = np.linalg.norm(q, axis=1)
        return np.abs(away - 0.5), q / away[:, None] * np.sign(away - 0.5)[:, None]

    return distance, surfaces.sampled(surfaces.sphere(), 3_000)


def _welded(mesh: Mesh) -> Mesh:
    """One vertex for every place, to 1e-9 of the unit frame."""
    places, index = np.unique(np.round(mesh.vertices, 9), axis=0, return_inverse=True)
    return Mesh(places, index.ravel()[mesh.faces])
