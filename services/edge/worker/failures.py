"""Exceptions of the work → `Failure` on the wire: what the caller may know, and whether asking again can help."""

from __future__ import annotations

import errno
import logging
from pathlib import Path

from services.edge.api import edge_pb2 as pb
from services.edge.errors import EdgeError

_log = logging.getLogger(__name__)

CANCELLED = pb.Failure(code="CANCELLED", message="the job was cancelled")
DRAINING = pb.Failure(
    code="WORKER_DRAINING",
    message="the worker is shutting down before it could finish the job",
    hints=["send the job again: another worker takes it"],
    retryable=True,
)


def failure_of(error: BaseException, *, job: str, scratch: Path) -> pb.Failure:
    """The failure that `error` means. An unforeseen one is logged with its traceback and told without its text."""
    match error:
        case EdgeError():
            return _named(error, scratch)
        case OSError(errno=errno.ENOSPC):
            _log.error("job %s: no space left in the scratch folder", job, exc_info=error)
            return pb.Failure(code="SCRATCH_FULL", message="the worker's disk is full", retryable=True)
        case MemoryError():
            _log.error("job %s: out of memory", job, exc_info=error)
            return pb.Failure(
                code="OUT_OF_MEMORY",
                message="the worker's memory does not hold this capture at this preset",
                hints=["choose a coarser preset", "send fewer frames or points"],
            )
        case _:
            _log.error("job %s: unforeseen %s", job, type(error).__name__, exc_info=error)
            return pb.Failure(code="INTERNAL", message=f"the worker failed; its log has the reason under job {job}")


def _named(error: EdgeError, scratch: Path) -> pb.Failure:
    return pb.Failure(
        code=error.code,
        message=_without(scratch, error.message),
        file=_without(scratch, error.file or ""),
        hints=[_without(scratch, hint) for hint in error.hints],
        retryable=error.retryable,
    )


def _without(scratch: Path, text: str) -> str:
    """The text with files named as the caller knows them: where the worker unpacks is nobody's business."""
    return text.replace(f"{scratch}/", "").replace(str(scratch), "the capture")
