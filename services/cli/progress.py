"""How far the work is: a bar in a terminal, lines in a log."""

from __future__ import annotations

import time
from collections.abc import Mapping
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.text import Text

console = Console(stderr=True, soft_wrap=True)

_LINE_EVERY_S = 15.0  # in a log, within one stage: training takes a minute, and a log that stands still looks dead


class StageBar:
    """`with StageBar() as bar: bar.show("FITTING", 0.4, "10,000 points")`"""

    def __init__(self) -> None:
        self._stage = ""
        self._said = 0.0
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
        """The stage, the share of the whole in [0,1], what the stage says of itself, and the losses of a training."""
        said = f"{message}, loss {losses['total']:.2g}" if losses and "total" in losses else message
        self._bar.update(self._task, description=stage, completed=fraction, message=said)
        now = time.monotonic()
        if not console.is_terminal and (stage != self._stage or (message and now - self._said > _LINE_EVERY_S)):
            console.print(f"{stage:<12} {fraction:4.0%}  {said}".rstrip(), highlight=False, markup=False)
            self._said = now
        self._stage = stage

    def __enter__(self) -> StageBar:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()


def warn(text: str) -> None:
    """A line that begins with a yellow "warning"."""
    console.print(Text("warning ", style="yellow").append(text, style="default"))
