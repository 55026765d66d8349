"""The errors of capture2vr: one tree, so that `except Capture2vrError` catches all that it raises on purpose.

Capture2vrError
├── BadInput            an argument, a file or a setting that the caller can correct
│   └── GatewayError    what a gateway refuses, or that it cannot be reached
│       ├── JobFailed           a job that has ended without an asset
│       └── VerificationError   a download that is not what was signed
└── EdgeError           a reconstruction that failed (`edge/errors.py`)
    └── CaptureError    the capture itself cannot give a surface
"""

from __future__ import annotations


class Capture2vrError(Exception):
    """Base class of all errors that capture2vr raises on purpose. Its text is one line for people."""


class BadInput(Capture2vrError):  # noqa: N818 - it reads as what it is
    """An error that the caller can correct: an argument, a file or a setting.

    A command prints its one-line message and ends with exit code 2.
    """


class GatewayError(BadInput):
    """A gateway refuses a request, does not answer as a gateway does, or cannot be reached.

    code       stable code of its problem document, e.g. "PRESET_UNKNOWN"; "" where it sent none
    status     of the HTTP answer; 0 where there was none
    hints      what the caller can do about it
    retryable  whether the same request may succeed later
    """

    def __init__(
        self, message: str, *, code: str = "", status: int = 0, hints: tuple[str, ...] = (), retryable: bool = False
    ) -> None:
        super().__init__(message)
        self.code = code
        self.status = status
        self.hints = hints
        self.retryable = retryable


class JobFailed(GatewayError):  # noqa: N818 - it reads as what it is
    """A job of a gateway has ended without an asset: it failed, with the reason, or was cancelled."""


class VerificationError(GatewayError):
    """An asset is not what was signed, or a part of it is missing or damaged. code: e.g. "SIGNATURE_WRONG" """


def sentence(message: str, *, file: str | None = None, hints: tuple[str, ...] = ()) -> str:
    """Format an error on one line: file, reason, and hints in parentheses."""
    message_with_file = f"{file}: {message}" if file and not message.startswith(file) else message
    return f"{message_with_file} ({'; '.join(hints)})" if hints else message_with_file
