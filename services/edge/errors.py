"""Errors that cross the edge's seams: each carries a code that a program can test and a sentence to act on."""

from __future__ import annotations


class EdgeError(Exception):
    """A failure with a name.

    code       SCREAMING_SNAKE, stable, e.g. "CAPTURE_TOO_FEW_POINTS"
    message    one sentence: what is wrong, with the numbers
    file       the file of the capture it concerns, relative to the capture's root, or None
    hints      what the person can do about it
    retryable  whether the same request may succeed later
    """

    def __init__(
        self,
        code: str,
        message: str,
        *,
        file: str | None = None,
        hints: tuple[str, ...] = (),
        retryable: bool = False,
    ) -> None:
        super().__init__(f"{file}: {message}" if file else message)
        self.code = code
        self.message = message
        self.file = file
        self.hints = hints
        self.retryable = retryable


class CaptureError(EdgeError):
    """The capture itself is at fault; the person who made it can mend it."""


class Cancelled(Exception):  # noqa: N818 - not an error: somebody asked for it
    """Raised from a `Tick` when the work is no longer wanted."""
