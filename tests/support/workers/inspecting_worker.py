"""A worker that inspects captures and takes no jobs: for tests in which nothing is made of what is uploaded.

It is a process, because gRPC's servers and its asyncio clients do not get on in one for long.
"""

from __future__ import annotations

import atexit
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import grpc

import capture2vr
from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.api import edge_pb2_grpc
from tests.support.repository import ROOT

FOUND = pb.Inspection(kind="points", format="ply", points=7)


class _Worker(edge_pb2_grpc.EdgeReconstructionServicer):
    def GetWorker(self, request: pb.GetWorkerRequest, context: Any) -> pb.Worker:  # noqa: N802
        return pb.Worker(version=capture2vr.__version__, device="cpu")

    def Inspect(self, chunks: Iterator[pb.Chunk], context: Any) -> pb.Inspection:  # noqa: N802
        context.send_initial_metadata(())  # the archive is sent behind it
        for _ in chunks:
            pass
        return FOUND


@cache
def inspecting_worker() -> str:
    """The address of one that ends with this process."""
    command = (sys.executable, "-m", "tests.support.workers.inspecting_worker")
    process = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    atexit.register(process.communicate)  # its input ends, and so does it
    assert process.stdout is not None
    return f"127.0.0.1:{process.stdout.readline().strip()}"


if __name__ == "__main__":
    served = grpc.server(ThreadPoolExecutor(8))
    edge_pb2_grpc.add_EdgeReconstructionServicer_to_server(_Worker(), served)  # type: ignore[no-untyped-call]
    print(served.add_insecure_port("127.0.0.1:0"), flush=True)
    served.start()
    sys.stdin.read()  # until its parent ends
