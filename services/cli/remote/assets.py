"""`capture2vr ls | rm | restore | keep`: list a collection's assets, remove (hide) one, restore it, keep a held one."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date, datetime, time, timedelta

from rich.table import Table
from rich.text import Text

from capture2vr.cli.printable import printable
from capture2vr.cli.progress import console, print_listing
from capture2vr.client.answers import parse_answer
from capture2vr.client.assets import assets_of
from capture2vr.client.http import open_gateway
from capture2vr.client.keep import keep_version
from capture2vr.client.names import check_collection, check_key
from capture2vr.errors import BadInput

_MB = 1e6


@dataclass(frozen=True, slots=True)
class AssetFilter:
    """What the assets of a list have in common; what is None or "" does not matter.

    since, until    days of the last change, both included, in the time zone of this machine
    min_mb, max_mb  size of all files, megabytes
    """

    label: str = ""
    state: str = ""
    since: date | None = None
    until: date | None = None
    min_mb: float | None = None
    max_mb: float | None = None

    def query(self) -> dict[str, str | int]:
        """Build the query of the gateway's search. Raises BadInput for days and sizes out of range."""
        try:
            return self._query()
        except (OverflowError, ValueError):
            options = "--since, --until, --min-mb and --max-mb"
            raise BadInput(f"{options}: give days of the years 2 to 9998, and sizes that are finite") from None

    def _query(self) -> dict[str, str | int]:
        end = None if self.until is None else _begin_of(self.until + timedelta(days=1)) - timedelta(seconds=1)
        facts = {
            "since": None if self.since is None else _begin_of(self.since).isoformat(),
            "until": None if end is None else end.isoformat(),
            "min_bytes": None if self.min_mb is None else round(self.min_mb * _MB),
            "max_bytes": None if self.max_mb is None else round(self.max_mb * _MB),
        }
        asked = {name: value for name, value in facts.items() if value is not None}
        return {"label": self.label, "state": self.state, **asked}


def list_assets(gateway: str, *, collection: str, wanted: AssetFilter) -> int:
    """Print the assets of a collection that are wanted, and return their number. Raises BadInput."""
    check_collection(collection)
    with open_gateway(gateway) as client:
        rows = list(assets_of(client, collection, wanted.query()))
    table = Table(title=f"{collection}: {len(rows):,} assets")
    for column in ("key", "label", "labels", "version", "state", "grade", "updated", "MB"):
        table.add_column(column, justify="right" if column in ("version", "MB") else "left", overflow="fold")
    for row in rows:
        names = (row.key, row.label, ", ".join(row.labels))
        size = "" if row.bytes is None else f"{row.bytes / _MB:.1f}"
        facts = (str(row.version), row.state, row.grade, row.updated, size)
        table.add_row(
            *(Text(printable(cell)) for cell in (*names, *facts))
        )  # Text, because labels may look like markup
    print_listing(table)
    return len(rows)


def set_removed(key: str, gateway: str, verb: str, *, collection: str) -> None:
    """Remove or restore an asset at the gateway. Raises BadInput.

    verb        remove | restore
    collection  do it only if the asset is in this collection; "": in any case
    """
    check_key(key)
    if collection:
        check_collection(collection)
    with open_gateway(gateway) as client:
        answer = parse_answer(client.post(f"/v1/assets/{key}/{verb}", params={"collection": collection}))
        state = "removed; its files are kept, and `restore` brings it back" if answer["removed"] else "available"
        console.print(f"{key} version {answer['version']} is {state}")


def keep(key: str, gateway: str, *, version: int | None) -> None:
    """Publish a version that was held back. version: None: the newest of them. Raises BadInput."""
    with open_gateway(gateway) as client:
        number = keep_version(client, key, version)
    console.print(f"{key} is published, as version {number}: {gateway.rstrip('/')}/view/{key}", soft_wrap=True)


def _begin_of(day: date) -> datetime:
    return datetime.combine(day, time.min).astimezone()
