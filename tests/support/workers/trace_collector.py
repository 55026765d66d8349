"""An OTLP collector in this process: it keeps the spans that other processes send it."""

from __future__ import annotations

import gzip
import io
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from capture2vr.process import traces

_FAILED = 2  # OpenTelemetry's status code ERROR


@dataclass(frozen=True, slots=True)
class Span:
    """A span as it was sent. Ids are hexadecimal; parent: the id of the span around it; times: s since the epoch."""

    service: str
    name: str
    trace: str
    id: str
    parent: str
    start_s: float
    end_s: float
    failed: bool

    @property
    def seconds(self) -> float:
        """How long it took."""
        return self.end_s - self.start_s


class TraceCollector(ThreadingHTTPServer):
    """Takes spans as OTLP over HTTP."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Receiver)
        self.spans: list[Span] = []

    @property
    def variables(self) -> dict[str, object]:
        """The environment of a process that sends its spans here, soon after they end."""
        url = f"http://127.0.0.1:{self.server_address[1]}"
        return {traces.ENDPOINT: url, "OTEL_BSP_SCHEDULE_DELAY": 100}

    def of_capture(self, capture: str) -> list[Span]:
        """The spans of a capture's trace, in the order of their starts."""
        found = [span for span in self.spans if span.trace == traces.trace_id(capture)]
        return sorted(found, key=lambda span: (span.start_s, -span.end_s))


@contextmanager
def collecting() -> Iterator[TraceCollector]:
    """A collector that listens, until the end of the block."""
    with TraceCollector() as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


class _Receiver(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        if self.headers.get("Content-Encoding") == "gzip":
            body = gzip.GzipFile(fileobj=io.BytesIO(body)).read()
        assert self.path == "/v1/traces"
        assert isinstance(self.server, TraceCollector)
        self.server.spans += _spans(body)
        self.send_response(200)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002 - its name in the base class
        pass


def _spans(body: bytes) -> Iterator[Span]:
    # Here, because the packages are an extra, and without them tests of it are skipped.
    from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest

    for resource in ExportTraceServiceRequest.FromString(body).resource_spans:
        named = {each.key: each.value.string_value for each in resource.resource.attributes}
        for span in (each for scope in resource.scope_spans for each in scope.spans):
            ids = span.trace_id.hex(), span.span_id.hex(), span.parent_span_id.hex()
            times = span.start_time_unix_nano / 1e9, span.end_time_unix_nano / 1e9
            yield Span(named["service.name"], span.name, *ids, *times, span.status.code == _FAILED)
