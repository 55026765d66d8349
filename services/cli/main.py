"""Commands and options of the command line `capture2vr` (Typer). A command imports its implementation when it runs."""

from __future__ import annotations

import sys
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

import typer

import capture2vr
from capture2vr.cli.backups.backup import app as backup
from capture2vr.cli.deployment.deploy import app as deploy
from capture2vr.cli.gateway import app as gateway
from capture2vr.cli.local.models import app as models
from capture2vr.cli.options import (
    DEFAULT_GATEWAY,
    Box,
    Collection,
    Columns,
    CutOption,
    Description,
    EditsFile,
    FillOption,
    Gateway,
    Label,
    Longest,
    Open,
    PresetHere,
    PresetThere,
    PublishAnyway,
    Tags,
    TargetOption,
    Trusted,
    UnitOption,
    VisibilityOption,
    parse_box,
    parse_columns,
    read_edits,
)
from capture2vr.cli.printable import printable
from capture2vr.cli.remote.catalogue import app as catalogue
from capture2vr.cli.remote.keys import app as keys
from capture2vr.cli.remote.shares import app as shares
from capture2vr.errors import BadInput
from capture2vr.order.asset_names import AssetNames
from capture2vr.order.download_formats import FORMATS
from capture2vr.order.job_options import JobOptions
from capture2vr.process.strict_settings import SettingsError
from capture2vr.storage.catalogue.entry import DEFAULT_COLLECTION

