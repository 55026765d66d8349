"""`capture2vr presets`: print the table of presets."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from capture2vr.cli.progress import print_listing
from capture2vr.edge.preset import AUTOMATIC, Preset, load_preset, memory_bytes, preset_names

_LIKE_A_THING = 10_000  # points of a garment: a typical size, for the memory column


def list_presets() -> None:
    """Print the presets, the automatic choice first, and behind them the methods from the literature."""
    presets = [load_preset(name) for name in preset_names()]
    print_listing(
        _table([load_preset(AUTOMATIC), *(preset for preset in presets if not preset.literature)]),
        "\nMethods from the literature, to compare with: each publishes its own mesh",
        _table([preset for preset in presets if preset.literature]),
    )


def _table(presets: Sequence[Preset]) -> Table:
    """Each preset's training steps, memory and summary."""
    table = Table()
    for column in ("preset", "trains", "memory, 10,000 points", "at most"):
        is_name = column == "preset"
        table.add_column(column, justify="left" if is_name else "right", no_wrap=is_name)
    table.add_column("", overflow="fold")
    for preset in presets:
        if preset.name == AUTOMATIC:
            table.add_row(AUTOMATIC, "", "", "", preset.summary)
            continue
        takes = (memory_bytes(preset, points) for points in (_LIKE_A_THING, preset.most_points))
        steps = f"{preset.fit.total_steps:,} steps" if preset.fit else "no"
        words = preset.summary + (f"; takes {preset.takes}" if preset.takes else "")
        table.add_row(preset.name, steps, *(f"{each / 1e9:.2f} GB" for each in takes), words)
    return table
