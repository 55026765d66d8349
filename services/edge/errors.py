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
        self.hints = hints or self._usual_hints(code)
        self.retryable = retryable

    @classmethod
    def _usual_hints(cls, code: str) -> tuple[str, ...]:
        """What to do where the raiser knows nothing better."""
        return ()


_WHAT_TO_DO = {
    "CAPTURE_EMPTY": "choose the files again, and look whether there is anything in them",
    "CAPTURE_TRUNCATED": "copy or export the file again",
    "CAPTURE_NOT_FINITE": "export the capture again, in metres",
    "CAPTURE_TOO_FEW_POINTS": "walk around the thing and scan it again",
    "CAPTURE_DEGENERATE": "walk around the thing and scan it again",
    "CAPTURE_TOO_LARGE": "send fewer frames, or a thinner cloud",
    "CAPTURE_NO_POSES": "send the file with the camera's poses too",
    "CAPTURE_COUNT_MISMATCH": "send the whole recording, every file of it",
    "CAPTURE_BAD_INTRINSICS": "send the camera's own intrinsics, for the size of its images",
    "IMAGE_TOO_LARGE": "send smaller pictures",
}
_OTHERWISE = "export the capture again"


class CaptureError(EdgeError):
    """The capture itself is at fault; the person who made it can mend it, so there always is a hint."""

    @classmethod
    def _usual_hints(cls, code: str) -> tuple[str, ...]:
        return (_WHAT_TO_DO.get(code, _OTHERWISE),)


class Cancelled(Exception):  # noqa: N818 - not an error: somebody asked for it
    """Raised from a `Tick` when the work is no longer wanted."""
