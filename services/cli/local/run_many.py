"""`capture2vr run A B C -o FOLDER`: reconstruct several captures side by side, on this machine or on a Ray cluster."""

from __future__ import annotations

import io
import tarfile
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from capture2vr.cli.local.edge_settings import edge_settings, machine_room
from capture2vr.cli.local.run import RunOptions, check_place, check_writable, key_from, preset_of, run_capture
from capture2vr.cli.printable import printable
from capture2vr.cli.progress import StageBar, console
from capture2vr.client.earlier_results import is_run, remove_earlier
from capture2vr.edge.arrays import Tick
from capture2vr.edge.engine.address import open_engine
from capture2vr.edge.engine.nouns import Engine, Needs, Submitted, wait_for_all
from capture2vr.edge.errors import EdgeError
from capture2vr.errors import BadInput, sentence
from capture2vr.order.edits import NO_EDITS

_MEMORY_BYTES = 2 << 30  # of one capture: most of the bench's take less (tests/bench/results/pipeline.md)


def run_captures(sources: Sequence[Path], out: Path, options: RunOptions) -> bool:
    """Reconstruct each capture into a folder of `out` that has its asset key's name; return whether all ended well.

    One that cannot be reconstructed is named, and the others go on. Raises BadInput.
    """
    preset_of(options)  # a name that there is not is told at once
    places = _places(sources, out, options)
    settings = edge_settings()
    try:
        with open_engine(settings.engine, machine_room()) as engine:
            tasks = {out / key: _submit(engine, source, replace(options, key=key)) for key, source in places.items()}
            with StageBar() as bar:
                wait_for_all(list(tasks.values()), lambda done: bar.show("RUNNING", done, f"{len(tasks)} captures"))
            written = [_write(place, task) for place, task in tasks.items()]
        return all(written)
    except EdgeError as error:
        raise BadInput(sentence(error.message, hints=error.hints)) from error


def reconstruct_packed(tick: Tick, packed: bytes, options: RunOptions) -> bytes:
    """Reconstruct a capture that is packed in a tar, on any machine; return its results as a tar. Raises BadInput."""
    console.quiet = True  # who waits for the result shows the progress
    with tempfile.TemporaryDirectory(prefix="capture2vr-") as scratch:
        source, out = Path(scratch, "source"), Path(scratch, "out")
        with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
            archive.extractall(source, filter="data")
        (capture,) = source.iterdir()
        run_capture(capture, out, options, tick=tick)
        return _pack(out, "")


def _places(sources: Sequence[Path], out: Path, options: RunOptions) -> dict[str, Path]:
    """Return the captures by their keys. Raises BadInput, so that nothing is found out after an hour."""
    if options.key or options.reference or options.job.box or options.job.edits != NO_EDITS:
        raise BadInput("--key, --reference, --box and --edits are of one capture: leave them out, or name one capture")
    places: dict[str, Path] = {}
    for source in sources:
        if not source.exists():
            raise BadInput(f"{source}: there is no such file or folder")
        if not source.is_file() and not source.is_dir():
            raise BadInput(f"{source} is neither a file nor a folder")
        key = key_from(source)
        if key in places:
            raise BadInput(f"{places[key]} and {source} would both be written to {out / key}: rename one of them")
        if (out / key).exists() and not is_run(out / key):
            raise BadInput(f"{out / key} exists and is no result of `capture2vr run`: name another folder with -o")
        check_place(out / key, source)
        places[key] = source
    check_writable(out)
    return places


def _submit(engine: Engine, source: Path, options: RunOptions) -> Submitted[bytes]:
    needs = Needs(cpus=1, gpus=1 if options.device.startswith("cuda") else 0, memory_bytes=_MEMORY_BYTES)
    packed = _pack(source, source.resolve().name)
    return engine.submit(needs, reconstruct_packed, packed, options)


def _pack(path: Path, name: str) -> bytes:
    """Return a file or folder as a tar, in which it has this name.

    A link that names it is followed. Links and devices inside of it are left out: nobody who reads a capture opens one.
    """
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w") as archive:
        archive.add(path.resolve(), name, filter=lambda info: None if info.issym() or info.isdev() else info)
    return packed.getvalue()


def _write(place: Path, task: Submitted[bytes]) -> bool:
    """Write a capture's results, or say why there are none; return whether there are."""
    try:
        packed = task.result(0)
    except (BadInput, EdgeError) as error:
        console.print(f"{printable(place.name)}: {printable(str(error))}", style="red", markup=False)
        return False
    remove_earlier(place)
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        archive.extractall(place, filter="data")
    console.print(f"{printable(place.name)}: report {place / 'report.html'}", markup=False)
    return True