app = typer.Typer(
    help="Turn phone captures (photos, video, scans) into 3D meshes for VR.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
app.add_typer(backup, name="backup")
app.add_typer(catalogue, name="catalogue")
app.add_typer(deploy, name="deploy")
app.add_typer(gateway, name="gateway")
app.add_typer(keys, name="keys")
app.add_typer(models, name="models")
app.add_typer(shares, name="shares")

_DAY = ["%Y-%m-%d"]


FormatOption = Annotated[str, typer.Option("--format", help=f"Format of the file: {', '.join(FORMATS)}.")]


@app.command()
def run(
    captures: Annotated[
        list[Path],
        typer.Argument(
            help="Photos, a video, a point cloud, a mesh, an RGB-D folder, or a zip. Of several each gets a folder in "
            "--out, and they run side by side, on this machine or on the cluster EDGE_ENGINE=ray://host:port."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")],
    preset: PresetHere = "",
    device: Annotated[str, typer.Option(help="Device for training: cpu, cuda, cuda:1, or auto.")] = "auto",
    resolution: Annotated[
        int, typer.Option(min=0, max=1024, help="Grid cells along the longest side; 0: automatic.")
    ] = 0,
    cut: CutOption = None,
    columns: Columns = "",
    unit: UnitOption = None,
    longest: Longest = None,
    fill: FillOption = None,
    box: Box = "",
    edits: EditsFile = None,
    target: TargetOption = "",
    key: Annotated[str, typer.Option(help="Asset key. Default: made from the capture's name.")] = "",
    collection: Collection = DEFAULT_COLLECTION,
    reference: Annotated[
        Path | None, typer.Option(help="A mesh of the same object, to measure the result's error.")
    ] = None,
) -> None:
    """Reconstruct captures without servers: writes meshes, pictures and a report to a folder.

    Exit code 1 if some of several captures could not be reconstructed.
    """
    from capture2vr.cli.local.edge_settings import edge_settings, machine_room
    from capture2vr.cli.local.run import RunOptions, run_capture
    from capture2vr.cli.stop_signals import exit_on_signals
    from capture2vr.edge.engine.address import engine_for_parts

    exit_on_signals()
    job = JobOptions(
        preset=preset,
        target=target,
        cut=cut or "",
        fill=fill or "",
        columns=parse_columns(columns),
        unit=unit or "",
        longest_m=longest,
        box=parse_box(box),
        edits=read_edits(edits),
        collection=collection,
    )
    options = RunOptions(job, key=key, reference=reference, device=device, resolution=resolution)
    if len(captures) == 1:
        run_capture(captures[0], out, options, engine=engine_for_parts(edge_settings().engine, machine_room()))
        return
    from capture2vr.cli.local.run_many import run_captures

    if not run_captures(captures, out, options):
        raise typer.Exit(1)


@app.command()
def presets() -> None:
    """List the presets: whether each trains, and how much memory it takes at most."""
    from capture2vr.cli.local.presets import list_presets

    list_presets()


@app.command()
def up(
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65_535, help="Port of the gateway; 0: any free port.")] = 8080,
    data: Annotated[Path, typer.Option(help="Folder for captures, jobs and assets.")] = Path("capture2vr-data"),
    everybody: Open = False,
) -> None:
    """Run a gateway, a worker and a local store together, until interrupted.

    Only this machine reaches it, and everybody on it is let in until `capture2vr keys create` has created a key. With
    --host others reach it too, which needs a key, or --open.
    """
    from capture2vr.cli.up import serve_together

    raise typer.Exit(serve_together(host, port, data, everybody=everybody))


@app.command()
def push(
    capture: Annotated[Path, typer.Argument(help="The capture: a file, a folder or a zip.")],
    key: Annotated[str, typer.Option(help="Asset key by which VR clients find the asset.")] = "",
    continued: Annotated[
        str,
        typer.Option(
            "--continue",
            help="Instead of --key: the key of an asset that was made from photos. The photos are added to those, and "
            "the next version is made with the options of the last one; only --cut and --edits may differ.",
        ),
    ] = "",
    gateway: Gateway = DEFAULT_GATEWAY,
    preset: PresetThere = "",
    label: Label = "",
    description: Description = "",
    tag: Tags = None,
    collection: Collection = "",
    cut: CutOption = None,
    columns: Columns = "",
    unit: UnitOption = None,
    longest: Longest = None,
    fill: FillOption = None,
    box: Box = "",
    edits: EditsFile = None,
    target: TargetOption = "",
    visibility: VisibilityOption = None,
    publish_anyway: PublishAnyway = False,
) -> None:
    """Upload a capture to a gateway, follow the job until it has ended, and print the asset's URL."""
    from capture2vr.cli.remote.push import continue_capture, push_capture
    from capture2vr.cli.stop_signals import exit_on_signals

    exit_on_signals()
    options = JobOptions(
        preset=preset,
        target=target,
        cut=cut or "",
        fill=fill or "",
        columns=parse_columns(columns),
        unit=unit or "",
        longest_m=longest,
        box=parse_box(box),
        edits=read_edits(edits),
        names=AssetNames(label, description, tuple(tag or ())),
        collection=collection,
        visibility=visibility or "",
        publish_anyway=publish_anyway,
    )
    if bool(key) == bool(continued):
        raise BadInput("name the asset: --key for a new capture, or --continue to add photos to an earlier one")
    if not continued:
        push_capture(capture, gateway, key=key, options=options)
        return
    if others := [name for name in options.given if name not in ("cut", "edits")]:
        raise BadInput(f"--continue goes with --cut and --edits alone; the earlier job says {', '.join(others)}")
    continue_capture(capture, gateway, key=continued, cut=cut, edits=options.edits if edits else None)


@app.command()
def pull(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the files.")],
    key: Annotated[str, typer.Argument(help="Asset key; not needed with the share link of an asset.")] = "",
    gateway: Gateway = DEFAULT_GATEWAY,
    collection: Collection = "",
    trusted: Trusted = None,
    cache: Annotated[
        Path | None, typer.Option(help="Cache folder. Default: $XDG_CACHE_HOME/capture2vr or ~/.cache/capture2vr.")
    ] = None,
    share: Annotated[
        str, typer.Option(help="A share link, https://…/s/…; its password, if any, in CAPTURE2VR_SHARE_PASSWORD.")
    ] = "",
) -> None:
    """Download an asset from a gateway, checking the collection's signature and every hash. Files are cached."""
    from capture2vr.cli.remote.pull import pull_asset

    pull_asset(key, out, gateway, collection=collection, trusted=trusted or (), cache=cache, share=share)


@app.command()
def download(
    key: Annotated[str, typer.Argument(help="Asset key; not needed with the share link of an asset.")] = "",
    format_name: FormatOption = "glb",
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="File, or folder. Default: KEY and the format's ending.")
    ] = None,
    version: Annotated[
        int | None, typer.Option(min=1, help="Number of an earlier version; the default name then ends in -vNUMBER.")
    ] = None,
    gateway: Gateway = DEFAULT_GATEWAY,
    share: Annotated[
        str, typer.Option(help="A share link, https://…/s/…; its password, if any, in CAPTURE2VR_SHARE_PASSWORD.")
    ] = "",
) -> None:
    """Download an asset from a gateway in the format of another program. It is made there if nobody asked before."""
    from capture2vr.cli.remote.download_format import download_format

    download_format(key, format_name, out, gateway, version=version, share=share)


