"""The inspection of one capture, in a process of its own with limits: what fork_server.py runs for the worker."""

from __future__ import annotations

import os
import resource
import tempfile
from pathlib import Path
from typing import Any

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.jobs.inspect_capture import ANSWER, inspect, too_costly, unpack_capture
from capture2vr.edge.worker.failures import failure_of
from capture2vr.order.photo_box import PhotoBox
from capture2vr.process.fork_server import Send
from capture2vr.sentences.sentence import say

# Beside the interpreter and its libraries, which have 350 MB: rows of text take 15 times their bytes when they are
# parsed, and are parsed at 20 MB a second.
_LEAST_BYTES, _BYTES_PER_BYTE, _MOST_BYTES = 1 << 30, 16, 6 << 30
_LEAST_SECONDS, _SECONDS_PER_GB = 20, 100


def work(order: dict[str, Any], _: Send) -> None:
    """Inspect an archive within limits that follow from its unpacked size, and write the answer to the scratch folder.

    order  archive and scratch: paths; box: of the object in a photo, as in JSON, or nothing
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    box = PhotoBox.of(order["box"]) if order["box"] else None
    scratch = Path(order["scratch"])
    # Decoders write gigabytes, and a process that is killed removes nothing: the worker removes this folder.
    tempfile.tempdir = os.environ["TMPDIR"] = str(scratch)
    try:
        folder = unpack_capture(Path(order["archive"]), scratch)
        _limit(sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()))
        answer = inspect(folder, box)
    except EdgeError as error:
        answer = _failed(error, scratch)
    except MemoryError:
        answer = _failed(too_costly(say("more_memory")), scratch)
    (scratch / ANSWER).write_bytes(answer.SerializeToString())


def _limit(capture_bytes: int) -> None:
    """Limit this process, and each child of it, to the processor time and memory that a capture of this size may take.

    Only the soft limits: a child with an own budget, for native decoders, sets its own.
    """
    for kind, most in (
        (resource.RLIMIT_DATA, min(_LEAST_BYTES + _BYTES_PER_BYTE * capture_bytes, _MOST_BYTES)),
        (resource.RLIMIT_CPU, _LEAST_SECONDS + _SECONDS_PER_GB * capture_bytes // 10**9),
    ):
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _failed(error: EdgeError, scratch: Path) -> pb.Inspection:
    return pb.Inspection(failure=failure_of(error, job="of an inspection", scratch=scratch))
