"""The command line: `capture2vr run | presets | up | push | pull | ls | rm | restore | catalogue | gateway`, …"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

import services
from services.cli.catalogue import app as catalogue
from services.cli.errors import BadInput, plain
from services.cli.options import DEFAULT_GATEWAY, Collection, Gateway, Trusted
from services.storage.catalogue import DEFAULT_COLLECTION

app = typer.Typer(
    help="Point a phone at a thing; a minute later it stands in a VR headset.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
app.add_typer(catalogue, name="catalogue")

Isolate = Annotated[
    bool | None,
    typer.Option(
        "--isolate/--whole", help="Remove the supporting plane and clutter; else photos of one thing are cut."
    ),
]
Longest = Annotated[
    float | None,
    typer.Option(min=0.001, max=1_000, help="Metres between the farthest points of the thing, if you measured it."),
]
Target = Annotated[
    str,
    typer.Option(
        help="quest3, quest2, web or archive: levels of detail that keep within its budget, or an error; quest3-unlit "
        "and so on: colours as captured, whatever light the scene has; quest3-ktx2 and quest3-unlit-ktx2: textures as "
        "KTX2, made by the encoder in EDGE_KTX2."
    ),
]


@app.command()
def run(
    capture: Annotated[Path, typer.Argument(help="Photos, a video, a point cloud, a mesh, an RGB-D folder, or a zip.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")],
    preset: Annotated[str, typer.Option(help="How to reconstruct; `presets` lists them. Else the points decide.")] = "",
    device: Annotated[str, typer.Option(help="Where to train: cpu, cuda, cuda:1, or auto.")] = "auto",
    resolution: Annotated[int, typer.Option(min=0, max=1024, help="Cells along the longest side; 0 chooses.")] = 0,
    isolate: Isolate = None,
    longest: Longest = None,
    target: Target = "",
    key: Annotated[str, typer.Option(help="Asset key; from the capture's name otherwise.")] = "",
    collection: Collection = DEFAULT_COLLECTION,
    reference: Annotated[Path | None, typer.Option(help="A mesh of the same thing to measure the result by.")] = None,
) -> None:
    """The whole pipeline in one process: capture in, meshes, picture, report and bundle out."""
    from services.cli.run import Wanted, run_capture

    wanted = Wanted(key, collection, isolate, longest, target, reference)
    run_capture(capture, out, wanted, preset=preset, device=device, resolution=resolution)


@app.command()
def presets() -> None:
    """What `--preset` may name, whether it trains, and the memory that it takes at most."""
    from services.cli.presets import list_presets

    list_presets()


@app.command()
def up(
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port of the gateway; 0 chooses a free one.")] = 8080,
    data: Annotated[Path, typer.Option(help="Folder of captures, jobs and assets.")] = Path("capture2vr-data"),
) -> None:
    """Gateway, worker and embedded store together, until interrupted."""
    from services.cli.up import serve_together

    raise typer.Exit(serve_together(host, port, data))


@app.command()
def push(
    capture: Annotated[Path, typer.Argument(help="What the phone would upload: a file, a folder or a zip.")],
    key: Annotated[str, typer.Option(help="Asset key under which the VR client will find it.")],
    gateway: Gateway = DEFAULT_GATEWAY,
    preset: Annotated[str, typer.Option(help="How to reconstruct; else the worker chooses.")] = "",
    label: Annotated[str, typer.Option(help="A name for people.")] = "",
    collection: Collection = "",
    isolate: Isolate = None,
    longest: Longest = None,
    target: Target = "",
) -> None:
    """Upload a capture as a phone would, follow the job, print where the asset stands."""
    from services.cli.push import push_capture

    options = {
        "preset": preset or None,
        "collection": collection or None,
        "isolate": isolate,
        "longest_m": longest,
        "target": target or None,
    }
    push_capture(capture, gateway, key=key, label=label, options=options)


@app.command()
def pull(
    key: Annotated[str, typer.Argument(help="Asset key.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the files.")],
    gateway: Gateway = DEFAULT_GATEWAY,
    collection: Collection = "",
    trusted: Trusted = None,
    cache: Annotated[Path | None, typer.Option(help="Cache folder; $XDG_CACHE_HOME/capture2vr otherwise.")] = None,
) -> None:
    """Fetch an asset as a VR client would, by its signed collection: every hash checked, files cached by content."""
    from services.cli.pull import pull_asset

    pull_asset(key, out, gateway, collection=collection, trusted=trusted or (), cache=cache)


@app.command()
def ls(
    gateway: Gateway = DEFAULT_GATEWAY,
    collection: Collection = DEFAULT_COLLECTION,
    label: Annotated[str, typer.Option(help="Part of the label, or one of the labels.")] = "",
) -> None:
    """The assets of a collection."""
    from services.cli.assets import list_assets

    list_assets(gateway, collection=collection, label=label)


@app.command()
def rm(
    key: Annotated[str, typer.Argument(help="Asset key.")],
    gateway: Gateway = DEFAULT_GATEWAY,
    collection: Collection = "",
) -> None:
    """Take an asset out of sight. Its files stay: `restore` or a new version brings it back."""
    from services.cli.assets import mark

    mark(key, gateway, "remove", collection=collection)


@app.command()
def restore(
    key: Annotated[str, typer.Argument(help="Asset key.")],
    gateway: Gateway = DEFAULT_GATEWAY,
    collection: Collection = "",
) -> None:
    """Bring a removed asset back as it was."""
    from services.cli.assets import mark

    mark(key, gateway, "restore", collection=collection)


@app.command()
def edge() -> None:
    """A worker alone, configured by EDGE_* and STORAGE_* variables.

    EDGE_CENTRAL=host:port: it makes the points, and the worker there fits the field and publishes to the same store.
    """
    from services.cli.serve import serve_edge

    raise typer.Exit(serve_edge())


@app.command()
def gateway() -> None:
    """A gateway alone, configured by GATEWAY_* and STORAGE_* variables."""
    from services.cli.serve import serve_gateway

    raise typer.Exit(serve_gateway())


@app.command()
def demo(
    capture: Annotated[Path | None, typer.Argument(help="Your own capture; a simulated one otherwise.")] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")] = Path("demo"),
    keep: Annotated[
        bool | None, typer.Option("--keep/--stop", help="Go on serving the viewer; in a terminal that is the default.")
    ] = None,
) -> None:
    """Everything once, on this machine, without a network: phone, gateway, worker, store, viewer."""
    from services.cli.demo import run_demo

    run_demo(capture, out, keep=sys.stdout.isatty() if keep is None else keep)


@app.command()
def doctor(gateway: Gateway = DEFAULT_GATEWAY) -> None:
    """What this machine has, what is missing, and what to do about it."""
    from services.cli.doctor import examine

    raise typer.Exit(examine(gateway))


@app.command()
def version() -> None:
    """Print the version."""
    typer.echo(services.__version__)


def main() -> None:
    """Entry point: bad input ends with one sentence on stderr and exit code 2, without a traceback."""
    try:
        app()
    except BadInput as error:
        typer.echo(f"capture2vr: {plain(str(error))}", err=True)
        sys.exit(2)
    except OSError as error:  # a disk that is full, a file that may not be read
        file = f"{plain(str(error.filename))}: " if error.filename else ""
        typer.echo(f"capture2vr: {file}{error.strerror or error}", err=True)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