@app.command()
def convert(
    folder: Annotated[Path, typer.Argument(help="Folder that `run` or `pull` has written.")],
    format_name: FormatOption = "glb",
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="File to write. Default: in the folder, by the asset's key.")
    ] = None,
) -> None:
    """Convert results on this machine to the format of another program."""
    from capture2vr.cli.local.convert import convert_folder

    convert_folder(folder, format_name, out)


@app.command()
def ls(
    gateway: Gateway = DEFAULT_GATEWAY,
    collection: Collection = DEFAULT_COLLECTION,
    label: Annotated[str, typer.Option(help="List only assets with this text in the label, or as a label.")] = "",
    state: Annotated[Literal["", "preview", "refined"], typer.Option(help="List only assets in this state.")] = "",
    since: Annotated[
        datetime | None, typer.Option(formats=_DAY, help="List only what changed on this day or later.")
    ] = None,
    until: Annotated[
        datetime | None, typer.Option(formats=_DAY, help="List only what changed on this day or earlier.")
    ] = None,
    min_mb: Annotated[float | None, typer.Option(min=0, help="List only assets of so many megabytes or more.")] = None,
    max_mb: Annotated[float | None, typer.Option(min=0, help="List only assets of so many megabytes or less.")] = None,
) -> None:
    """List the assets of a collection."""
    from capture2vr.cli.remote.assets import AssetFilter, list_assets

    wanted = AssetFilter(label, state, since, until, min_mb, max_mb)
    list_assets(gateway, collection=collection, wanted=wanted)


@app.command()
def rm(
    key: Annotated[str, typer.Argument(help="Asset key.")],
    gateway: Gateway = DEFAULT_GATEWAY,
    collection: Collection = "",
) -> None:
    """Remove (hide) an asset. Its files are kept: `restore` or a new version brings it back."""
    from capture2vr.cli.remote.assets import set_removed

    set_removed(key, gateway, "remove", collection=collection)


@app.command()
def restore(
    key: Annotated[str, typer.Argument(help="Asset key.")],
    gateway: Gateway = DEFAULT_GATEWAY,
    collection: Collection = "",
) -> None:
    """Restore a removed asset as it was."""
    from capture2vr.cli.remote.assets import set_removed

    set_removed(key, gateway, "restore", collection=collection)


@app.command()
def keep(
    key: Annotated[str, typer.Argument(help="Asset key.")],
    version: Annotated[
        int | None, typer.Option(min=1, help="Number of the version. Default: the newest that is held back.")
    ] = None,
    gateway: Gateway = DEFAULT_GATEWAY,
) -> None:
    """Publish a version that was held back because its grade says to shoot again."""
    from capture2vr.cli.remote.assets import keep as keep_held

    keep_held(key, gateway, version=version)


