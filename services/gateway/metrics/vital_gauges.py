"""Prometheus gauges of what a gateway depends on: its checks, disks, workers, copies of the database, certificates."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from prometheus_client import CollectorRegistry, Gauge

from capture2vr.gateway.database.disks import Disk


class VitalGauges:
    """The gauges that `Vitals` sets."""

    def __init__(self, registry: CollectorRegistry) -> None:
        self._ok = Gauge(
            "capture2vr_check_ok", "1 where store, database, disk or workers are ready", ["check"], registry=registry
        )
        self._seconds = Gauge("capture2vr_check_seconds", "Time of the last check", ["check"], registry=registry)
        self._free = Gauge("capture2vr_disk_free_bytes", "Space left on a disk", ["holds"], registry=registry)
        self._total = Gauge("capture2vr_disk_total_bytes", "Size of a disk", ["holds"], registry=registry)
        self._workers = Gauge("capture2vr_workers", "Workers by state: known, answering", ["state"], registry=registry)
        self._copies = Gauge(
            "capture2vr_copy_seconds",
            "When the last backup and snapshot of SQLite were made, and a drill restored one, since 1970; 0 for never",
            ["copy"],
            registry=registry,
        )
        self._expiries = Gauge(
            "capture2vr_certificate_expires_seconds",
            "When the first certificate in a file expires, since 1970",
            ["file"],
            registry=registry,
        )

    def show_checks(self, found: Mapping[str, tuple[bool, float]]) -> None:
        """Show whether each check was passed, and the seconds that it took."""
        for name, (is_ok, seconds) in found.items():
            self._ok.labels(name).set(is_ok)
            self._seconds.labels(name).set(seconds)

    def show_disks(self, disks: Iterable[Disk]) -> None:
        """Show the space on the disks."""
        for disk in disks:
            self._free.labels(disk.holds).set(disk.free_bytes)
            self._total.labels(disk.holds).set(disk.total_bytes)

    def show_workers(self, known: int, answering: int) -> None:
        """Show how many workers there are, and how many of them answer."""
        self._workers.labels("known").set(known)
        self._workers.labels("answering").set(answering)

    def show_copy(self, name: str, made: float) -> None:
        """Show when the last copy of a kind was made, since 1970; 0: never. name: backup, drill, snapshot"""
        self._copies.labels(name).set(made)

    def show_expiry(self, file: str, expires: float) -> None:
        """Show when a certificate expires, in seconds since the epoch. file: the setting that names its file"""
        self._expiries.labels(file).set(expires)
