"""Have uploads checked in processes of their own, which run check_work.py."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from capture2vr.gateway.errors import Problem, storage_full
from capture2vr.gateway.forked_talk import no_spend, talk
from capture2vr.gateway.uploads.check_and_pack import CheckOrder, PackedFiles, archive_of
from capture2vr.gateway.uploads.refusal import SEND_FEWER
from capture2vr.gateway.uploads.validate import FileReport
from capture2vr.process.fork_client import ForkServer
from capture2vr.sentences.sentence import say

# Signals by which the kernel ends a check that has used up its processor time, its time on the clock, or all memory.
_USED_UP = (signal.SIGXCPU, signal.SIGALRM, signal.SIGKILL)


class CheckProcesses:
    """Checks uploads, each in a process that ends with its check. turns.py says how many at once."""

    def __init__(self, server: ForkServer | None = None) -> None:
        self._server = server or ForkServer.of("capture2vr.gateway.uploads.check_work")

    def start(self) -> None:
        """Load all that a check needs now, so that the first upload need not wait for it."""
        self._server.start()

    def close(self) -> None:
        """Terminate the fork server, and the checks that run."""
        self._server.close()

    async def check(self, order: CheckOrder, spend: Callable[[float], None] = no_spend) -> PackedFiles:
        """Check an upload and pack its files. When cancelled, returns once the check's process has ended.

        spend  is told the processor seconds that it took, however it ends

        Raises Problem.
        """
        return _result(order, await talk(self._server.fork(), asdict(order), spend))


def _result(order: CheckOrder, said: dict[str, Any]) -> PackedFiles:
    """Return what was packed. Raises Problem for what was refused, and for a process that was ended."""
    if (refused := said.get("refused")) is not None:
        code, detail, file = refused["code"], refused["detail"], refused["file"]
        raise Problem(refused["status"], code, detail, file=file, hints=tuple(refused["hints"]))
    if "full" in said:
        raise storage_full()
    if (packed := said.get("packed")) is not None and said.get("ended") == 0:
        verdicts = [FileReport(**{**each, "stripped": tuple(each["stripped"])}) for each in packed["verdicts"]]
        return PackedFiles(archive_of(Path(order.folder)), packed["sha256"], verdicts)
    if "failed" in said:
        raise RuntimeError(f"the check of an upload failed: {said['failed']}")
    raise _ended(said)


def _ended(said: dict[str, Any]) -> Problem:
    """Return the problem for a check without a result: it ran out of memory or time, crashed, or was killed."""
    status, file = said.get("ended"), said.get("file", "")
    if status is None:
        return Problem(503, "CHECK_INTERRUPTED", say("check_upload_interrupted"), retryable=True)
    if "costly" in said or -status in _USED_UP:
        what = say("word_memory" if "costly" in said else "word_time")
        detail = say("checking_takes_more_than_upload", what=what)
        return Problem(422, "CAPTURE_TOO_LARGE", detail, file=file, hints=SEND_FEWER)
    name = signal.Signals(-status).name if status < 0 else f"status {status}"
    hints = (say("send_file_again_leave"),)
    return Problem(422, "CAPTURE_UNREADABLE", say("cannot_be_read_decoder_crashed", name=name), file=file, hints=hints)
