"""Find rows in a search index: the same, in the same order, that a filter accepts of all rows of the collection.

SQLite proposes rows in the order of their keys, until a page is full; `RowFilter.accepts` has the last word on each.
"""

from __future__ import annotations

import heapq
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from itertools import groupby, islice
from operator import itemgetter, or_
from typing import Any

from capture2vr.gateway.search.index_file import (
    PAD,
    ROW_COLUMNS,
    has_trigrams,
    leaf_before,
    row_of_cells,
    searchable,
    state_bit,
)
from capture2vr.gateway.search.listing import Search
from capture2vr.storage.catalogue.collection import REMOVED, Row
from capture2vr.storage.catalogue.row_filter import RowFilter

_GRAM = 3
_MOST_GRAMS = 16  # of a long text, evenly spread: more would find hardly fewer rows
_MOST_TERMS = 12  # trigrams that begin with the one or two letters that are looked for; of more it is a frequent part
_FEW_ROWS = 20_000  # read in 10 ms, so that shards whose extremes fit need no other index
_MOST_INTEGER = (1 << 63) - 1
_LAST = "\U0010ffff" * 2  # behind any two letters
_LISTED = ("preview", "refined", "")  # "": any other that is not removed

_Proposal = tuple[int, Row]
"""Place and row."""


@dataclass(frozen=True, slots=True)
class _Condition:
    """A condition of SQL, and the values of its question marks."""

    sql: str
    values: tuple[Any, ...] = ()

    def __and__(self, other: _Condition) -> _Condition:
        return _Condition(f"{self.sql} AND {other.sql}", self.values + other.values)


def find_rows(connection: sqlite3.Connection, search: Search) -> list[Row]:
    """Return a page of rows. Raises sqlite3.Error."""
    leaf, place = _position(connection, search.after)
    proposals = _proposals(connection, search.wanted, leaf, place)
    rows = (next(same)[1] for _, same in groupby(proposals, key=itemgetter(0)))  # one may have both label and tag
    return list(islice(filter(search.wanted.accepts, rows), search.limit))


def _position(connection: sqlite3.Connection, after: str) -> tuple[int, int]:
    """Return where the shard begins in which `after` is or would be, and the place of the last row up to it."""
    leaf = leaf_before(connection, after)
    if leaf is None:
        return 0, -1
    select = "SELECT max(id) FROM rows WHERE id >= ? AND id < ? AND key <= ?"
    (place,) = connection.execute(select, (leaf.start, leaf.end, after)).fetchone()
    return leaf.start, leaf.start - 1 if place is None else place


def _proposals(connection: sqlite3.Connection, wanted: RowFilter, leaf: int, place: int) -> Iterator[_Proposal]:
    """Yield rows behind a place, among them all that are wanted, in the order of their places."""
    label, facts = searchable(wanted.label), _facts(wanted)
    extremes = _Condition("l.start >= ?", (leaf,)) & _extremes(wanted)
    if _are_few(connection, extremes):
        tables = "leaves l CROSS JOIN rows r ON r.id >= l.start AND r.id < l.start + l.count"
        behind = _Condition("+r.id > ?", (place,))  # "+": SQLite would begin here for every shard
        return _select(connection, tables, extremes & behind & facts & _has_label(label), "l.start, r.id")
    grams = _grams_query(connection, label)
    if grams is None:
        behind = _Condition("r.id > ?", (place,))
        return _select(connection, "rows r", behind & facts & _has_label(label), "r.id")
    return heapq.merge(
        _with_part(connection, grams, place, facts & _Condition("instr(r.text, ?) > 0", (label,))),
        _with_tag(connection, label, place, facts),
        key=itemgetter(0),
    )


def _with_part(connection: sqlite3.Connection, grams: str, place: int, facts: _Condition) -> Iterator[_Proposal]:
    """Yield the rows whose labels have these trigrams, as far as a condition holds."""
    tables = "grams CROSS JOIN rows r ON r.id = grams.rowid"
    behind = _Condition("grams MATCH ? AND grams.rowid > ?", (grams, place))
    return _select(connection, tables, behind & facts, "grams.rowid")


