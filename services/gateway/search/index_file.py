"""SQLite file that has the rows of a collection: by place, by the trigrams of their labels, and by tag.

A row's id is its place: ids grow with keys, so that whatever finds ids finds them in the order of the pages, and a page
begins behind one id. Each shard's rows have ids in a row, with gaps between shards for those that come later.
"""

from __future__ import annotations

import json
import sqlite3
import unicodedata
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cache, reduce
from operator import or_
from pathlib import Path
from typing import Any

from capture2vr.storage.catalogue.collection import REMOVED, Row

_SCHEMA = 1  # of the tables; a file of another one is made anew
_BUSY_S = 10.0
_WRITER_CACHE_KIB = 32 << 10
_MERGE_BYTES = 16 << 20  # of trigrams that are sorted in memory before they are written
PAD = "\x01\x01"
"""Behind each label in the index of trigrams: then every letter of it, and every two, begin a trigram."""
_to_json = json.JSONEncoder(separators=(",", ":")).encode
_BITS = {REMOVED: 1, "preview": 2, "refined": 4}
_OTHER_BIT = 8

_TABLES = """
CREATE TABLE meta(name TEXT PRIMARY KEY, value) WITHOUT ROWID;
CREATE TABLE leaves(
    start INTEGER PRIMARY KEY, count INTEGER, sha256 TEXT UNIQUE, first TEXT, states INTEGER,
    oldest, newest, smallest, largest);
CREATE INDEX leaves_by_key ON leaves(first);
CREATE TABLE rows(
    id INTEGER PRIMARY KEY, state TEXT, updated, bytes, text TEXT, key TEXT, facts TEXT, manifest BLOB, preview BLOB);
CREATE TABLE tags(tag TEXT, id INTEGER, PRIMARY KEY(tag, id)) WITHOUT ROWID;
"""
_TRIGRAMS = "CREATE VIRTUAL TABLE %s USING fts5(text, content='', detail=none, tokenize='trigram case_sensitive 1')"
ROW_COLUMNS = "r.key, r.facts, r.state, r.updated, r.manifest, r.preview, r.bytes"
"""What `row_of_cells` reads, of the table `rows r`."""


@dataclass(frozen=True, slots=True)
class Leaf:
    """A shard in the file: the place of its first row, and how many it has."""

    start: int
    count: int
    sha256: str
    first: str

    @property
    def end(self) -> int:
        """The first place behind it."""
        return self.start + self.count


@cache
def has_trigrams() -> bool:
    """Return whether this SQLite can index trigrams (FTS5, 3.34 or newer); without them labels are scanned."""
    try:
        with closing(sqlite3.connect(":memory:")) as connection:
            connection.execute(_TRIGRAMS % "grams")
    except sqlite3.Error:
        return False
    return True


def searchable(text: str) -> str:
    """Return a text as it is searched: without case, and without what SQLite's texts cannot hold.

    Letter by letter, so that a part of a text stays a part of it.
    """
    return text.casefold().replace("\0", "\ufffd").encode("utf-8", "replace").decode()


def state_bit(state: str) -> int:
    """Return the bit that stands for a state in the `states` of a shard."""
    return _BITS.get(state, _OTHER_BIT)


def create_file(path: Path) -> None:
    """Make an empty file, whose tables are all there once it has its name: searches look at it meanwhile.

    Raises sqlite3.Error, OSError.
    """
    unnamed = path.with_suffix(".new")
    unnamed.unlink(missing_ok=True)  # of a process that died
    unnamed.touch(mode=0o600)
    with opened(unnamed) as connection:
        connection.execute("PRAGMA journal_mode = WAL")
        with transaction(connection):
            for statement in filter(str.strip, _TABLES.split(";")):
                connection.execute(statement)
            if has_trigrams():
                connection.execute(_TRIGRAMS % "grams")
                connection.execute("CREATE VIRTUAL TABLE vocabulary USING fts5vocab(grams, row)")
                connection.execute("INSERT INTO grams(grams, rank) VALUES('hashsize', ?)", (_MERGE_BYTES,))
            _put_meta(connection, form=_form(), token="", version=0)
    unnamed.replace(path)


