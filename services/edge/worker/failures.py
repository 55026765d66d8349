"""Convert exceptions of a job to `Failure` messages: what the caller may know, and whether a retry can help."""

from __future__ import annotations

import errno
import logging
from pathlib import Path

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.worker.coded_messages import coded_failure
from capture2vr.sentences.documents import read_codes
from capture2vr.sentences.sentence import map_texts, say

_log = logging.getLogger(__name__)

CANCELLED = coded_failure("CANCELLED", say("job_cancelled"))
DRAINING = coded_failure(
    "WORKER_DRAINING",
    say("worker_shutting_down_before_could"),
    hints=(say("send_job_again_another_worker"),),
    retryable=True,
)

YIELDED = coded_failure("JOB_YIELDED", say("job_yielded"), retryable=True)


def failure_of(error: BaseException, *, job: str, scratch: Path) -> pb.Failure:
    """Convert an exception to a `Failure`. An unexpected one is logged with traceback; the caller gets no details."""
    match error:
        case EdgeError():
            return _from_edge_error(error, scratch)
        case OSError(errno=errno.ENOSPC):
            _log.error("job %s: no space left in the scratch folder", job, exc_info=error)
            return coded_failure("SCRATCH_FULL", say("worker_disk_full"), retryable=True)
        case MemoryError():
            _log.error("job %s: out of memory", job, exc_info=error)
            return _from_edge_error(out_of_memory(), scratch)
        case _:
            _log.error("job %s: unexpected %s", job, type(error).__name__, exc_info=error)
            return internal(job)


def error_of(failure: pb.Failure) -> EdgeError:
    """Convert a `Failure`, that another worker or a job's process has told of, to the error that this job ends with."""
    said = read_codes(failure.i18n, message=failure.message, hints=tuple(failure.hints))
    return EdgeError(
        failure.code,
        said["message"],
        file=failure.file or None,
        hints=tuple(said["hints"]),
        retryable=failure.retryable,
    )


def out_of_memory() -> EdgeError:
    """Return the error of a job that wants more memory than its worker has."""
    hints = (say("choose_coarser_preset"), say("send_fewer_frames_points"))
    return EdgeError("OUT_OF_MEMORY", say("worker_has_too_little_memory"), hints=hints)


def internal(job: str) -> pb.Failure:
    """Return the failure of a job that a fault of the worker itself has ended, which its log tells."""
    return coded_failure("INTERNAL", say("worker_failed_log_has_reason", job=job))


def _from_edge_error(error: EdgeError, scratch: Path) -> pb.Failure:
    return coded_failure(
        error.code,
        _printable(scratch, error.message),
        file=_printable(scratch, error.file or ""),
        hints=tuple(_printable(scratch, hint) for hint in error.hints),
        retryable=error.retryable,
    )


def _printable(scratch: Path, text: str) -> str:
    """Remove the scratch folder from a text for the caller, who knows files by their path in the capture.

    A capture's JSON can name files by half a surrogate pair, which no message can hold: a question mark replaces it.
    """

    def plain(each: str) -> str:
        without = each.replace(f"{scratch}/", "").replace(str(scratch), "the capture")
        return without.encode("utf-8", "replace").decode()

    return map_texts(text, plain)
