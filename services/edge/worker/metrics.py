"""Prometheus metrics of a worker, served on a port of their own: jobs, stages, slots, memory, processor time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, Info, ProcessCollector, start_http_server

from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.worker.event_log import Ending

_STAGE_S = (0.1, 0.25, 0.5, 1, 2.5, 5, 10, 20, 40, 60, 120, 300, 600, 1800, 3600, 21600)


class WorkerMetrics:
    """The worker's counters, gauges and histograms, in a registry of its own. Used on the event loop only."""

    def __init__(self, *, version: str, device: str, slots: int, memory_bytes: int) -> None:
        """memory_bytes: what fits may take together; 0: not limited"""
        registry = self._registry = CollectorRegistry()
        ProcessCollector(registry=registry)  # resident memory, processor seconds, open files
        info = Info("capture2vr_worker", "Version and device", registry=registry)
        info.info({"version": version, "device": device})
        self._ended = Counter(
            "capture2vr_worker_jobs", "Runs that ended here: OK, or the failure's code", ["code"], registry=registry
        )
        self._stage_s = Histogram(
            "capture2vr_worker_stage_seconds",
            "Stages of runs that finished",
            ["stage"],
            buckets=_STAGE_S,
            registry=registry,
        )
        Gauge("capture2vr_worker_slots", "Jobs that may run at once", registry=registry).set(slots)
        self._busy = Gauge("capture2vr_worker_busy_slots", "Jobs that run", registry=registry)
        self._queued = Gauge("capture2vr_worker_queued", "Jobs that wait for a slot", registry=registry)
        self._draining = Gauge("capture2vr_worker_draining", "1 after SIGTERM: no jobs are taken", registry=registry)
        budget = Gauge("capture2vr_worker_memory_budget_bytes", "Memory of all fits together", registry=registry)
        budget.set(memory_bytes)
        self._expiries = Gauge(
            "capture2vr_certificate_expires_seconds",
            "When the first certificate in a file expires, since 1970",
            ["file"],
            registry=registry,
        )

    def show_expiries(self, expiries: Mapping[str, float]) -> None:
        """Show when certificates expire, in seconds since the epoch, by the settings that name their files."""
        for file, expires in expiries.items():
            self._expiries.labels(file).set(expires)

    def observe_end(self, ending: Ending) -> None:
        """Count a run that has ended, and record the seconds of its stages."""
        if isinstance(ending, pb.Failure):
            self._ended.labels(ending.code).inc()
            return
        self._ended.labels("OK").inc()
        for stage, seconds in ending.seconds.items():
            self._stage_s.labels(stage).observe(seconds)

    def show_load(self, *, busy: int, queued: int, draining: bool) -> None:
        """Show how many jobs run and wait now."""
        self._busy.set(busy)
        self._queued.set(queued)
        self._draining.set(draining)

    @contextmanager
    def serve(self, host: str, port: int) -> Iterator[int]:
        """Serve `GET /metrics` on a thread during the block; yields the port. Raises OSError."""
        server, thread = start_http_server(port, addr=host, registry=self._registry)
        try:
            yield int(server.server_address[1])
        finally:
            server.shutdown()
            server.server_close()
            thread.join()
