"""The certificate: known figures of closed-form surfaces, and a verdict that no worse surface passes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from capture2vr.edge.arrays import Floats
from capture2vr.edge.certificate import (
    HELD_OUT,
    Certificate,
    Evidence,
    certify,
    compare,
    consistency,
    distance_to_mesh,
    hold_out,
)
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.render.photo_comparison import PhotoFigures
from tests.support.surfaces import disk, hemisphere, moved, patch, sampled


def flat_field(queries: Floats) -> tuple[Floats, Floats]:
    """|z|: the field of a plane."""
    z = queries[:, 2]
    return np.abs(z), np.sign(z)[:, None] * np.array([0.0, 0.0, 1.0])


def sheet(cells: int = 60, z: float = 0.0) -> Mesh:
    """A unit square at height z."""
    return moved(patch(lambda u, v: [u, v, 0 * u], cells, cells), (0, 0, z))


@pytest.fixture(scope="module")
def evidence() -> Evidence:
    """10,000 points of a flat square, those that the field sees and those it does not."""
    xyz = sampled(sheet(), 10_000)
    held = hold_out(len(xyz)) == 1
    return Evidence.of(xyz[~held], xyz[held])


@pytest.fixture(scope="module")
def flat(evidence: Evidence) -> Certificate:
    return certify(flat_field, sheet(), evidence)


@pytest.mark.parametrize(("points", "held"), [(100, 0), (499, 0), (500, 20), (10_000, 200), (1_000_000, 2_000)])
def test_two_percent_are_held_out_within_bounds(points: int, held: int) -> None:
    first, both = hold_out(points), hold_out(points, sets=2)
    assert (first == 1).sum() == (both == 1).sum() == (both == 2).sum() == held
    assert held == 0 or HELD_OUT[0] <= held <= HELD_OUT[1]
    assert ((both == 1) == (first == 1)).all(), "the points that judge do not depend on who else wants some"


def test_the_distance_to_triangles_is_exact_over_faces_edges_and_corners() -> None:
    triangle = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    xyz = np.array([[0.2, 0.2, 0.3], [0.5, -2, 0], [-3, -4, 0], [1, 1, 0], [0.2, 0.2, 0]])
    assert distance_to_mesh(xyz, triangle) == pytest.approx([0.3, 2, 5, np.sqrt(0.5), 0])


def test_a_triangle_without_area_is_a_line() -> None:
    needle = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2]]))
    assert distance_to_mesh(np.array([[1.5, 1.0, 0], [3, 0, 0]]), needle) == pytest.approx([1, 1])


def test_the_distance_to_a_sphere_is_that_of_the_formula() -> None:
    xyz = np.random.default_rng(0).normal(size=(500, 3))
    xyz *= np.linspace(0.45, 0.55, 500)[:, None] / np.linalg.norm(xyz, axis=1, keepdims=True)
    above = xyz[xyz[:, 2] > 0.05]
    bowl = hemisphere()
    scale = np.linalg.norm(bowl.vertices - bowl.vertices.mean(0), axis=1)
    assert scale.max() < 1
    centre = np.array([0, 0, bowl.vertices[:, 2].min()])
    expected = np.abs(np.linalg.norm(above, axis=1) - 0.5)
    assert distance_to_mesh(above + centre, bowl) == pytest.approx(expected, abs=2e-4)


def test_a_perfect_surface_has_perfect_figures(flat: Certificate) -> None:
    assert flat.held_out == 200
    assert flat.held_out_mean < 1e-12
    assert flat.held_out_p95 < 1e-12
    assert flat.coverage == 1
    assert flat.consistency < 1e-9
    assert flat.stray_area < 0.001
    assert flat.boundary_length == pytest.approx(4)
    assert flat.area == pytest.approx(1)
    assert (flat.components, flat.boundary_loops, flat.non_manifold_edges) == (1, 1, 0)


def test_a_shifted_surface_is_as_far_as_it_was_shifted(evidence: Evidence) -> None:
    shifted = certify(flat_field, sheet(z=0.004), evidence)
    assert shifted.held_out_mean == pytest.approx(0.004)
    assert shifted.points_to_mesh_median == pytest.approx(0.004)
    assert shifted.coverage == 1, "within a spacing of .01 still"


def test_half_a_surface_covers_half(evidence: Evidence) -> None:
    whole = sheet()
    half = Mesh(whole.vertices, whole.faces[(whole.vertices[whole.faces, 0] < 0).all(axis=1)])
    assert certify(flat_field, half, evidence).coverage == pytest.approx(0.5, abs=0.1)


def test_a_phantom_sheet_is_stray(evidence: Evidence, flat: Certificate) -> None:
    phantom = certify(flat_field, two_sheets_of(0.2), evidence)
    assert phantom.stray_area == pytest.approx(0.5, abs=0.03)
    assert phantom.held_out_mean < 1e-12, "which distances from the points cannot see"
    assert compare(flat, phantom).outcome == "worse"


def two_sheets_of(apart: float) -> Mesh:
    """The square, and another above it."""
    lower, upper = sheet(), sheet(z=apart)
    return Mesh(np.concatenate([lower.vertices, upper.vertices]), np.concatenate([lower.faces, upper.faces + 61 * 61]))


def test_a_gradient_that_turns_on_its_way_is_inconsistent() -> None:
    queries = np.random.default_rng(0).normal(size=(1000, 3))

    def askew(at: Floats) -> tuple[Floats, Floats]:
        f, gradient = flat_field(at)
        gradient = gradient.copy()
        gradient[np.abs(at[:, 2]) < 1e-9] = [1.0, 0, 0]
        return f, gradient

    assert consistency(flat_field, queries) == pytest.approx(0, abs=1e-9)
    assert consistency(askew, queries) == pytest.approx(1)
    assert consistency(lambda at: (np.zeros(len(at)), np.zeros((len(at), 3))), queries) == 1


def test_a_surface_is_as_good_as_itself(flat: Certificate) -> None:
    assert compare(flat, flat).outcome == "even"


def test_the_nearer_surface_is_better_and_the_farther_worse(evidence: Evidence) -> None:
    near, far = (certify(flat_field, sheet(z=z), evidence) for z in (0.002, 0.004))
    assert compare(far, near).outcome == "better"
    verdict = compare(near, far)
    assert verdict.outcome == "worse"
    assert "0.00400, was 0.00200" in verdict.because


def test_what_noise_adds_to_both_drops_out() -> None:
    """σ = .006 hides a shift of .0005 from either mean, but not from their paired difference."""
    xyz = sampled(sheet(), 50_000, noise=0.006)
    held = hold_out(len(xyz)) == 1
    evidence = Evidence.of(xyz[~held], xyz[held])
    good, off = (certify(flat_field, sheet(z=z), evidence) for z in (0.0, 0.003))
    assert good.held_out_mean == pytest.approx(0.006 * np.sqrt(2 / np.pi), rel=0.1)
    assert compare(good, off).outcome == "worse"
    assert compare(off, good).outcome == "better"


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"coverage": 0.9}, "covers"),
        ({"stray_area": 0.1}, "no points"),
        ({"non_manifold_edges": 1000}, "non-manifold"),
        ({"components": 20}, "separate pieces"),
    ],
)
def test_any_fault_makes_it_worse(flat: Certificate, change: dict[str, float], word: str) -> None:
    verdict = compare(flat, replace(flat, distances=flat.distances - 0.001, **change))
    assert verdict.outcome == "worse"
    assert word in verdict.because


FAULTLESS = PhotoFigures(photos=2, cover=1.0, lace=0.0, inside_out=0.0, leak=0.0)


@pytest.mark.parametrize("change", [{"lace": 0.05}, {"cover": 0.95}, {"inside_out": 0.05}])
def test_more_holes_in_held_out_photos_make_it_worse(flat: Certificate, change: dict[str, float]) -> None:
    """However near to the points it is: holes are where neither mesh nor points are."""
    preview = replace(flat, photos=FAULTLESS)
    refined = replace(flat, distances=flat.distances - 0.001, photos=replace(FAULTLESS, **change))
    verdict = compare(preview, refined)
    assert verdict.outcome == "worse"
    assert "shows more holes in held-out photos" in verdict.because
    assert compare(refined, replace(preview, distances=refined.distances)).outcome != "worse"


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (FAULTLESS, replace(FAULTLESS, lace=0.005, cover=0.995)),  # too little to see
        (replace(FAULTLESS, lace=0.1, cover=0.9), replace(FAULTLESS, lace=0.1, cover=0.9)),
        (FAULTLESS, replace(FAULTLESS, leak=0.2, psnr=12.0)),  # no holes
        (None, None),
    ],
)
def test_no_more_holes_than_before_do_not(
    flat: Certificate, before: PhotoFigures | None, after: PhotoFigures | None
) -> None:
    nearer = replace(flat, distances=flat.distances - 0.001, photos=after)
    assert compare(replace(flat, photos=before), nearer).outcome == "better"


def test_a_certificate_has_its_photos_figures_as_json(evidence: Evidence, flat: Certificate) -> None:
    certificate = replace(certify(flat_field, sheet(), evidence), photos=FAULTLESS)
    assert certificate.as_json()["photos"]["cover"] == 1
    assert flat.as_json()["photos"] is None


def test_a_cloud_without_points_to_spare_is_judged_by_those_it_has() -> None:
    xyz = sampled(disk(), 200)
    certificate = certify(flat_field, disk(), Evidence.of(xyz, xyz[:0]))
    assert certificate.held_out == 0
    assert certificate.held_out_mean < 1e-9
    assert "input points" in compare(certificate, certificate).because
