"""`capture2vr presets`: print the table of presets."""

from __future__ import annotations

from rich.table import Table

from services.cli.progress import console
from services.edge.preset import AUTOMATIC, load_preset, memory_bytes, preset_names

_LIKE_A_THING = 10_000  # points of a garment: a typical size, for the memory column


def list_presets() -> None:
    """Print each preset's training steps, memory and summary; the first row is the automatic choice."""
    table = Table()
    for column in ("preset", "trains", "memory, 10,000 points", "at most"):
        is_name = column == "preset"
        table.add_column(column, justify="left" if is_name else "right", no_wrap=is_name)
    table.add_column("", overflow="fold")
    table.add_row(AUTOMATIC, "", "", "", load_preset(AUTOMATIC).summary)
    for preset in map(load_preset, preset_names()):
        takes = (memory_bytes(preset, points) for points in (_LIKE_A_THING, preset.most_points))
        steps = f"{preset.fit.total_steps:,} steps" if preset.fit else "no"
        table.add_row(preset.name, steps, *(f"{each / 1e9:.2f} GB" for each in takes), preset.summary)
    console.print(table)