@contextmanager
def opened(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a file that is there, for one thread. Raises sqlite3.Error."""
    uri = f"{path.absolute().as_uri()}?mode=rw"
    connection = sqlite3.connect(uri, uri=True, timeout=_BUSY_S, isolation_level=None)
    try:
        connection.execute("PRAGMA synchronous = NORMAL")
        connection.execute("PRAGMA secure_delete = ON")  # deleted assets leave no label behind
        yield connection
    finally:
        connection.close()


@contextmanager
def transaction(connection: sqlite3.Connection, *, writes: bool = True) -> Iterator[None]:
    """Commit what the block does, all or nothing; one that only reads sees one state of the file."""
    connection.execute("BEGIN IMMEDIATE" if writes else "BEGIN")
    try:
        yield
    except BaseException:
        if connection.in_transaction:  # SQLite ends it itself where the disk is full
            connection.execute("ROLLBACK")
        raise
    connection.execute("COMMIT")


def read_meta(connection: sqlite3.Connection) -> tuple[str, int]:
    """Return token and version of the collection's index that the file has; token "": not all of it yet.

    Raises sqlite3.DatabaseError where the file is damaged or of another form.
    """
    meta = dict(connection.execute("SELECT name, value FROM meta"))
    if meta.get("form") != _form():
        raise sqlite3.DatabaseError(f"a search index of another form: {meta.get('form')}")
    return meta["token"], meta["version"]


def write_meta(connection: sqlite3.Connection, token: str, version: int) -> None:
    """State which index of the collection the file has."""
    _put_meta(connection, token=token, version=version)


def prepare_to_write(connection: sqlite3.Connection) -> None:
    """Give a connection the memory that many rows need."""
    connection.execute(f"PRAGMA cache_size = -{_WRITER_CACHE_KIB}")


def insert_leaf(connection: sqlite3.Connection, sha256: str, start: int, rows: Sequence[Row]) -> None:
    """Insert a shard's rows from a place on, which must be free. Raises sqlite3.Error, ValueError, OverflowError."""
    sizes = [row.bytes for row in rows if row.bytes > 0]
    states = reduce(or_, (state_bit(row.state) for row in rows))
    times = [row.updated for row in rows]
    ends = (min(times), max(times), min(sizes, default=None), max(sizes, default=None))
    leaf = (start, len(rows), sha256, rows[0].key, states, *ends)
    connection.execute("INSERT INTO leaves VALUES(?,?,?,?,?,?,?,?,?)", leaf)
    texts = [searchable(row.label or row.key) for row in rows]
    cells = [_cells(place, row, text) for place, (row, text) in enumerate(zip(rows, texts, strict=True), start)]
    connection.executemany("INSERT INTO rows VALUES(?,?,?,?,?,?,?,?,?)", cells)
    tags = [(tag, place) for place, row in enumerate(rows, start) for tag in set(map(searchable, row.labels))]
    connection.executemany("INSERT INTO tags VALUES(?,?)", tags)
    if has_trigrams():
        grams = [(place, text + PAD) for place, text in enumerate(texts, start)]
        connection.executemany("INSERT INTO grams(rowid, text) VALUES(?,?)", grams)


def take_leaf(connection: sqlite3.Connection, leaf: Leaf) -> tuple[Row, ...]:
    """Delete a shard's rows, and return them. Raises sqlite3.Error."""
    places = (leaf.start, leaf.end)
    select = f"SELECT r.id, r.text, {ROW_COLUMNS} FROM rows r WHERE r.id >= ? AND r.id < ?"  # noqa: S608 - our columns
    found = connection.execute(select, places).fetchall()
    rows = tuple(row_of_cells(cells[2:]) for cells in found)
    if has_trigrams():  # the index of trigrams keeps no texts: it has to be told which ones go
        grams = [(place, text + PAD) for place, text, *_ in found]
        connection.executemany("INSERT INTO grams(grams, rowid, text) VALUES('delete',?,?)", grams)
    tags = [(tag, cells[0]) for cells, row in zip(found, rows, strict=True) for tag in set(map(searchable, row.labels))]
    connection.executemany("DELETE FROM tags WHERE tag = ? AND id = ?", tags)
    connection.execute("DELETE FROM rows WHERE id >= ? AND id < ?", places)
    connection.execute("DELETE FROM leaves WHERE start = ?", (leaf.start,))
    return rows


def leaf_hashes(connection: sqlite3.Connection) -> set[str]:
    """Return the sha256 of every shard in the file."""
    return {sha256 for (sha256,) in connection.execute("SELECT sha256 FROM leaves")}


def leaf_of_hash(connection: sqlite3.Connection, sha256: str) -> Leaf:
    """Return a shard that is in the file."""
    found = connection.execute("SELECT start, count, sha256, first FROM leaves WHERE sha256 = ?", (sha256,)).fetchone()
    return Leaf(*found)


def leaf_before(connection: sqlite3.Connection, key: str) -> Leaf | None:
    """Return the last shard whose first key is not behind this one."""
    select = "SELECT start, count, sha256, first FROM leaves WHERE first <= ? ORDER BY first DESC LIMIT 1"
    found = connection.execute(select, (key,)).fetchone()
    return Leaf(*found) if found else None


def leaf_behind(connection: sqlite3.Connection, key: str) -> Leaf | None:
    """Return the first shard whose first key is behind this one."""
    select = "SELECT start, count, sha256, first FROM leaves WHERE first > ? ORDER BY first LIMIT 1"
    found = connection.execute(select, (key,)).fetchone()
    return Leaf(*found) if found else None


def row_of_cells(cells: Sequence[Any]) -> Row:
    """Return the row that a selection of `ROW_COLUMNS` holds."""
    key, facts, state, updated, manifest, preview, size = cells
    label, labels, version, grade = json.loads(facts)
    return Row(
        key=key,
        label=label,
        labels=tuple(labels),
        version=version,
        state=state,
        updated=updated,
        manifest=manifest.hex(),
        preview=preview.hex(),
        bytes=size,
        grade=grade,
    )


def _cells(place: int, row: Row, text: str) -> tuple[object, ...]:
    facts = _to_json([row.label, row.labels, row.version, row.grade])
    hashes = (bytes.fromhex(row.manifest), bytes.fromhex(row.preview))
    return place, row.state, row.updated, row.bytes, text, row.key, facts, *hashes


def _put_meta(connection: sqlite3.Connection, **values: str | int) -> None:
    connection.executemany("REPLACE INTO meta VALUES(?,?)", list(values.items()))


def _form() -> str:
    """What a file depends on: its tables, which letters are the same without case, and whether it has trigrams."""
    return f"{_SCHEMA} {unicodedata.unidata_version} {has_trigrams()}"
