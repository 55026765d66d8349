"""Progress output of commands: a progress bar in a terminal, single lines in a log; and warnings."""

from __future__ import annotations

import time
from collections.abc import Mapping
from types import TracebackType

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.text import Text

# Names of folders and things may have brackets, which are no markup.
console = Console(stderr=True, soft_wrap=True, markup=False)

_PIPE_WIDTH = 10_000  # columns where nobody looks: no line of a table is folded, so that grep finds whole names

_LINE_EVERY_S = 15.0  # between lines of one stage in a log: training takes a minute, and a silent log looks dead


class StageBar:
    """Progress bar: `with StageBar() as bar: bar.show("FITTING", 0.4, "10,000 points")`."""

    def __init__(self) -> None:
        self._stage = ""
        self._last_line_s = 0.0
        self._bar = Progress(
            TextColumn("{task.description:<12}", style="bold", markup=False),
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[message]}", markup=False),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("", total=1.0, message="")

    def show(self, stage: str, fraction: float, message: str = "", losses: Mapping[str, float] | None = None) -> None:
        """Update the bar: stage, fraction of the whole job [0,1], the stage's message, losses of a training."""
        line = f"{message}, loss {losses['total']:.2g}" if losses and "total" in losses else message
        self._bar.update(self._task, description=stage, completed=fraction, message=line)
        now = time.monotonic()
        if not console.is_terminal and (stage != self._stage or (message and now - self._last_line_s > _LINE_EVERY_S)):
            console.print(f"{stage:<12} {fraction:4.0%}  {line}".rstrip(), highlight=False, markup=False)
            self._last_line_s = now
        self._stage = stage

    def warn(self, text: str) -> None:
        """Print a warning above the bar."""
        warn(text)

    def __enter__(self) -> StageBar:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()


def print_listing(*contents: RenderableType, fold: bool = False) -> None:
    """Print what a command was asked for to standard output, where a pipe finds it; all else goes to stderr.

    fold  fold long lines where nobody looks too
    """
    out = Console(soft_wrap=True, markup=False)
    out = out if fold or out.is_terminal else Console(width=_PIPE_WIDTH, markup=False)
    for content in contents:
        out.print(content)


def warn(text: str) -> None:
    """Print a line that begins with "warning" in yellow."""
    console.print(Text("warning ", style="yellow").append(text, style="default"))