def _with_tag(connection: sqlite3.Connection, tag: str, place: int, facts: _Condition) -> Iterator[_Proposal]:
    """Yield the rows that have a tag, as far as a condition holds."""
    behind = _Condition("t.tag = ? AND t.id > ?", (tag, place))
    return _select(connection, "tags t CROSS JOIN rows r ON r.id = t.id", behind & facts, "t.id")


def _select(connection: sqlite3.Connection, tables: str, condition: _Condition, order: str) -> Iterator[_Proposal]:
    """Yield rows, read one by one as they are asked for. `CROSS JOIN` keeps the order of the tables."""
    select = f"SELECT r.id, {ROW_COLUMNS} FROM {tables} WHERE {condition.sql} ORDER BY {order}"  # noqa: S608 - ours
    for place, *cells in connection.execute(select, condition.values):
        yield place, row_of_cells(cells)


def _are_few(connection: sqlite3.Connection, extremes: _Condition) -> bool:
    """Return whether the shards that may have wanted rows, going by their extremes, have few rows in all."""
    select = f"SELECT l.count FROM leaves l WHERE {extremes.sql}"  # noqa: S608 - ours, values apart
    rows = 0
    for (count,) in connection.execute(select, extremes.values):
        rows += count
        if rows > _FEW_ROWS:
            return False
    return True


def _facts(wanted: RowFilter) -> _Condition:
    """Return the condition on state, date and size of a row `r`."""
    condition = _Condition("r.state = ?", (wanted.state,)) if wanted.state else _Condition("r.state <> ?", (REMOVED,))
    if wanted.since:
        condition &= _Condition("r.updated >= ?", (int(wanted.since.timestamp()),))
    if wanted.until:
        condition &= _Condition("r.updated <= ?", (wanted.until.timestamp(),))
    if wanted.min_bytes is not None or wanted.max_bytes is not None:
        condition &= _Condition("r.bytes BETWEEN ? AND ?", _size_bounds(wanted))
    return condition


def _extremes(wanted: RowFilter) -> _Condition:
    """Return the condition on a shard `l` without which none of its rows has the wanted state, date and size."""
    states = (wanted.state,) if wanted.state else _LISTED
    condition = _Condition("l.states & ?", (reduce(or_, map(state_bit, states)),))
    if wanted.since:
        condition &= _Condition("l.newest >= ?", (int(wanted.since.timestamp()),))
    if wanted.until:
        condition &= _Condition("l.oldest <= ?", (wanted.until.timestamp(),))
    if wanted.min_bytes is not None or wanted.max_bytes is not None:
        condition &= _Condition("l.largest >= ? AND l.smallest <= ?", _size_bounds(wanted))
    return condition


def _size_bounds(wanted: RowFilter) -> tuple[int, int]:
    """Return the least and the greatest size, as SQLite's integers; an unknown size, 0, is not within them."""
    least = max(1, wanted.min_bytes or 0)
    most = _MOST_INTEGER if wanted.max_bytes is None else wanted.max_bytes
    return min(least, _MOST_INTEGER), min(most, _MOST_INTEGER)


def _has_label(label: str) -> _Condition:
    """Return the condition that a label is part of a row's text, or is one of its tags."""
    if not label:
        return _Condition("TRUE")
    tagged = "EXISTS(SELECT 1 FROM tags t WHERE t.tag = ? AND t.id = r.id)"
    return _Condition(f"(instr(r.text, ?) > 0 OR {tagged})", (label, label))


def _grams_query(connection: sqlite3.Connection, label: str) -> str | None:
    """Return the query for the trigrams of a label; None where reading the rows in their order finds it sooner."""
    if not label or not has_trigrams():
        return None
    if len(label) >= _GRAM:
        grams = sorted({label[at : at + _GRAM] for at in range(len(label) - _GRAM + 1)})
        return " AND ".join(map(_quoted, grams[:: -(-len(grams) // _MOST_GRAMS)]))
    select = "SELECT term FROM vocabulary WHERE term BETWEEN ? AND ? LIMIT ?"
    terms = [term for (term,) in connection.execute(select, (label, f"{label}{_LAST}", _MOST_TERMS + 1))]
    if len(terms) > _MOST_TERMS:
        return None
    return " OR ".join(map(_quoted, terms or [f"{label}{PAD}"[:_GRAM]]))


def _quoted(gram: str) -> str:
    return '"' + gram.replace('"', '""') + '"'
