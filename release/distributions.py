"""Which distributions an installation of the product needs, and which extra brings each."""

from __future__ import annotations

import importlib.metadata
import re
import tomllib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from packaging.requirements import Requirement

PRODUCT = "capture2vr"
_NOT_FOR_USERS = {"dev", "bench", "docs"}
"""Extras for whoever works on the product."""


def product_extras(root: Path) -> tuple[str, ...]:
    """The extras that users install, as pyproject.toml has them."""
    extras = tomllib.loads((root / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    return tuple(extra for extra in extras if extra not in _NOT_FOR_USERS)


def brought_by(extras: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Normalised name -> the extras that bring it, none where the product always needs it."""
    always = required_distributions(PRODUCT, ())
    found: dict[str, tuple[str, ...]] = dict.fromkeys(always, ())
    for extra in extras:
        for name in required_distributions(PRODUCT, [extra]) - always:
            found[name] = (*found.get(name, ()), extra)
    del found[PRODUCT]
    return found


def required_distributions(name: str, extras: Iterable[str]) -> set[str]:
    """A distribution and all that it needs, theirs too, by normalised name."""
    found: dict[str, set[str]] = {}
    todo = [(normalised(name), set(extras))]
    while todo:
        name, wanted = todo.pop()
        if name in found and wanted <= found[name]:
            continue
        found.setdefault(name, set()).update(wanted)
        for requirement in _requirements(name):
            marker = requirement.marker
            if marker is None or any(marker.evaluate({"extra": extra}) for extra in (*found[name], "")):
                todo.append((normalised(requirement.name), set(requirement.extras)))
    return set(found)


@cache
def _requirements(name: str) -> tuple[Requirement, ...]:
    """What an installed distribution requires; of one that is not installed, nothing is known."""
    try:
        return tuple(map(Requirement, importlib.metadata.requires(name) or ()))
    except importlib.metadata.PackageNotFoundError:
        return ()


def normalised(name: str) -> str:
    """The name of a distribution as PEP 503 has it."""
    return re.sub(r"[-_.]+", "-", name).lower()
