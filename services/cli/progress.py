"""The progress bar that every command shows."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.text import Text

console = Console(stderr=True, markup=False)  # what is printed holds file names, which may have brackets in them


def warn(text: str) -> None:
    """A line that begins with a yellow "warning"."""
    console.print(Text("warning ", style="yellow").append(text, style="default"))


def stage_bar() -> Progress:
    """A bar with the stage's name, percentage, elapsed time and what the stage says of itself."""
    return Progress(
        TextColumn("{task.description:<12}", style="bold", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[message]}", markup=False),
        console=console,
    )
