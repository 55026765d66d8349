"""The list of pieces accounts for every piece, however many there are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.field.local import local_field
from capture2vr.edge.mesh.clean import clean
from capture2vr.edge.mesh.extract import extract
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.mesh.pieces import MOST_LISTED, SplitMesh, list_pieces
from capture2vr.edge.mesh.sampling import area
from tests.support import surfaces

FATES = st.tuples(st.floats(1e-6, 1.0), st.booleans(), st.sampled_from(["alone", "many"]))


@given(st.lists(FATES, min_size=1, max_size=60))
def test_shares_and_counts_add_up_and_each_fate_keeps_its_area(fates: list[tuple[float, bool, str]]) -> None:
    areas, kept, reasons = (list(column) for column in zip(*fates, strict=True))
    pieces = list_pieces(areas, kept, reasons)
    assert sum(piece.share for piece in pieces) == pytest.approx(1)
    assert sum(piece.count for piece in pieces) == len(fates)
    assert len(pieces) <= MOST_LISTED + 4
    for fate in {(k, r) for _, k, r in fates}:
        told = sum(piece.share for piece in pieces if (piece.kept, piece.reason) == fate)
        assert told == pytest.approx(sum(a for a, k, r in fates if (k, r) == fate) / sum(areas))
    alone = [piece.share for piece in pieces[:MOST_LISTED]]
    assert alone == sorted(alone, reverse=True)


def test_the_areas_of_a_meshs_pieces_are_found() -> None:
    small, large = surfaces.disk(), surfaces.sphere()
    both = Mesh(
        np.concatenate([small.vertices + 5, large.vertices]),
        np.concatenate([small.faces, large.faces + len(small.vertices)]),
    )
    split = SplitMesh.of(both)
    assert sorted(split.areas.tolist()) == pytest.approx(sorted([area(small), area(large)]))
    assert split.areas[split.piece[0]] == pytest.approx(area(small))


def test_cleaning_tells_the_areas_of_the_specks_that_it_drops() -> None:
    """Ten points in a row far from a sheet of 2,000 are noise; the sheet itself is no speck."""
    rng = np.random.default_rng(0)
    sheet = np.column_stack([rng.uniform(-0.5, 0.5, (2_000, 2)), np.zeros(2_000)])
    beside = np.column_stack([rng.uniform(-0.02, 0.02, (10, 2)), np.full(10, 0.4)])
    near = np.concatenate([sheet, beside])
    specks: list[float] = []
    mesh = clean(extract(local_field(near), near, resolution=64), near, specks=specks)
    assert len(SplitMesh.of(mesh).areas) == 1
    assert specks
    assert 0 < sum(specks) < 0.05
    again: list[float] = []
    clean(mesh, sheet, specks=again)
    assert again == []
