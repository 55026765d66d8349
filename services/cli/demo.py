"""`capture2vr demo`: a (simulated) phone, the gateway, the worker, the store and the viewer, all on this machine."""

from __future__ import annotations

import json
import signal
import sys
import threading
from pathlib import Path

from services.cli.progress import console
from services.cli.pull import pull_asset
from services.cli.push import push_capture
from services.cli.run import key_from
from services.cli.up import DEFAULT_PORT, Stack, is_free, running

_KEY = "demo-garment"
_PRESET = "draft"  # everything once within a minute; `capture2vr run` and `push` train


def run_demo(capture: Path | None, out: Path, *, keep: bool) -> None:
    """Push a capture through everything, leave PNG, meshes and report in `out`, end with the viewer's URL."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # leaves the stack, which stops it
    out.mkdir(parents=True, exist_ok=True)
    key = key_from(capture) if capture else _KEY
    source = capture or _simulated(out)
    with running("127.0.0.1", _port(), out / "data") as stack:
        cut = None if capture else True
        job = push_capture(source, stack.url, key=key, label=key, options={"preset": _PRESET, "isolate": cut})
        manifest = pull_asset(key, out / "asset", stack.url, cache=out / "cache")
        (out / "report.json").write_text(json.dumps({"job": job, "asset": manifest}, indent=2) + "\n")
        console.print(f"picture  {out / 'asset' / 'preview.png'}")
        console.print(f"report   {out / 'report.json'}")
        console.print(f"viewer   {stack.url}/view/{key}")
        if keep:
            _serve_until_interrupted(stack)
        else:
            console.print(f"to look at it: capture2vr up --data {out / 'data'}")


def _port() -> int:
    """The usual port, so that `up` serves the same address afterwards; any free one where it is taken."""
    return DEFAULT_PORT if is_free("127.0.0.1", DEFAULT_PORT) else 0


def _simulated(out: Path) -> Path:
    from services.cli.garment import garment_scene
    from services.cli.simulate import simulate_capture

    console.print("simulating a phone's walk around a garment")
    return simulate_capture(garment_scene(), out / "capture")


def _serve_until_interrupted(stack: Stack) -> None:
    stop = threading.Event()
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, lambda *_: stop.set())
    console.print("serving the viewer; Ctrl-C stops")
    while not stop.wait(0.5):
        stack.mend()
