"""The signals that end a command: Ctrl-C, SIGTERM, and the end of its terminal."""

from __future__ import annotations

import signal
import sys


def stop_signals() -> tuple[signal.Signals, ...]:
    """Return the signals that end a command: Ctrl-C, SIGTERM, and the terminal's end unless nohup ignores it."""
    has_hangup = signal.getsignal(signal.SIGHUP) != signal.SIG_IGN
    return (signal.SIGINT, signal.SIGTERM, *((signal.SIGHUP,) if has_hangup else ()))


def exit_on_signals() -> None:
    """Handle SIGTERM and SIGHUP like Ctrl-C, so that every `with` block is left and cleaned up.

    Else the temporary copy of a capture would stay behind, or services would go on without their command.
    """
    for name in stop_signals():
        if name != signal.SIGINT:  # raises KeyboardInterrupt
            signal.signal(name, lambda number, _: sys.exit(128 + number))
