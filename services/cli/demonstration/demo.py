"""`capture2vr demo`: run gateway, worker and store on this machine, and reconstruct a (simulated) phone capture."""

from __future__ import annotations

import json
import signal
import threading
from pathlib import Path

from capture2vr.cli.local.run import check_place, key_from
from capture2vr.cli.progress import console
from capture2vr.cli.remote.pull import pull_asset
from capture2vr.cli.remote.push import push_capture
from capture2vr.cli.stop_signals import exit_on_signals, stop_signals
from capture2vr.cli.up import DEFAULT_PORT, Stack, is_free, run_stack
from capture2vr.order.job_options import JobOptions

_KEY = "demo-garment"
_PRESET = "draft"  # no training, so that the demo takes less than a minute


def run_demo(capture: Path | None, out: Path, *, keep: bool) -> None:
    """Reconstruct a capture with a stack of its own; write picture, meshes and report to `out`; print the viewer's URL.

    capture  the user's capture; None: simulate one
    keep     whether to go on serving the viewer until interrupted
    """
    if capture:
        check_place(out, capture)
    exit_on_signals()  # and stop the stack
    out.mkdir(parents=True, exist_ok=True)
    key = key_from(capture) if capture else _KEY
    with run_stack("127.0.0.1", _port(), out / "data", wait=False) as stack:
        source = capture or _simulate_capture(out)  # while the services start
        stack.wait_ready()
        options = JobOptions(preset=_PRESET, cut="auto" if capture else "object")
        job = push_capture(source, stack.url, key=key, options=options)
        manifest = pull_asset(key, out / "asset", stack.url, cache=out / "cache")
        (out / "report.json").write_text(json.dumps({"job": job, "asset": manifest}, indent=2) + "\n")
        console.print(f"picture  {out / 'asset' / 'preview.png'}")
        console.print(f"report   {out / 'report.json'}")
        console.print(f"viewer   {stack.url}/view/{key}")
        if keep:
            _serve_until_interrupted(stack)
        else:
            console.print(f"to view it: capture2vr up --data {out / 'data'}")


def _port() -> int:
    """Return the default port, so that `up` serves the same URL afterwards; 0 (any free port) where it is in use."""
    return DEFAULT_PORT if is_free("127.0.0.1", DEFAULT_PORT) else 0


def _simulate_capture(out: Path) -> Path:
    from capture2vr.cli.demonstration.demo_garment import garment_scene
    from capture2vr.cli.demonstration.demo_phone import simulate_capture

    console.print("simulating a phone's walk around a garment")
    return simulate_capture(garment_scene(), out / "capture")


def _serve_until_interrupted(stack: Stack) -> None:
    stop = threading.Event()
    for name in stop_signals():
        signal.signal(name, lambda *_: stop.set())
    console.print("serving the viewer; press Ctrl-C to stop")
    while not stop.wait(0.5):
        stack.restart_dead()
