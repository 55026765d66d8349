"""A garment in one photo: where it is open, and the two sheets that its relief is."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture2vr.edge.arrays import Bools, Floats, no_tick
from capture2vr.edge.capture.nouns import Capture
from capture2vr.edge.single_photo.garment import open_ends
from capture2vr.edge.single_photo.outline_kind import inflation_of
from capture2vr.edge.single_photo.relief import make_relief
from capture2vr.edge.single_photo.to_points import to_points
from tests.edge.single_photo.test_relief import patterned
from tests.support.photos.single_photos import photo

SIDE, REACH = 186, 14.0
# Of the right half, from the neck to the hem, as shares of the garment's height from its middle and top.
SHORT = [(0.17, 0), (0.41, 0.17), (0.52, 0.46), (0.38, 0.51), (0.25, 0.29), (0.25, 1)]
LONG = [(0.17, 0), (0.38, 0.1), (0.58, 0.68), (0.46, 0.72), (0.26, 0.3), (0.28, 1)]
WIDE = [(0.17, 0), (0.55, 0.1), (0.55, 0.33), (0.24, 0.3), (0.24, 1)]
CUTS = {"short": SHORT, "long": LONG, "wide": WIDE}


def corners(cut: str, dip: float) -> Floats:
    """Corners (N,2) of a garment's outline in pixels, from the left of its neck on clockwise; dip: of its neckline."""
    right = np.array(CUTS[cut])
    left = right[::-1] * [-1, 1]
    return np.concatenate([left, [[0, dip]], right]) * 138 + [SIDE / 2, 24]


def drawn(line: Floats) -> Bools:
    mask = np.zeros((SIDE, SIDE), np.uint8)
    cv2.fillPoly(mask, [np.round(line * 16).astype(np.int32)], 1, cv2.LINE_8, 4)
    return mask > 0


def edges(cut: str, line: Floats) -> tuple[list[tuple[Floats, Floats]], list[tuple[Floats, Floats]]]:
    """The edges of an outline that are openings, hem and neck and sleeves, and the others."""
    opening = {len(CUTS[cut]) - 1, len(CUTS[cut]), 2, len(line) - 4, len(line) - 1}
    pairs = [(line[number], line[(number + 1) % len(line)]) for number in range(len(line))]
    return [pairs[number] for number in opening], [pair for n, pair in enumerate(pairs) if n not in opening]


@settings(deadline=None, max_examples=30)
@given(st.sampled_from(sorted(CUTS)), st.floats(0.03, 0.12), st.floats(-4, 4))
def test_a_shirt_is_open_at_neck_sleeves_and_hem_and_nowhere_else(cut: str, dip: float, degrees: float) -> None:
    line = corners(cut, dip)
    turn = cv2.getRotationMatrix2D((SIDE / 2, SIDE / 2), degrees, 1.0)
    line = np.asarray(line @ turn[:, :2].T + turn[:, 2], float)
    strips = open_ends(drawn(line), REACH)

    openings, seams = edges(cut, line)
    assert not (strips & drawn(line)).any()
    for sides, opens in ((openings, True), (seams, False)):
        for start, end in sides:
            outward = np.array([end[1] - start[1], start[0] - end[0]]) / np.linalg.norm(end - start)
            x, y = np.round((start + end) / 2 + 5 * outward).astype(int)
            assert strips[y, x] == opens, (start, end)


@pytest.mark.slow
def test_the_relief_of_a_shirt_is_two_sheets_with_openings() -> None:
    mask = drawn(corners("short", 0.07))
    assert inflation_of(mask)[0] == "garment"
    large = cv2.resize(mask.astype(np.uint8), (558, 558), interpolation=cv2.INTER_NEAREST) > 0
    picture = photo(patterned(large))

    relief = make_relief(picture, tick=no_tick)

    assert not relief.closed
    low = relief.xyz[:, 1] < relief.xyz[:, 1].min() + 0.02
    inner = np.abs(relief.xyz[:, 0]) < 0.15
    hem, seam = relief.xyz[low & inner], relief.xyz[np.abs(relief.xyz[:, 1] + 0.2) < 0.05]
    assert np.abs(hem[:, 2]).min() > 0.03  # nothing closes it between the sheets
    assert (hem[:, 2] > 0).any()
    assert (hem[:, 2] < 0).any()
    assert np.abs(seam[:, 2]).min() < 0.01  # a side seam does
    assert not to_points(Capture("image", "photo", photos=(picture,))).closed