@app.command()
def name(
    key: Annotated[str, typer.Argument(help="Asset key.")],
    label: Annotated[str | None, typer.Option(help="A name for people; empty: the key.")] = None,
    description: Annotated[str | None, typer.Option(help="Some lines about the asset; empty: none.")] = None,
    tag: Tags = None,
    no_tags: Annotated[bool, typer.Option("--no-tags", help="Remove all tags.")] = False,
    gateway: Gateway = DEFAULT_GATEWAY,
) -> None:
    """Change what people call an asset. What is not named stays; the tags that are named replace those it has."""
    from capture2vr.cli.remote.names import change_names

    change_names(key, gateway, label=label, description=description, labels=[] if no_tags else tag)


@app.command()
def notes(
    key: Annotated[str, typer.Argument(help="Asset key.")],
    add: Annotated[str, typer.Option(help="Text of a note to pin, at most 500 characters; with --at.")] = "",
    at: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="X Y Z", help="Its place in the asset frame: metres, Y up, from the floor under the asset."
        ),
    ] = None,
    remove: Annotated[str, typer.Option(metavar="NOTE", help="Id of a note to remove.")] = "",
    gateway: Gateway = DEFAULT_GATEWAY,
) -> None:
    """List the notes that are pinned to an asset; pin one, or remove one."""
    from capture2vr.cli.remote.notes import change_notes

    change_notes(key, gateway, add=add, at=at, remove=remove)


@app.command()
def visibility(
    name: Annotated[str, typer.Argument(help="Asset key, or with --collection the name of a collection.")],
    who: Annotated[
        Literal["private", "unlisted", "public", "inherited"],
        typer.Argument(
            help="Who may read it besides its tenant. private: nobody; unlisted: whoever has its address; public: "
            "everybody, and public collections list it; inherited: as its collection."
        ),
    ],
    collection: Annotated[bool, typer.Option("--collection", help="NAME is a collection.")] = False,
    gateway: Gateway = DEFAULT_GATEWAY,
) -> None:
    """Set who may read an asset or a collection. Files that others have downloaded stay with them."""
    from capture2vr.cli.remote.visibility import set_visibility

    set_visibility(name, who, gateway, is_collection=collection)


@app.command()
def edge() -> None:
    """Run a worker alone, configured by the environment variables EDGE_* and STORAGE_*.

    With EDGE_CENTRAL=host:port it only makes the points; the worker at that address trains the field, and publishes to
    the same store.
    """
    from capture2vr.edge.__main__ import start

    raise typer.Exit(start())


@app.command()
def demo(
    capture: Annotated[Path | None, typer.Argument(help="Your own capture. Default: a simulated one.")] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")] = Path("demo"),
    keep: Annotated[
        bool | None,
        typer.Option("--keep/--stop", help="Go on serving the viewer, or stop. Default: go on if run in a terminal."),
    ] = None,
) -> None:
    """Run the whole system once on this machine, without a network: simulated phone, gateway, worker, store, viewer."""
    from capture2vr.cli.demonstration.demo import run_demo

    run_demo(capture, out, keep=sys.stdout.isatty() if keep is None else keep)


@app.command()
def doctor(gateway: Gateway = DEFAULT_GATEWAY) -> None:
    """Check this machine: what is installed, what is missing, and what to do about it."""
    from capture2vr.cli.deployment.doctor import examine

    raise typer.Exit(examine(gateway))


@app.command()
def version() -> None:
    """Print the version of capture2vr."""
    typer.echo(capture2vr.__version__)


def main() -> None:
    """Run the command line. Errors that the user can fix end with one line on stderr and exit code 2, no traceback."""
    try:
        app()
    except (BadInput, SettingsError) as error:
        typer.echo(f"capture2vr: {printable(str(error))}", err=True)
        sys.exit(2)
    except UnicodeEncodeError as error:  # words for people that a terminal of another encoding has sent
        around = error.object[max(0, error.start - 20) : error.end + 20]
        typer.echo(f"capture2vr: '{printable(around)}' is not UTF-8: type it in a terminal that is", err=True)
        sys.exit(2)
    except OSError as error:  # e.g. the disk is full, or a file cannot be read
        file = f"{printable(str(error.filename))}: " if error.filename else ""
        typer.echo(f"capture2vr: {file}{error.strerror or error}", err=True)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
