"""`Report`: who hears of an upload's progress, such as the progress bar of a command."""

from __future__ import annotations

from typing import Protocol


class Report(Protocol):
    """Receives the progress of an upload, and warnings."""

    def show(self, stage: str, fraction: float, message: str = "") -> None:
        """Receive one progress report. stage: UPLOADING or CHECKING; fraction: of the upload, [0,1]"""

    def warn(self, text: str) -> None:
        """Receive a warning: the upload goes on."""
