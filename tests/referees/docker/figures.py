"""What a run of the stack has measured, as it goes on, and as a table in a page."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass, field
from pathlib import Path

_BEGIN, _END = "<!-- figures of make test-compose -->", "<!-- end of the figures -->"


@dataclass(slots=True)
class Figures:
    """Rows of what was measured, and the figure."""

    rows: list[tuple[str, str]] = field(default_factory=list)

    def note(self, what: str, figure: str) -> None:
        """Add a row, and print it with the time."""
        self.rows.append((what, figure))
        print(f"{time.strftime('%H:%M:%S')}  {what:<58} {figure}", flush=True)

    def write(self, page: Path, about: str) -> None:
        """Put the rows in the place of those of the last run, as Prettier has them. about: a sentence on the run"""
        rows = [("what", "figure"), *self.rows]
        first, second = (max(map(len, column)) for column in zip(*rows, strict=True))
        rows.insert(1, ("-" * first, "-" * second))
        table = "\n".join(f"| {what:<{first}} | {figure:<{second}} |" for what, figure in rows)
        text = re.sub(
            f"{_BEGIN}.*{_END}",
            lambda _: f"{_BEGIN}\n\n{about}\n\n{table}\n\n{_END}",
            page.read_text(),
            flags=re.DOTALL,
        )
        page.write_text(text)
