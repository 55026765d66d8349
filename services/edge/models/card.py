"""Table of the models that can be added: name, file, hash, licence, limits and shapes, read from models.toml."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from pydantic import ConfigDict, TypeAdapter

Shapes = dict[str, tuple[int, ...]]
"""Tensors of a graph by name, with their shapes."""

FREE = -1
"""A length in a shape that the graph leaves open: of an input it must be, of an output it may be."""


@dataclass(frozen=True, slots=True)
class NpmPackage:
    """A package of npm that a model's file is put together from.

    resource  the model's entry in the package's list of chunks
    notice    the model's entry in the package's notices of licences
    """

    package: str
    version: str
    resource: str
    notice: str

    __pydantic_config__ = ConfigDict(extra="forbid")

    def __str__(self) -> str:
        return f"{self.package} {self.version}"


@dataclass(frozen=True, slots=True)
class ModelCard:
    """A model as models.toml describes it, where the fields are explained."""

    name: str
    title: str
    file: str
    sha256: str
    bytes: int
    licence: str
    improves: str
    source: str
    most_bytes: int
    most_s: float
    inputs: Shapes
    outputs: Shapes
    npm: NpmPackage | None = None
    integers: tuple[str, ...] = ()

    __pydantic_config__ = ConfigDict(extra="forbid")


@cache
def model_cards() -> dict[str, ModelCard]:
    """Return all models of the table by name."""
    table = tomllib.loads((files("capture2vr.edge.models") / "models.toml").read_text(encoding="utf-8"))
    cards = TypeAdapter(tuple[ModelCard, ...]).validate_python([{"name": name, **row} for name, row in table.items()])
    return {card.name: card for card in cards}
