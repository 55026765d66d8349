"""Choose the ids of a collection's rows in its search index: by key, with room for what comes later."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

_SPREAD = 16  # ids a row has where there is room: a shard can split four times before its neighbours move
_LEAST_SPREAD = 2  # less room is none: the next shard here would have to move its neighbours


def places_between(counts: Sequence[int], low: int, high: int | None) -> list[int] | None:
    """Return where shards of these numbers of rows start, from `low` on and all before `high`, evenly spread.

    high  None: there is nothing behind
    Returns None where there is too little room.
    """
    rows = sum(counts)
    room = rows * _SPREAD if high is None else high - low
    if room < rows * _LEAST_SPREAD:
        return None
    return [low + before * room // rows for before in accumulate(counts[:-1], initial=0)]
