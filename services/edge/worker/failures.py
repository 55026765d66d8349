"""Convert exceptions of a job to `Failure` messages: what the caller may know, and whether a retry can help."""

from __future__ import annotations

import errno
import logging
from pathlib import Path

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.errors import EdgeError

_log = logging.getLogger(__name__)

CANCELLED = pb.Failure(code="CANCELLED", message="the job was cancelled")
DRAINING = pb.Failure(
    code="WORKER_DRAINING",
    message="the worker is shutting down before it could finish the job",
    hints=["send the job again: another worker takes it"],
    retryable=True,
)


def failure_of(error: BaseException, *, job: str, scratch: Path) -> pb.Failure:
    """Convert an exception to a `Failure`. An unexpected one is logged with traceback; the caller gets no details."""
    match error:
        case EdgeError():
            return _from_edge_error(error, scratch)
        case OSError(errno=errno.ENOSPC):
            _log.error("job %s: no space left in the scratch folder", job, exc_info=error)
            return pb.Failure(code="SCRATCH_FULL", message="the worker's disk is full", retryable=True)
        case MemoryError():
            _log.error("job %s: out of memory", job, exc_info=error)
            return pb.Failure(
                code="OUT_OF_MEMORY",
                message="the worker has too little memory for this capture with this preset",
                hints=["choose a coarser preset", "send fewer frames or points"],
            )
        case _:
            _log.error("job %s: unexpected %s", job, type(error).__name__, exc_info=error)
            return internal(job)


def internal(job: str) -> pb.Failure:
    """Return the failure of a job that a fault of the worker itself has ended, which its log tells."""
    return pb.Failure(code="INTERNAL", message=f"the worker failed; its log has the reason under job {job}")


def _from_edge_error(error: EdgeError, scratch: Path) -> pb.Failure:
    return pb.Failure(
        code=error.code,
        message=_printable(scratch, error.message),
        file=_printable(scratch, error.file or ""),
        hints=[_printable(scratch, hint) for hint in error.hints],
        retryable=error.retryable,
    )


def _printable(scratch: Path, text: str) -> str:
    """Remove the scratch folder from a text for the caller, who knows files by their path in the capture.

    A capture's JSON can name files by half a surrogate pair, which no message can hold: a question mark replaces it.
    """
    plain = text.replace(f"{scratch}/", "").replace(str(scratch), "the capture")
    return plain.encode("utf-8", "replace").decode()
