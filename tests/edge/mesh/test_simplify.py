"""Simplification: fewer triangles, the same openings, the same surface."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import Floats
from capture2vr.edge.mesh.edges import edges_of
from capture2vr.edge.mesh.manifold import without_fins
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.sampling import area, sample
from capture2vr.edge.mesh.simplify import Collapse, by_fast_simplification, by_meshoptimizer, lods, simplify
from capture2vr.edge.mesh.topology import component_count, orient
from tests.support import surfaces
from tests.support.mesh_metrics import chamfer_l1

HAS_MESHOPTIMIZER = find_spec("meshoptimizer") is not None  # an extra: it needs a compiler
COLLAPSES = [by_fast_simplification, *([by_meshoptimizer] if HAS_MESHOPTIMIZER else [])]


def welded(mesh: Mesh) -> Mesh:
    """The mesh with coinciding vertices made one, as an extraction gives it."""
    vertices, corners = np.unique(mesh.vertices.round(9), axis=0, return_inverse=True)
    faces = corners.ravel()[mesh.faces]
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return Mesh(vertices, faces[whole])


SURFACES = {
    "disk": welded(surfaces.disk()),
    "hemisphere": welded(surfaces.hemisphere()),
    "cylinder": welded(
        surfaces.patch(lambda u, v: [np.cos(6.283185307179586 * u), np.sin(6.283185307179586 * u), v], 96, 40)
    ),
    "grid with holes": surfaces.grid_with_holes(),
    "two sheets": surfaces.two_sheets(),
    "pleated skirt": welded(surfaces.pleated_skirt()),
}


def borders(mesh: Mesh) -> int:
    edges = edges_of(mesh.faces)
    return component_count(edges.border_ends)


def crowded(mesh: Mesh) -> int:
    return edges_of(mesh.faces).crowded_count


def along_border(mesh: Mesh) -> Floats:
    """Points of the border, 20 on each edge."""
    edges = edges_of(mesh.faces)
    a, b = mesh.vertices[edges.border_ends.T]
    share = np.linspace(0, 1, 20)[:, None, None]
    return (a + share * (b - a)).reshape(-1, 3)


def border_gap(a: Mesh, b: Mesh) -> float:
    """Hausdorff distance of the borders."""
    first, second = along_border(a), along_border(b)
    return float(max(cKDTree(first).query(second)[0].max(), cKDTree(second).query(first)[0].max()))


@pytest.mark.parametrize("collapse", COLLAPSES)
@pytest.mark.parametrize("name", SURFACES)
def test_the_openings_stay_where_they_are(name: str, collapse: Collapse) -> None:
    mesh = SURFACES[name]
    coarse = simplify(mesh, 2000, collapse=collapse)
    assert len(coarse.faces) < len(mesh.faces)
    assert borders(coarse) == borders(mesh)
    assert border_gap(coarse, mesh) < 0.02
    assert crowded(coarse) == 0
    assert area(coarse) == pytest.approx(area(mesh), rel=0.02)


@pytest.mark.skipif(not HAS_MESHOPTIMIZER, reason="only meshoptimizer thins borders out")
@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("budget", [200, 1000, 4000])
def test_the_budget_is_kept_and_nearly_used(name: str, budget: int) -> None:
    coarse = simplify(SURFACES[name], budget)
    assert 0.9 * budget <= len(coarse.faces) <= budget
    assert borders(coarse) == borders(SURFACES[name])
    assert crowded(coarse) == 0


@pytest.mark.slow
@settings(max_examples=12)
@given(st.sampled_from(sorted(SURFACES)), st.integers(100, 3000), st.integers(0, 2**32 - 1))
def test_noise_makes_no_pinches_and_closes_no_opening(name: str, budget: int, seed: int) -> None:
    """What an extraction gives is bumpy at the scale of its cells."""
    mesh = SURFACES[name]
    rng = np.random.default_rng(seed)
    rgb = rng.integers(0, 256, mesh.vertices.shape, dtype=np.uint8)
    rough = Mesh(mesh.vertices + rng.normal(0, 0.002, mesh.vertices.shape), mesh.faces, rgb)
    coarse = simplify(rough, budget)
    assert borders(coarse) == borders(mesh)
    assert crowded(coarse) == 0


@pytest.mark.parametrize("name", ["hemisphere", "mobius"])
def test_windings_do_not_hold_a_surface_fast(name: str) -> None:
    """Along seams no edge collapses; a dress whose sleeve had grown onto its skirt once kept little but its seams."""
    mesh = orient(getattr(surfaces, name)())
    turned = np.random.default_rng(0).random((len(mesh.faces), 1)) < 0.5
    coarse = simplify(Mesh(mesh.vertices, np.where(turned, mesh.faces[:, ::-1], mesh.faces)), 600)
    assert len(coarse.faces) <= 600
    smooth = chamfer_l1(simplify(mesh, 600), mesh, 20_000)
    assert chamfer_l1(coarse, mesh, 20_000) < 1.3 * smooth


def test_a_dome_that_was_seen_from_within_keeps_its_front_although_a_part_of_it_is_wound_wrong() -> None:
    dome = orient(surfaces.hemisphere())
    within = np.random.default_rng(0).random((len(dome.faces), 1)) < 0.8
    coarse = simplify(Mesh(dome.vertices, np.where(within, dome.faces[:, ::-1], dome.faces)), 600)
    outward = coarse.vertices[coarse.faces].mean(axis=1) - [0, 0, dome.vertices[:, 2].min()]
    towards = np.einsum("fx,fx->f", face_normals(coarse.vertices, coarse.faces), outward)
    assert towards.min() < towards.max() <= 1e-12


@pytest.mark.parametrize(("name", "budget"), [("mobius", 600), ("two_sheets", 1500)])
def test_rough_surfaces_with_seams_get_no_pinches(name: str, budget: int) -> None:
    mesh = orient(getattr(surfaces, name)())
    rng = np.random.default_rng(0)
    rough = mesh.vertices + rng.normal(0, 0.02, mesh.vertices.shape)
    turned = rng.random((len(mesh.faces), 1)) < 0.5
    assert crowded(simplify(Mesh(rough, np.where(turned, mesh.faces[:, ::-1], mesh.faces)), budget)) == 0


def test_the_surface_stays_where_it_is() -> None:
    mesh = SURFACES["hemisphere"]
    assert chamfer_l1(simplify(mesh, 2000), mesh, 20_000) == pytest.approx(
        chamfer_l1(mesh, mesh, 20_000, seed=1), abs=1e-3
    )


@pytest.mark.slow
@pytest.mark.parametrize("collapse", COLLAPSES)
def test_jobs_side_by_side_do_not_mix(collapse: Collapse) -> None:
    jobs = [(mesh, budget) for mesh in SURFACES.values() for budget in (900, 2500)]
    alone = [simplify(mesh, budget, collapse=collapse) for mesh, budget in jobs]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda job: simplify(*job, collapse=collapse), jobs))
    for one, other in zip(alone, together, strict=True):
        assert np.array_equal(one.faces, other.faces)
        assert np.array_equal(one.vertices, other.vertices)


def test_a_torn_patch_does_not_starve_the_rest() -> None:
    """Holding on to every bit of a rough corner once left a dress of 5,000 faces with a front of a dozen."""
    mesh = SURFACES["pleated skirt"]
    torn = mesh.vertices[:, 0] > 0.3
    noise = np.random.default_rng(0).normal(0, 0.01, mesh.vertices.shape) * torn[:, None]
    coarse = simplify(Mesh(mesh.vertices + noise, mesh.faces), 5000)
    assert crowded(coarse) == 0
    assert len(coarse.faces) <= 5000
    smooth = sample(coarse, 50_000, np.random.default_rng(0)).xyz
    smooth = smooth[smooth[:, 0] < 0.25]
    assert np.quantile(cKDTree(mesh.vertices).query(smooth)[0], 0.99) < 0.01


def test_no_vertex_is_left_without_a_face() -> None:
    coarse = simplify(SURFACES["disk"], 500)
    assert np.array_equal(np.unique(coarse.faces), np.arange(len(coarse.vertices)))


def test_a_mesh_within_its_budget_is_returned_as_it_is() -> None:
    mesh = SURFACES["disk"]
    assert simplify(mesh, len(mesh.faces)) is mesh


def test_a_budget_below_one_is_refused() -> None:
    with pytest.raises(ValueError, match="budget of 0 faces"):
        simplify(SURFACES["disk"], 0)


@pytest.mark.parametrize("collapse", COLLAPSES)
def test_colours_are_those_of_the_place(collapse: Collapse) -> None:
    mesh = SURFACES["disk"]
    left = mesh.vertices[:, 0] < 0
    coarse = simplify(
        replace(mesh, rgb=np.where(left[:, None], [200, 30, 30], [30, 30, 200]).astype(np.uint8)),
        1500,
        collapse=collapse,
    )
    assert coarse.rgb is not None
    assert len(coarse.rgb) == len(coarse.vertices)
    clear = np.abs(coarse.vertices[:, 0]) > 0.05
    assert np.array_equal((coarse.rgb[:, 0] > 100)[clear], (coarse.vertices[:, 0] < 0)[clear])


def test_a_few_shades_average_instead_of_one_winning() -> None:
    """A vertex stands for all that were merged into it: noise must not survive as speckles."""
    mesh = SURFACES["disk"]
    rgb = np.random.default_rng(0).integers(60, 196, (len(mesh.vertices), 3)).astype(np.uint8)
    coarse = simplify(replace(mesh, rgb=rgb), 1500)
    assert coarse.rgb is not None
    assert coarse.rgb.std() < 0.7 * rgb.std()


@pytest.mark.skipif(not HAS_MESHOPTIMIZER, reason="only meshoptimizer looks at colours")
def test_the_outline_of_a_print_stays_sharp() -> None:
    """A painted circle on a flat disk: geometry alone would merge right across it."""
    mesh = SURFACES["disk"]
    inside = np.linalg.norm(mesh.vertices[:, :2], axis=1) < 0.25
    printed = replace(mesh, rgb=np.where(inside[:, None], [240, 240, 240], [20, 20, 20]).astype(np.uint8))
    coarse = simplify(printed, 1500)
    assert coarse.rgb is not None
    bright = coarse.rgb[coarse.faces].mean(axis=(1, 2))
    centre = np.linalg.norm(coarse.vertices[coarse.faces].mean(axis=1), axis=1)
    assert (bright[centre < 0.23] > 200).mean() > 0.95
    assert (bright[centre > 0.27] < 60).mean() > 0.95


def test_levels_of_a_small_mesh_start_with_itself_and_get_cheaper() -> None:
    mesh = surfaces.two_sheets()  # 40,000 faces
    levels = lods(mesh)
    assert levels[0] is mesh
    assert 22_000 < len(levels[1].faces) <= 25_000
    assert 4_500 < len(levels[2].faces) <= 5_000


def test_a_mesh_below_all_budgets_still_gets_cheaper_levels() -> None:
    counts = [len(level.faces) for level in lods(welded(surfaces.patch(lambda u, v: [u, v, u * v], 40, 40)))]
    assert counts[0] == 3200
    assert counts[0] > counts[1] > counts[2] >= 100


def test_a_single_triangle_has_three_equal_levels() -> None:
    triangle = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    assert [len(level.faces) for level in lods(triangle)] == [1, 1, 1]


def test_budgets_must_fall() -> None:
    with pytest.raises(ValueError, match="must fall"):
        lods(SURFACES["disk"], (5_000, 5_000))


@pytest.mark.data
@pytest.mark.skipif(not HAS_MESHOPTIMIZER, reason="only meshoptimizer thins borders out")
@pytest.mark.parametrize("budget", [10_000, 2_000, 500])
def test_a_real_dress_keeps_neck_sleeves_and_hem(data_dir: Path, budget: int) -> None:
    import trimesh

    raw = trimesh.load(data_dir / "dress" / "dress-v17k-f34k.obj", force="mesh", process=False)
    mesh = welded(Mesh(np.array(raw.vertices), np.array(raw.faces)))
    coarse = simplify(mesh, budget)
    assert len(coarse.faces) <= budget
    assert borders(coarse) == borders(mesh)
    assert crowded(coarse) <= crowded(mesh)


def perforated(holes: int = 24, cells: int = 6) -> Mesh:
    """A square sheet with `holes` × `holes` square openings, each in a block of `cells` × `cells` quads."""
    side = holes * cells
    sheet = surfaces.patch(lambda u, v: [u, v, 0 * u], side, side)
    row, column = np.divmod(np.arange(len(sheet.faces)) // 2, side)
    opening = ((row % cells) // 2 == 1) & ((column % cells) // 2 == 1)
    return welded(Mesh(sheet.vertices, sheet.faces[~opening]))


@pytest.mark.parametrize("collapse", COLLAPSES)
def test_a_budget_that_cannot_hold_all_openings_wins_over_them(collapse: Collapse) -> None:
    mesh = perforated()
    openings = 24 * 24
    budget = 2 * openings  # an opening needs more than two faces around it
    coarse = simplify(mesh, budget, collapse=collapse)
    assert len(coarse.faces) <= budget
    assert (edges_of(coarse.faces).size <= 2).all()
    assert chamfer_l1(coarse, mesh, samples=5_000) < 0.05


@pytest.mark.parametrize("collapse", COLLAPSES)
def test_a_binding_budget_is_never_exceeded(collapse: Collapse) -> None:
    mesh = perforated()
    all_that_openings_leave = len(simplify(mesh, 800, collapse=collapse).faces)
    budget = max(1_000, int(all_that_openings_leave / 1.3))
    assert len(simplify(mesh, budget, binding=True, collapse=collapse).faces) <= budget


def test_levels_for_a_device_keep_within_its_budgets() -> None:
    budgets = (6_000, 3_000, 1_100)
    levels = lods(perforated(), budgets, binding=True)
    assert all(len(level.faces) <= most for level, most in zip(levels, budgets, strict=True))


def test_a_fold_pressed_flat_goes_and_a_flat_piece_stays() -> None:
    tent = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]
    fin = [[0, 1, 9], [1, 0, 9]]
    alone = [[4, 5, 6], [5, 4, 6]]
    kept = without_fins(np.array(tent + fin + alone))
    assert kept.tolist() == tent + alone
