"""Process that forks a process for every upload to be checked: `python -m services.gateway.uploads.check_server FD`.

Decoders of hostile bytes may crash, hang or eat memory, and run arbitrary code where they have a fault. So each check
has a process of its own, with limits and without the gateway's settings and secrets. Starting an interpreter would cost
each upload 0.2 s; this process has loaded everything, and a fork of it is there within milliseconds.

For each check the gateway sends two descriptors over the socket FD. The first is a socket, over which it sends the
order as one line of JSON, and then reads lines until the end: `{"file": NAME}` for each file that is begun, at most one
of `{"packed": …}`, `{"refused": …}`, `{"full": true}` (the disk), `{"costly": true}` (memory) and `{"failed": …}` (a
fault of ours), and `{"ended": STATUS}`. The second is a pipe: the check is killed when the gateway closes it.
"""

from __future__ import annotations

import errno
import gc
import json
import os
import resource
import selectors
import signal
import socket
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from services.gateway.uploads.check_and_pack import CheckOrder, check_and_pack
from services.gateway.uploads.image_checks import load_pillow
from services.gateway.uploads.refusal import Refused
from services.storage.archives import is_zip

# Of processor time, beside what files of this number and size may take: 12 megapixels are checked in 60 ms.
_LEAST_SECONDS, _SECONDS_PER_FILE, _SECONDS_PER_GB = 10.0, 0.02, 100.0
_ENTRY_BYTES = 100  # least of a file in a zip: its name, sizes and times, twice
_SLOWED = 4.0  # times as much of the clock, on a machine that does other work too; and a minute for a slow disk
_DISK_SECONDS = 60.0
_MOST_DATA_BYTES = 768 << 20  # of a checker, which needs 60 MB, and for a WebP or progressive JPEG of 24 MP 250 MB

_Send = Callable[[dict[str, Any]], None]


@dataclass(slots=True)
class _Check:
    """A running check: its process (None once it has ended), and the descriptors that this server has of it.

    ended  a pipe whose other end only the check has: it closes when that process ends, however it does
    """

    process: int | None
    channel: socket.socket
    leash: int
    ended: int

    def close(self) -> None:
        self.channel.close()
        os.close(self.leash)
        os.close(self.ended)

    def kill(self) -> None:
        if self.process is not None:
            os.kill(self.process, signal.SIGKILL)


class _Server:
    """Starts checks, ends those that are not wanted any more, and tells how each has ended."""

    def __init__(self, control: socket.socket) -> None:
        self._control = control
        self._checks: list[_Check] = []
        self._selector = selectors.DefaultSelector()
        self._selector.register(control, selectors.EVENT_READ)

    def run(self) -> None:
        """Serve until the gateway closes the control socket, then kill what runs."""
        while True:
            for key, _ in self._selector.select():
                if key.data is None:
                    if not self._receive():
                        for check in self._checks:
                            check.kill()
                        return
                elif key.fd == key.data.leash:
                    key.data.kill()
                    self._selector.unregister(key.fd)
                else:
                    self._report(key.data)

    def _receive(self) -> bool:
        """Start the check whose descriptors arrive; return False when the gateway has closed the socket."""
        message, descriptors, _, _ = socket.recv_fds(self._control, 1, 2)
        if not message:
            return False
        channel, leash = socket.socket(fileno=descriptors[0]), descriptors[1]
        ended, held = os.pipe()
        process = os.fork()
        if process == 0:
            self._leave(ended, leash)
            _run(channel)
            os._exit(0)
        os.close(held)
        check = _Check(process, channel, leash, ended)
        self._checks.append(check)
        for descriptor in (leash, ended):
            self._selector.register(descriptor, selectors.EVENT_READ, check)
        return True

    def _leave(self, *descriptors: int) -> None:
        """In a fork: close all that belongs to the server and to other checks."""
        self._selector.close()
        self._control.close()
        for descriptor in descriptors:
            os.close(descriptor)
        for check in self._checks:
            check.close()

    def _report(self, check: _Check) -> None:
        assert check.process is not None
        _, status = os.waitpid(check.process, 0)
        check.process = None
        for descriptor in (check.leash, check.ended):
            with suppress(KeyError):  # the leash has been closed before
                self._selector.unregister(descriptor)
        with suppress(OSError):  # nobody listens any more
            _send(check.channel, {"ended": os.waitstatus_to_exitcode(status)})
        self._checks.remove(check)
        check.close()


def serve(control: socket.socket) -> None:
    """Fork a process for each check that arrives over `control`, until the gateway closes it."""
    gc.freeze()  # else each fork's garbage collections would copy all pages
    _Server(control).run()


def _run(channel: socket.socket) -> None:
    """Read the order, set the limits that follow from it, check, and send the result."""
    with channel.makefile("r", encoding="utf-8") as lines:
        order = CheckOrder(**json.loads(lines.readline()))
    seconds = _allowed_seconds(order)
    _limit(seconds)
    signal.setitimer(signal.ITIMER_REAL, _SLOWED * seconds + _DISK_SECONDS)  # SIGALRM kills, also in native code
    with suppress(BrokenPipeError):  # the gateway has been killed
        _check(order, lambda message: _send(channel, message))


def _allowed_seconds(order: CheckOrder) -> float:
    """Return the processor time that the check may take."""
    paths = [Path(order.folder, "in", name) for name in order.names]
    size = sum(path.stat().st_size for path in paths)
    packed = min(order.most_files, size // _ENTRY_BYTES) if len(paths) == 1 and is_zip(paths[0]) else 0
    return _LEAST_SECONDS + _SECONDS_PER_FILE * max(len(paths), packed) + _SECONDS_PER_GB * size / 1e9


def _limit(seconds: float) -> None:
    """Limit this process's processor time and memory; a crash leaves no core file, which would hold the upload."""
    whole = int(seconds) + 1
    for kind, most in (
        (resource.RLIMIT_CPU, whole),
        (resource.RLIMIT_DATA, _MOST_DATA_BYTES),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(kind)[1]
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        # The hard limit of the processor time kills; the soft one, a second before it, says why.
        resource.setrlimit(kind, (most, most + 1 if kind == resource.RLIMIT_CPU and hard > most else most))


def _check(order: CheckOrder, send: _Send) -> None:
    """Check the upload and send the result, whatever it is."""
    try:
        packed = check_and_pack(order, lambda name: send({"file": name}))
        verdicts = [asdict(verdict) for verdict in packed.verdicts]
        send({"packed": {"sha256": packed.sha256, "verdicts": verdicts}})
    except Refused as refused:
        send({"refused": asdict(refused)})
    except MemoryError:
        send({"costly": True})
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        send({"full": True} if full else {"failed": traceback.format_exc()})
    except Exception:  # noqa: BLE001 - the gateway logs what it was
        send({"failed": traceback.format_exc()})


def _send(channel: socket.socket, message: dict[str, Any]) -> None:
    channel.sendall(json.dumps(message).encode() + b"\n")


if __name__ == "__main__":
    load_pillow()
    serve(socket.socket(fileno=int(sys.argv[1])))
