"""Select the rows of a collection by label, state, date and size."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from capture2vr.storage.catalogue.collection import Row


@dataclass(frozen=True, slots=True)
class RowFilter:
    """What is wanted of an asset; what is None or "" does not matter.

    label                 part of the label (without one: of the key), or one of the labels; case is ignored
    state                 preview | refined | removed; "": all but removed assets
    since, until          bounds of the last change, both included, with their time zones
    min_bytes, max_bytes  bounds of the size of all files; an asset of unknown size is not within any
    """

    label: str = ""
    state: str = ""
    since: datetime | None = None
    until: datetime | None = None
    min_bytes: int | None = None
    max_bytes: int | None = None

    def accepts(self, row: Row) -> bool:
        """Return whether the row of an asset is wanted."""
        state = row.state == self.state if self.state else not row.removed
        return state and self._has_label(row) and self._in_time(row.updated) and self._has_size(row.bytes)

    def _has_label(self, row: Row) -> bool:
        wanted = self.label.casefold()
        return wanted in (row.label or row.key).casefold() or any(wanted == each.casefold() for each in row.labels)

    def _in_time(self, updated: int) -> bool:
        """Rows have whole seconds: what changed in the last second of a time is within it."""
        late_enough = self.since is None or updated >= int(self.since.timestamp())
        return late_enough and (self.until is None or updated <= self.until.timestamp())

    def _has_size(self, size: int) -> bool:
        if self.min_bytes is None and self.max_bytes is None:
            return True
        return size > 0 and (self.min_bytes or 0) <= size and (self.max_bytes is None or size <= self.max_bytes)
