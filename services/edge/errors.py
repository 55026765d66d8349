"""Errors that the edge passes to its callers: each has a stable code for programs and a message for people."""

from __future__ import annotations

from functools import partial
from typing import Any

from capture2vr.errors import Capture2vrError
from capture2vr.sentences.sentence import in_row, say


class EdgeError(Capture2vrError):
    """A failure with a stable code, a message and hints.

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

    @property
    def sentence(self) -> str:
        """The message after the name of the file that it is about."""
        return in_row(": ", (self.file, self.message)) if self.file else self.message

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle all of it: it may be raised in another process than where it is caught."""
        rebuild = partial(type(self), file=self.file, hints=self.hints, retryable=self.retryable)
        return rebuild, (self.code, self.message)

    @classmethod
    def _usual_hints(cls, code: str) -> tuple[str, ...]:
        """Default hints for a code, used where the raiser gives none."""
        return ()


_DEFAULT_HINTS = {
    "CAPTURE_EMPTY": say("choose_files_again_check_they"),
    "CAPTURE_TRUNCATED": say("copy_export_file_again"),
    "CAPTURE_NOT_FINITE": say("export_capture_again_in_metres"),
    "CAPTURE_TOO_FEW_POINTS": say("walk_around_object_scan_again"),
    "CAPTURE_DEGENERATE": say("walk_around_object_scan_again"),
    "CAPTURE_TOO_LARGE": say("send_fewer_frames_fewer_points"),
    "CAPTURE_NO_POSES": say("also_send_file_with_camera"),
    "CAPTURE_COUNT_MISMATCH": say("send_all_files_recording"),
    "CAPTURE_BAD_INTRINSICS": say("send_camera_own_intrinsics_size"),
    "IMAGE_TOO_LARGE": say("send_smaller_pictures"),
}
_OTHER_HINT = say("export_capture_again")


class CaptureError(EdgeError):
    """An error in the capture itself. It always has a hint, because the person who made the capture can correct it."""

    @classmethod
    def _usual_hints(cls, code: str) -> tuple[str, ...]:
        return (_DEFAULT_HINTS.get(code, _OTHER_HINT),)


class Cancelled(Exception):  # noqa: N818 - not an error: somebody asked for it
    """Raised by a `Tick` to stop the work because the job was cancelled."""
