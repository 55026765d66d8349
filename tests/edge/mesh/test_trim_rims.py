"""Rims that lie outside of the thing are cut off along a smooth line; what is surrounded by surface stays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from capture2vr.edge.mesh.edges import border_edges
from capture2vr.edge.mesh.normals import face_normals
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.topology import pieces_of
from capture2vr.edge.mesh.trim_rims import trim_rims
from tests.support import surfaces

SHEET = surfaces.patch(lambda u, v: [u, v, 0.1 * u * v], 60, 60)  # from −0.5 to 0.5, each side 1


def area(mesh: Mesh) -> float:
    return float(np.linalg.norm(face_normals(mesh.vertices, mesh.faces), axis=1).sum() / 2)


def test_a_rim_is_cut_off_where_it_begins() -> None:
    cut = trim_rims(SHEET, SHEET.vertices[:, 0] > 0.4)
    assert cut.vertices[:, 0].max() == pytest.approx(0.4, abs=0.02)
    assert area(cut) == pytest.approx(0.9 * area(SHEET), rel=0.02)


def test_what_is_surrounded_by_surface_stays() -> None:
    middle = np.linalg.norm(SHEET.vertices[:, :2], axis=1) < 0.2
    cut = trim_rims(SHEET, middle)
    assert area(cut) == pytest.approx(area(SHEET), rel=1e-6)


def test_crumbs_that_a_cut_leaves_go_too() -> None:
    x, y = SHEET.vertices[:, 0], SHEET.vertices[:, 1]
    crumb = (x > 0.47) & (np.abs(y) < 0.02)  # on the far side of the rim, 1/1600 of the sheet
    cut = trim_rims(SHEET, (x > 0.4) & ~crumb)
    assert cut.vertices[:, 0].max() < 0.45
    assert len(np.unique(pieces_of(cut.faces))) == 1


def test_a_part_that_a_cut_separates_stays() -> None:
    x = SHEET.vertices[:, 0]
    cut = trim_rims(SHEET, (x > 0.2) & (x < 0.3))
    assert len(np.unique(pieces_of(cut.faces))) == 2
    assert area(cut) == pytest.approx(0.9 * area(SHEET), rel=0.05)


def test_nothing_outside_changes_nothing() -> None:
    assert trim_rims(SHEET, np.zeros(len(SHEET.vertices), bool)) is SHEET


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.floats(0.01, 0.6))
def test_what_is_left_is_manifold_and_was_there(seed: int, share: float) -> None:
    """Also where the rims are ragged: each border vertex keeps two border edges, which the filling of holes needs."""
    outside = np.random.default_rng(seed).random(len(SHEET.vertices)) < share
    cut = trim_rims(SHEET, outside)
    assert area(cut) <= area(SHEET) * (1 + 1e-9)
    ends = border_edges(cut.faces).ravel()
    assert (np.bincount(ends)[np.unique(ends)] == 2).all()
    away, _ = cKDTree(SHEET.vertices).query(cut.vertices)
    assert away.max() < 1 / 60
