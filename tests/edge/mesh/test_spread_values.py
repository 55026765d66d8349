"""Values spread over a mesh: known ones stay, each unknown one is the mean of its neighbours."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.mesh.edges import edges_of, spread_values
from tests.support import surfaces

MESH = surfaces.patch(lambda u, v: [u, v, 0 * u], 9, 9)
ENDS = edges_of(MESH.faces).ends
COUNT = len(MESH.vertices)


@given(st.sets(st.integers(0, COUNT - 1), max_size=COUNT - 1), st.integers(0, 99))
def test_unknown_values_are_the_mean_of_their_neighbours(chosen: set[int], seed: int) -> None:
    unknown = np.isin(np.arange(COUNT), list(chosen))
    values = np.random.default_rng(seed).uniform(0, 1, (COUNT, 3))
    spread = spread_values(values, ENDS, unknown)
    assert np.array_equal(spread[~unknown], values[~unknown])
    for vertex in chosen:
        around = np.append(ENDS[ENDS[:, 0] == vertex, 1], ENDS[ENDS[:, 1] == vertex, 0])
        assert spread[vertex] == pytest.approx(spread[around].mean(axis=0), abs=1e-3)


def test_what_no_known_value_is_connected_to_stays_as_it_was() -> None:
    values = np.full((COUNT, 3), 0.4)
    assert spread_values(values, ENDS, np.ones(COUNT, bool)) == pytest.approx(values)
