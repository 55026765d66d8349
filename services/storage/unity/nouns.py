"""What goes into a catalogue: assets under keys, with labels and one GLB file per level of detail."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from services.storage.store import check_name

BASE_URL = "{Capture2vr.Catalogue.BaseUrl}"
"""Unity replaces braces by the static property that they name, on the device, so one catalogue serves any host."""

_NUMBER_LIMIT = 10**9  # of versions and levels; more than there ever are, and so the readers look at nine digits only
_SHA256 = re.compile(r"[0-9a-f]{64}")
_SIZE_LIMIT = 2**32  # bytes; the binary forms hold the size of a file in 32 bits
LABEL_LIMIT = 100
"""Labels of one asset; far above what people use, and it bounds the work that a hostile catalogue can make."""


@dataclass(frozen=True, slots=True)
class LodFile:
    """One level of detail, 0 the finest.

    url     below the base URL, without a slash in front; ends in `.<sha256>.glb`, as `content_name` makes it
    sha256  of the file, 64 lower-case hexadecimal digits
    size    of the file in bytes
    """

    level: int
    url: str
    sha256: str
    size: int


@dataclass(frozen=True, slots=True)
class Asset:
    """What Unity loads as `captures/<key>`. Labels are further keys, which many assets may share."""

    key: str
    version: int
    labels: tuple[str, ...]
    files: tuple[LodFile, ...]


@dataclass(frozen=True, slots=True)
class Catalogue:
    """The assets of one collection. Unity tells catalogues apart by the locator's id."""

    locator_id: str
    assets: tuple[Asset, ...]
    base_url: str = BASE_URL


def check(catalogue: Catalogue) -> Catalogue:
    """The catalogue itself. Raises ValueError for one that Unity would misread, with the asset's key in the text."""
    _check_text("the locator's id", catalogue.locator_id)
    _check_text("the base URL", catalogue.base_url)
    for asset in catalogue.assets:
        _check_asset(asset)
    return catalogue


def _check_asset(asset: Asset) -> None:
    _check_text("an asset's key", asset.key)
    if not asset.key or set(asset.key) & set("{}"):
        raise ValueError(f"{asset.key!r} is no key for Unity: it is empty or has braces, which Unity evaluates")
    if not 1 <= asset.version < _NUMBER_LIMIT:
        raise ValueError(f"asset {asset.key!r}: version {asset.version}; they count from 1")
    if len(asset.labels) > LABEL_LIMIT:
        raise ValueError(f"asset {asset.key!r} has {len(asset.labels)} labels; at most {LABEL_LIMIT}")
    for label in asset.labels:
        _check_text(f"a label of asset {asset.key!r}", label)
        if not label:
            raise ValueError(f"asset {asset.key!r} has an empty label")
    if not asset.files:
        raise ValueError(f"asset {asset.key!r} has no files, so there is nothing to show")
    _check_once(asset, "label", asset.labels)
    _check_once(asset, "level", [file.level for file in asset.files])
    for file in asset.files:
        _check_file(asset, file)


def _check_file(asset: Asset, file: LodFile) -> None:
    check_name(file.url)
    if not _SHA256.fullmatch(file.sha256):
        raise ValueError(f"asset {asset.key!r}: {file.sha256!r} is no SHA-256")
    if not file.url.endswith(f".{file.sha256}.glb"):
        raise ValueError(f"asset {asset.key!r}: {file.url} does not end in its SHA-256 and .glb")
    if not 0 < file.size < _SIZE_LIMIT or not 0 <= file.level < _NUMBER_LIMIT:
        raise ValueError(f"asset {asset.key!r}: level {file.level} of {file.size} bytes is impossible")


def _check_once(asset: Asset, name: str, values: Sequence[str | int]) -> None:
    if len(set(values)) < len(values):
        twice = next(value for value in values if values.count(value) > 1)
        raise ValueError(f"asset {asset.key!r} has the {name} {twice!r} twice")


def _check_text(what: str, text: str) -> None:
    """Half a surrogate pair has no UTF-8 and would stop the writers in the middle."""
    try:
        text.encode()
    except UnicodeEncodeError:
        raise ValueError(f"{what} is no Unicode text: {text!r}") from None
