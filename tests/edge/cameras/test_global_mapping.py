"""Photos with few matches, which the incremental mapper leaves out and the global one places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from capture2vr.edge.cameras.features import FINE, find_features
from capture2vr.edge.cameras.match_pairs import exhaustive
from capture2vr.edge.cameras.sfm_process import Lens, SfmProblem, solve
from capture2vr.edge.read_capture import read_capture
from tests.edge.cameras.test_structure_from_motion import centre_errors
from tests.support.photos.walkaround import Walkaround, render_walkaround

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Walkaround:
    """Forty degrees between photos, and a third of the usual contrast."""
    return render_walkaround(tmp_path_factory.mktemp("walk"), views=7, arc=240.0, contrast=0.3)


@pytest.fixture(scope="module")
def problem(walk: Walkaround) -> SfmProblem:
    photos = read_capture(walk.photos[0].parent).photos
    lens = Lens(walk.intrinsics, known=True)
    return SfmProblem((lens,), np.zeros(7, np.int64), tuple(find_features(photos, FINE)), exhaustive(7), 1.0)


def test_the_global_mapper_places_photos_that_the_incremental_one_leaves_out(
    walk: Walkaround, problem: SfmProblem
) -> None:
    alone, both = solve(problem), solve(replace(problem, thorough=True))
    assert len(alone.placed) < len(both.placed)
    truth = walk.camera_to_world[both.placed, :3, 3]
    assert centre_errors(both.poses[:, :3, 3], truth).max() < 0.01
    seen = np.bincount(both.seen_view, minlength=len(both.placed))
    assert seen.min() >= 10


def test_photos_of_different_things_are_not_placed_by_force(problem: SfmProblem) -> None:
    """Each photo's key points are shuffled: descriptors match as before, but no geometry holds."""
    random = np.random.default_rng(0)
    shuffled = tuple(replace(each, xy=random.permutation(each.xy)) for each in problem.features)
    answer = solve(replace(problem, features=shuffled, thorough=True))
    assert len(answer.placed) == 0
