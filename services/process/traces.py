"""Traces of captures (OpenTelemetry): every span about a capture has one trace id, from its upload to its publishing.

The trace id is made of the capture's id, so gateway, workers and central worker agree on it without sending it, and
whoever has the capture's id from a log line finds its trace. Spans are sent by OTLP where OTEL_EXPORTER_OTLP_ENDPOINT
is set; else nothing is imported and nothing is done.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import capture2vr
from capture2vr.process.logs import log_fields
from capture2vr.process.strict_settings import SettingsError

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import SpanProcessor, TracerProvider
    from opentelemetry.trace import Tracer

ENDPOINT = "OTEL_EXPORTER_OTLP_ENDPOINT"
"""Variable with the URL of an OTLP collector (HTTP), such as http://collector:4318."""

_tracer: Tracer | None = None


def start_tracing(service: str) -> None:
    """Send this process's spans to the collector of OTEL_EXPORTER_OTLP_ENDPOINT, if that is set.

    service  name of the process in the traces: capture2vr-gateway, capture2vr-edge
    Raises SettingsError where the packages are not installed.
    """
    if not os.environ.get(ENDPOINT):
        return
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
    except ImportError:
        raise SettingsError(f"{ENDPOINT} needs OpenTelemetry: pip install 'capture2vr[traces]'") from None
    trace_with(BatchSpanProcessor(OTLPSpanExporter()), service)


def trace_with(processor: SpanProcessor, service: str) -> TracerProvider:
    """Hand this process's spans to a processor. Returns the provider, whose `shutdown` sends what is left."""
    from opentelemetry.sdk.resources import Resource
    from opentelemetry.sdk.trace import TracerProvider

    global _tracer
    resource = Resource.create({"service.name": service, "service.version": capture2vr.__version__})
    provider = TracerProvider(resource=resource)
    provider.add_span_processor(processor)
    _tracer = provider.get_tracer("capture2vr", capture2vr.__version__)
    return provider


def stop_tracing() -> None:
    """Make no more spans in this process."""
    global _tracer
    _tracer = None


def trace_id(capture: str) -> str:
    """Return the id of a capture's trace: 32 hexadecimal digits."""
    return hashlib.sha256(capture.encode()).hexdigest()[:32]


@contextmanager
def capture_span(name: str, capture: str, **attributes: str | int | float) -> Iterator[None]:
    """Record the block as a span of a capture's trace; log lines in it carry capture and trace id. No capture: nothing.

    An exception ends the span as failed, with its type and text, and is passed on.
    """
    if _tracer is None or not capture:
        with log_fields(capture=capture):
            yield
        return
    from opentelemetry import trace

    root = trace.SpanContext(
        int(trace_id(capture), 16),
        int(hashlib.sha256(f"{capture} root".encode()).hexdigest()[:16], 16),
        is_remote=True,
        trace_flags=trace.TraceFlags(trace.TraceFlags.SAMPLED),
    )
    parent = trace.set_span_in_context(trace.NonRecordingSpan(root))
    facts = {"capture2vr.capture": capture, **{f"capture2vr.{each}": value for each, value in attributes.items()}}
    with (
        log_fields(capture=capture, trace_id=trace_id(capture)),
        _tracer.start_as_current_span(name, parent, attributes=facts),
    ):
        yield


class StageSpans:
    """Spans of the stages of a job, one after another, within the span that is current when this is made."""

    def __init__(self) -> None:
        self._current: Any = None
        self._stage = ""
        self._parent: Any = None
        if _tracer is not None:
            from opentelemetry import context

            self._parent = context.get_current()

    def enter(self, stage: str) -> None:
        """Begin the span of a stage and end that of the one before; nothing where it is the same stage."""
        if _tracer is None or stage == self._stage:
            return
        self.end()
        self._stage = stage
        self._current = _tracer.start_span(stage, self._parent)

    def end(self) -> None:
        """End the span of the last stage."""
        if self._current is not None:
            self._current.end()
        self._current, self._stage = None, ""


@contextmanager
def stage_spans() -> Iterator[StageSpans]:
    """Yield the spans of a job's stages; the last one ends with the block."""
    spans = StageSpans()
    try:
        yield spans
    finally:
        spans.end()
