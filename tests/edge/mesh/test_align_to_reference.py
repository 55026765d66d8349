"""A surface laid over a known one: whatever its frame and size, and however much of it is missing."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from capture2vr.edge.mesh.align_to_reference import overlay
from capture2vr.edge.mesh.nouns import Mesh
from tests.support import surfaces

pytestmark = pytest.mark.slow


def moved(mesh: Mesh, seed: int) -> Mesh:
    """The mesh turned, scaled by 1/30 to 30, and elsewhere."""
    rng = np.random.default_rng(seed)
    turn, scale = Rotation.random(rng=rng).as_matrix(), np.exp(rng.uniform(-3.4, 3.4))
    return Mesh(scale * mesh.vertices @ turn.T + 10 * rng.normal(size=3), mesh.faces)


@pytest.mark.parametrize("seed", [0, 1])
def test_size_and_place_are_not_judged(seed: int) -> None:
    chair = surfaces.chair()
    found = overlay(moved(chair, seed), chair)
    assert found.median < 1e-3
    assert found.p90 < 5e-3
    assert found.complete > 0.99
    assert found.beside == 0


def test_what_is_missing_is_told_and_pulls_no_harder() -> None:
    chair = surfaces.chair()
    middle = chair.vertices[chair.faces].mean(axis=1)
    part = Mesh(chair.vertices, chair.faces[middle[:, 0] < np.quantile(middle[:, 0], 0.75)])
    found = overlay(moved(part, 3), chair)
    assert found.median < 2e-3
    assert 0.5 < found.complete < 0.95


def test_the_error_is_the_error() -> None:
    """A surface with bumps of 0.01 of its size, either way."""
    sheet = surfaces.bumpy_sheet()
    rough = sheet.vertices + 0.01 * np.random.default_rng(0).choice([-1, 1], (len(sheet.vertices), 1)) * [0, 0, 1]
    found = overlay(moved(Mesh(rough, sheet.faces), 1), sheet)
    assert 0.002 < found.median < 0.01


def test_another_thing_is_far() -> None:
    assert overlay(surfaces.pleated_skirt(), surfaces.chair()).complete < 0.6


@pytest.mark.parametrize("flat", [surfaces.smooth_sheet, surfaces.cylinder])
def test_what_looks_the_same_from_many_sides_is_laid_over_some_way(flat: object) -> None:
    surface = flat()  # type: ignore[operator]
    assert overlay(moved(surface, 2), surface).complete > 0.95
