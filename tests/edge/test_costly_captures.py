"""What costs a reader much is refused before, or costs no more than its size: files of a few megabytes took minutes."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.recordings.tum import MAX_APART_S, nearest
from tests.support import costly

_MORE = 6  # times as many repetitions, in which a cost that grows with their square grows 36-fold
_AT_MOST = 2.0 * _MORE
_LEAST_S = 0.01  # of processor time; below it what costs the same for all files is most of it
_TRIES = 2


def written(folder: Path, files: costly.Files) -> Path:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def seconds(folder: Path) -> float:
    """Processor time in which a capture is read, or refused."""

    def read() -> None:
        with suppress(CaptureError):
            read_capture(folder)

    return least_seconds(read)


def least_seconds(work: Callable[[], object]) -> float:
    found = []
    for _ in range(_TRIES):
        began = time.process_time()
        work()
        found.append(time.process_time() - began)
    return min(found)


@pytest.mark.parametrize("kind", costly.REFUSED)
def test_too_many_parts_are_refused_by_their_count(kind: str, tmp_path: Path) -> None:
    make, file = costly.REFUSED[kind]
    folder = written(tmp_path, make())
    with pytest.raises(CaptureError) as refused:
        read_capture(folder)
    assert (refused.value.code, refused.value.file) == ("CAPTURE_TOO_LARGE", file), refused.value
    assert refused.value.hints


@pytest.mark.parametrize("kind", costly.LINEAR)
def test_a_larger_file_costs_as_much_more_as_it_is_larger(kind: str, tmp_path: Path) -> None:
    make, count = costly.LINEAR[kind]
    few = seconds(written(tmp_path / "few", make(count)))
    many = seconds(written(tmp_path / "many", make(_MORE * count)))
    assert many < _AT_MOST * max(few, _LEAST_S), f"{few:.3f} s and {many:.3f} s"


_TIMES = st.lists(st.sampled_from([0.0, 0.004, 0.01, 0.5, 0.515, 9.0, float("nan")]), max_size=8)


@given(stamps=_TIMES, wanted=_TIMES)
def test_the_nearest_time_is_that_of_a_look_at_all(stamps: list[float], wanted: list[float]) -> None:
    found = nearest(np.array(stamps), np.array(wanted))
    for time_s, place in zip(wanted, found, strict=True):
        apart = [abs(stamp - time_s) for stamp in stamps if abs(stamp - time_s) <= MAX_APART_S]
        assert (place is None) == (not apart)
        assert place is None or abs(stamps[place] - time_s) == min(apart)


def test_many_times_cost_as_much_more_as_they_are_more() -> None:
    few, many = (np.arange(count, dtype=float) for count in (20_000, _MORE * 20_000))
    few_s, many_s = least_seconds(lambda: nearest(few, few)), least_seconds(lambda: nearest(many, many))
    assert many_s < _AT_MOST * max(few_s, _LEAST_S), f"{few_s:.3f} s and {many_s:.3f} s"
