"""Assets as a Unity Addressables catalogue lists them: key, labels, and one GLB file per level of detail."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from capture2vr.storage.bundle import is_sha256
from capture2vr.storage.store import check_name

BASE_URL = "{Capture2vr.Catalogue.BaseUrl}"
"""Unity replaces braces on the device by the static property that they name, so one catalogue works for any host."""

_NUMBER_LIMIT = 10**9  # of versions and levels: more than there ever are, so readers need to accept only nine digits
_SIZE_LIMIT = 2**32  # bytes; the binary forms hold the size of a file in 32 bits
LABEL_LIMIT = 100
"""Most labels of one asset: far more than people use; it limits the work that a hostile catalogue can cause."""


@dataclass(frozen=True, slots=True)
class LodFile:
    """One level of detail, 0 the finest.

    url     relative to the base URL, without a leading slash; ends in `.<sha256>.glb`, as made by `content_name`
    sha256  of the file, 64 lower-case hexadecimal digits
    size    of the file in bytes
    """

    level: int
    url: str
    sha256: str
    size: int


@dataclass(frozen=True, slots=True)
class Asset:
    """An asset, which Unity loads as `captures/<key>`. Labels are further keys, which several assets may share."""

    key: str
    version: int
    labels: tuple[str, ...]
    files: tuple[LodFile, ...]


@dataclass(frozen=True, slots=True)
class Catalogue:
    """The assets of one collection. Unity distinguishes catalogues by the locator's id."""

    locator_id: str
    assets: tuple[Asset, ...]
    base_url: str = BASE_URL


def check_catalogue(catalogue: Catalogue) -> Catalogue:
    """Return the catalogue unchanged. Raises ValueError, naming the asset's key, for one that Unity would misread."""
    _check_text("the locator's id", catalogue.locator_id)
    _check_text("the base URL", catalogue.base_url)
    for asset in catalogue.assets:
        _check_asset(asset)
    return catalogue


def _check_asset(asset: Asset) -> None:
    _check_text("an asset's key", asset.key)
    if not asset.key or set(asset.key) & set("{}"):
        raise ValueError(f"{asset.key!r} is not a key for Unity: it is empty or has braces, which Unity evaluates")
    if not 1 <= asset.version < _NUMBER_LIMIT:
        raise ValueError(f"asset {asset.key!r} has version {asset.version}; versions count from 1")
    if len(asset.labels) > LABEL_LIMIT:
        raise ValueError(f"asset {asset.key!r} has {len(asset.labels)} labels; at most {LABEL_LIMIT} are allowed")
    for label in asset.labels:
        _check_text(f"a label of asset {asset.key!r}", label)
        if not label:
            raise ValueError(f"asset {asset.key!r} has an empty label")
    if not asset.files:
        raise ValueError(f"asset {asset.key!r} has no files; it needs a GLB for at least one level of detail")
    _check_once(asset, "label", asset.labels)
    _check_once(asset, "level", [file.level for file in asset.files])
    for file in asset.files:
        _check_file(asset, file)


def _check_file(asset: Asset, file: LodFile) -> None:
    check_name(file.url)
    if not is_sha256(file.sha256):
        raise ValueError(f"asset {asset.key!r}: {file.sha256!r} is not a SHA-256")
    if not file.url.endswith(f".{file.sha256}.glb"):
        raise ValueError(f"asset {asset.key!r}: {file.url} does not end in its SHA-256 and .glb")
    if not 0 < file.size < _SIZE_LIMIT or not 0 <= file.level < _NUMBER_LIMIT:
        raise ValueError(f"asset {asset.key!r}: level {file.level} or its size, {file.size} bytes, is out of range")


def _check_once(asset: Asset, name: str, values: Sequence[str | int]) -> None:
    if len(set(values)) < len(values):
        twice = next(value for value in values if values.count(value) > 1)
        raise ValueError(f"asset {asset.key!r} has the {name} {twice!r} twice")


def _check_text(what: str, text: str) -> None:
    """Raises ValueError for text that UTF-8 cannot encode (half a surrogate pair), on which the writers would fail."""
    try:
        text.encode()
    except UnicodeEncodeError:
        raise ValueError(f"{what} is not valid Unicode: {text!r}") from None
