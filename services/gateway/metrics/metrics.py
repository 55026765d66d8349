"""Prometheus metrics. Each app has a registry of its own, so that two apps in one process count separately."""

from __future__ import annotations

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, disable_created_metrics, generate_latest

from capture2vr.gateway.metrics.job_metrics import JobMetrics
from capture2vr.gateway.metrics.vital_gauges import VitalGauges

_REQUEST_S = (0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 10, 60)  # few: each is a line for every route of every scrape
_LAG_S = (0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 30)


class Metrics:
    """The gateway's counters, gauges and histograms. jobs, vitals: those of jobs, and of what the gateway depends on"""

    def __init__(self) -> None:
        # A line for each counter, which Prometheus does not use, and which takes a tenth of the time.
        disable_created_metrics()  # type: ignore[no-untyped-call]
        self._registry = CollectorRegistry()
        registry = self._registry
        self._requests = Counter(
            "capture2vr_http_requests", "Answers by route and status", ["method", "route", "status"], registry=registry
        )
        self._request_s = Histogram(
            "capture2vr_http_request_seconds",
            "Time to the end of the answer; event streams not counted",
            ["route"],
            buckets=_REQUEST_S,
            registry=registry,
        )
        self._upload_bytes = Counter("capture2vr_upload_bytes", "Bytes of request bodies received", registry=registry)
        self._webhooks = Counter(
            "capture2vr_webhook_attempts", "Attempts to send a webhook message", ["outcome"], registry=registry
        )
        self._connections = Counter(
            "capture2vr_connections_refused",
            "Connections closed before there was a request",
            ["reason"],
            registry=registry,
        )
        self._damaged = Counter(
            "capture2vr_damaged_objects",
            "Times that a damaged object of the store was met: a catalogue entry, a receipt or a file",
            ["kind"],
            registry=registry,
        )
        self._scrub_damaged = Gauge(
            "capture2vr_scrub_damaged_files", "Files of assets that the last scrub found damaged", registry=registry
        )
        self._scrub_ended = Gauge(
            "capture2vr_scrub_ended_seconds", "When the last scrub ended, since 1970; 0 for never", registry=registry
        )
        self._lag_s = Histogram(
            "capture2vr_event_lag_seconds",
            "Event written to event sent",
            buckets=_LAG_S,
            registry=registry,
        )
        self.jobs = JobMetrics(registry)
        self.vitals = VitalGauges(registry)
        self._listeners = Gauge("capture2vr_event_listeners", "Open event streams", registry=registry)

    def observe_response(
        self, method: str, route: str, status: int, seconds: float, received: int, streamed: bool
    ) -> None:
        """Record a complete answer. received: bytes of the request's body; streamed: an event stream, not timed"""
        self._requests.labels(method, route, str(status)).inc()
        self._upload_bytes.inc(received)
        if not streamed:
            self._request_s.labels(route).observe(seconds)

    def observe_event_lag(self, lag_s: float) -> None:
        """Record the seconds between the writing of a live event and its sending."""
        self._lag_s.observe(max(0.0, lag_s))

    def observe_webhook(self, outcome: str) -> None:
        """Count an attempt to send a webhook message. outcome: delivered, failed or gone"""
        self._webhooks.labels(outcome).inc()

    def observe_refused_connection(self, code: str) -> None:
        """Count a connection that was closed before there was a request, for the reason with this code."""
        self._connections.labels(code).inc()

    def observe_damage(self, kind: str, count: int = 1) -> None:
        """Count damaged objects of the store that were met. kind: entry, receipt or file"""
        self._damaged.labels(kind).inc(count)

    def show_scrub(self, damaged: int, ended: float) -> None:
        """Show the result of the last scrub, and when it ended in seconds since the epoch."""
        self._scrub_damaged.set(damaged)
        self._scrub_ended.set(ended)

    def render(self, listeners: int) -> bytes:
        """Return the metrics in Prometheus' text format."""
        self._listeners.set(listeners)
        return generate_latest(self._registry)
