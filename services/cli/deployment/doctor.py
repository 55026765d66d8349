"""`capture2vr doctor`: what this machine has, what is missing and what to do about it."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
from rich.table import Table
from rich.text import Text

from capture2vr.cli.deployment.required_packages import required_packages
from capture2vr.cli.progress import print_listing
from capture2vr.client.http import client_of

_EXTRAS = ("edge", "gateway", "storage")  # that `up` needs
_MIN_FREE_BYTES = 2 << 30  # a capture of 300 frames with its staging, bundle and store copy


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the table. `grade`: ok | note | bad; a note is worth knowing, a bad one stops something."""

    what: str
    grade: str
    said: str


def examine(gateway: str) -> int:
    """Print the table; exit code 1 when something is bad."""
    findings = [finding for check in _checks(gateway) for finding in check()]
    table = Table()
    for column in ("", "what", "found"):
        table.add_column(column, overflow="fold")
    styles = {"ok": "green", "note": "yellow", "bad": "red"}
    for finding in findings:
        table.add_row(Text(finding.grade, styles[finding.grade]), finding.what, finding.said)
    print_listing(table, fold=True)
    return int(any(finding.grade == "bad" for finding in findings))


def _checks(gateway: str) -> tuple[Callable[[], Iterator[Finding]], ...]:
    return _python, _libraries, _simplifier, _device, _presets, _disk, _storage, lambda: _gateway(gateway)


def _python() -> Iterator[Finding]:
    version = ".".join(map(str, sys.version_info[:3]))
    yield Finding("Python", "ok" if sys.version_info >= (3, 11) else "bad", f"{version}, {os.cpu_count()} cores")


def _libraries() -> Iterator[Finding]:
    for extra in _EXTRAS:
        packages = required_packages("capture2vr", extra)
        missing = ", ".join(str(package) for package in packages if not package.suits)
        if missing:
            yield Finding(f"extra '{extra}'", "bad", f"missing {missing}: pip install 'capture2vr[{extra}]'")
        else:
            yield Finding(f"extra '{extra}'", "ok", ", ".join(map(str, packages)))


def _simplifier() -> Iterator[Finding]:
    try:
        import meshoptimizer  # noqa: F401 - asked only whether it is there and loads
    except (ImportError, OSError):
        yield Finding(
            "LODs", "note", "fast-simplification; meshoptimizer is faster: pip install 'capture2vr[fast]' (C++)"
        )
    else:
        yield Finding("LODs", "ok", "meshoptimizer")


def _device() -> Iterator[Finding]:
    from capture2vr.edge.field.device import find_device

    device = find_device("auto")
    takes = "; an object trains in seconds here, a room in a minute or two" if device.name == "cpu" else ""
    yield Finding("device", "ok", device.description + takes)


def _presets() -> Iterator[Finding]:
    from capture2vr.edge.preset import preset_names

    yield Finding("presets", "ok", ", ".join(preset_names()))


def _disk() -> Iterator[Finding]:
    free = shutil.disk_usage(Path.cwd()).free
    grade = "ok" if free >= _MIN_FREE_BYTES else "bad"
    yield Finding("disk", grade, f"{free / 2**30:.1f} GiB free here")


def _storage() -> Iterator[Finding]:
    from capture2vr.storage.settings import StorageSettings, open_store

    try:
        settings = StorageSettings()
        if settings.kind == "local" and not settings.root.exists():  # opening it would make it
            yield Finding("storage", "note", f"local: {settings.root} is not there yet; it is made when it is needed")
            return
        open_store(settings).list("catalog/", limit=1)
    except Exception as error:  # noqa: BLE001 - whatever is wrong is exactly what the person wants to read
        yield Finding("storage", "bad", str(error))
    else:
        where = settings.root if settings.kind == "local" else f"{settings.endpoint or 'AWS'}, bucket {settings.bucket}"
        yield Finding("storage", "ok", f"{settings.kind}: {where}")


def _gateway(url: str) -> Iterator[Finding]:
    try:
        with client_of(url, timeout=httpx.Timeout(2.0)) as client:
            answer = client.get("/readyz")
    except (httpx.TransportError, httpx.InvalidURL):
        yield Finding("gateway", "note", f"nothing answers at {url}; start one with: capture2vr up")
        return
    yield Finding("gateway", "ok" if answer.is_success else "bad", f"{url}: {answer.text[:200]}")
