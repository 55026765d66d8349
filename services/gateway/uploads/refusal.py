"""Refusal of an upload, for code that knows nothing of HTTP: the processes that check files import little."""

from __future__ import annotations

from dataclasses import dataclass

from capture2vr.sentences.sentence import say

SEND_FEWER = (say("send_fewer_frames_example_every"),)


@dataclass(slots=True)
class Refused(Exception):  # noqa: N818 - not a fault of ours
    """An upload, or one of its files, cannot be used. The fields are those of a `Problem`."""

    code: str
    detail: str
    file: str = ""
    hints: tuple[str, ...] = ()
    status: int = 422


def too_many_files(most: int) -> Refused:
    """Return the refusal of an upload with more files than `most`, in a form or in a zip."""
    detail = say("upload_has_too_many_files", most=most)
    return Refused("UPLOAD_TOO_MANY_FILES", detail, hints=SEND_FEWER, status=413)
