"""A word across the foot of a picture."""

from __future__ import annotations

import numpy as np
import pytest

from capture2vr.edge.arrays import Bools
from capture2vr.edge.render.watermark import watermark


@pytest.mark.parametrize("side", [192, 256, 512, 1024])
@pytest.mark.parametrize("channels", [3, 4])
def test_the_word_stands_in_the_middle_of_the_foot_and_can_be_read(side: int, channels: int) -> None:
    picture = np.full((side, side, channels), 100, np.uint8)
    picture[..., 3:] = 0
    before = picture.copy()
    marked = watermark(picture, "generated")
    changed: Bools = (marked != before).any(axis=2)
    rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
    assert rows[-1] == side - 1
    assert 0.05 < len(rows) / side < 0.2
    assert 0.2 < len(columns) / side < 0.8
    assert abs(columns[0] + columns[-1] - side) <= 0.02 * side
    band = marked[rows[0] :, columns[0] : columns[-1] + 1]
    assert (band[..., 3:] == 255).all()
    assert 0.08 < (band[..., 0] > 150).mean() < 0.5, "letters on a dark band"


def test_without_a_word_a_picture_stays() -> None:
    picture = np.full((8, 8, 4), 7, np.uint8)
    assert watermark(picture, "") is picture
