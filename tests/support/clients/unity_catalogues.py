"""Catalogues to write: what hypothesis makes up, and small ones by hand."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Callable

from hypothesis import strategies as st

from capture2vr.storage.unity.binary_writer import binary_catalogue
from capture2vr.storage.unity.json_reader import read_json_catalogue
from capture2vr.storage.unity.json_writer import json_catalogue
from capture2vr.storage.unity.listing import Listing
from capture2vr.storage.unity.locations import build_listing
from capture2vr.storage.unity.nouns import Asset, Catalogue, LodFile
from tests.support.clients.unity_binary_reader import read_binary_catalogue

FORMS = (0, 1, 2, 3)


def written(catalogue: Catalogue, form: int) -> bytes:
    """The catalogue as JSON (0) or in a binary version."""
    listing = build_listing(catalogue)
    return binary_catalogue(listing, version=form) if form else json_catalogue(listing)  # type: ignore[arg-type]


def reader(form: int) -> Callable[[bytes], Listing]:
    return read_binary_catalogue if form else read_json_catalogue


def lod(name: str, level: int = 0, size: int = 1000) -> LodFile:
    """A file whose hash nobody else has."""
    sha256 = hashlib.sha256(f"{name} {level}".encode()).hexdigest()
    return LodFile(level, f"assets/{name}/lod{level}.{sha256}.glb", sha256, size)


def asset(key: str = "dress", *labels: str, version: int = 1, levels: int = 3) -> Asset:
    return Asset(
        key, version, labels, tuple(lod(f"{zlib.crc32(key.encode())}", level, 1000 - level) for level in range(levels))
    )


def catalogue(*assets: Asset) -> Catalogue:
    return Catalogue("capture2vr/demo", assets)


def many(count: int) -> Catalogue:
    """What a large collection looks like."""
    return catalogue(*(asset(f"asset-{number:05d}", "clothes", f"owner-{number % 7}") for number in range(count)))


_text = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="{}/"), min_size=1, max_size=40)


@st.composite
def _assets(draw: st.DrawFn) -> tuple[Asset, ...]:
    keys = draw(st.lists(_text, unique=True, max_size=40))
    labels = st.lists(_text, unique=True, max_size=4).map(tuple)
    levels = st.lists(st.integers(0, 20), unique=True, min_size=1, max_size=4)
    return tuple(
        Asset(
            key,
            draw(st.integers(1, 999_999)),
            draw(labels),
            tuple(lod(f"a{number}", level, draw(st.integers(1, 2**32 - 1))) for level in draw(levels)),
        )
        for number, key in enumerate(keys)
    )


catalogues = st.builds(Catalogue, locator_id=_text | st.just(""), assets=_assets())


def in_order(assets: tuple[Asset, ...]) -> tuple[Asset, ...]:
    """As a catalogue gives them back: assets by key, labels by letters, files from the finest on."""
    return tuple(
        Asset(
            each.key,
            each.version,
            tuple(sorted(each.labels)),
            tuple(sorted(each.files, key=lambda file: file.level)),
        )
        for each in sorted(assets, key=lambda each: each.key)
    )
