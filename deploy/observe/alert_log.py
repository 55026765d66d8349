"""Writes the alerts that an Alertmanager sends to a file and to the log, one line of JSON each; no secret is needed.

`docker compose logs alert-log` shows them, or the file, of which one more of 10 MB is kept as `.1`.

    alert_log.py FILE [PORT]
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Lock
from typing import Any

_MOST_BYTES = 10_000_000  # of the file
_MOST_BODY = 1_000_000  # bytes of a message: a thousand alerts
_PORT = 9094


class AlertLog:
    """The file of alerts."""

    def __init__(self, path: Path) -> None:
        self._path, self._lock = path, Lock()

    def write(self, lines: list[str]) -> None:
        """Append lines, and wait for the disk. Raises OSError: the Alertmanager then sends them again."""
        with self._lock:
            if self._path.exists() and self._path.stat().st_size > _MOST_BYTES:
                self._path.replace(self._path.with_name(self._path.name + ".1"))
            with self._path.open("a", encoding="utf-8") as file:
                file.writelines(line + "\n" for line in lines)
                file.flush()
                os.fsync(file.fileno())


def lines_of(message: Any) -> Iterator[str]:
    """Yield the alerts of an Alertmanager's message as lines. Raises ValueError for what is no such message."""
    if not isinstance(message, dict) or not isinstance(message.get("alerts"), list):
        raise ValueError("no alerts")
    for alert in message["alerts"]:
        labels, notes = alert.get("labels", {}), alert.get("annotations", {})
        at = alert.get("endsAt" if alert.get("status") == "resolved" else "startsAt")
        first = {"at": at, "status": alert.get("status"), "alert": labels.get("alertname")}
        rest = {name: value for name, value in labels.items() if name != "alertname"}
        yield json.dumps({**first, "summary": notes.get("summary"), "runbook": notes.get("runbook"), **rest})


def handler_of(log: AlertLog) -> type[BaseHTTPRequestHandler]:
    """Return the class that answers requests."""

    class Handler(BaseHTTPRequestHandler):
        timeout = 10

        def do_POST(self) -> None:
            try:
                size = int(self.headers.get("Content-Length") or 0)
                if not 0 < size <= _MOST_BODY:
                    return self._answer(413)
                lines = list(lines_of(json.loads(self.rfile.read(size))))
                log.write(lines)
            except (ValueError, AttributeError):
                return self._answer(400)
            except OSError as error:
                print(f"alerts could not be written: {error}", file=sys.stderr, flush=True)
                return self._answer(503)
            for line in lines:
                print(line, flush=True)
            return self._answer(200)

        def do_GET(self) -> None:
            self._answer(200)

        def _answer(self, status: int) -> None:
            self.send_response(status)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            """Nothing: the alerts alone are logged."""

    return Handler


def main(path: str, port: str = str(_PORT)) -> None:
    """Serve until the process is stopped."""
    with ThreadingHTTPServer(("", int(port)), handler_of(AlertLog(Path(path)))) as server:
        server.serve_forever()


if __name__ == "__main__":
    main(*sys.argv[1:])
