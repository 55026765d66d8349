"""Edits of a capture: a recipe of what to cut away, which way is up and how long something is, replayed when it is
reconstructed again. The HTTP API, the wire, the manifest and `capture2vr run --edits` share it as JSON.

Places and directions are in the capture frame, in the capture's own units, because that frame is the same every time a
capture is reconstructed. The asset frame is not: it follows from the mesh. A page that shows an asset converts with the
manifest's `capture_to_asset` (4,4), row by row: capture = inverse(capture_to_asset) · asset.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError

from capture2vr.order.json_numbers import array_schema, require_number
from capture2vr.order.option_table import CutName, FillName
from capture2vr.order.photo_lasso import MOST_LASSOS, PhotoLasso

MOST_BYTES = 60 << 10
"""Most bytes of a recipe: less than a request's body may have (64 KiB); one without lassos has 2 KB, and 30 lassos have
57 KB at most."""
MOST_PLANES = 20
LEAST_M, MOST_M = 0.001, 1_000.0
"""Shortest and longest length in metres that a person can have measured: a tick, a street."""
_FARTHEST = 1e9  # capture units from the origin; squares and products of two stay far from overflowing
_SHORTEST = 1e-9  # length of a direction, or of a measured line in capture units

SEE = "docs/edits.md describes a recipe, and GET /v1/schemas/edits returns its JSON Schema"
"""What to do about a recipe that is none."""


Number = Annotated[float, BeforeValidator(require_number), Field(ge=-_FARTHEST, le=_FARTHEST)]


Vector = Annotated[tuple[Number, Number, Number], array_schema(3, _FARTHEST)]
Quaternion = Annotated[tuple[Number, Number, Number, Number], array_schema(4, _FARTHEST)]
Name = Annotated[str, Field(max_length=100, pattern=r"^[A-Za-z0-9._-]*$")]
_STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)


class InvalidEdits(ValueError):  # noqa: N818 - it reads as what it is
    """A recipe that is none. The message is a sentence for people that names the field."""


@dataclass(frozen=True, slots=True)
class CropBox:
    """A box: what is outside is cut away.

    centre    (3,) capture frame
    size      (3,) lengths of its edges along its own axes, capture units, above 0
    rotation  unit quaternion x, y, z, w, from the box's axes to the capture frame's; of any length but 0
    """

    centre: Vector
    size: Vector
    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)

    __pydantic_config__ = _STRICT

    def __post_init__(self) -> None:
        if min(self.size) <= 0:
            sides = " × ".join(f"{side:g}" for side in self.size)
            raise ValueError(f"the crop box is inside out: its size is {sides}, and every edge must be longer than 0")
        if math.hypot(*self.rotation) < _SHORTEST:
            raise ValueError("the crop box's rotation is 0 0 0 0, which turns to nowhere; no rotation is 0 0 0 1")

    @property
    def axes(self) -> tuple[Vector, Vector, Vector]:
        """The directions of the box's edges in the capture frame, each a unit vector."""
        length = math.hypot(*self.rotation)
        x, y, z, w = (each / length for each in self.rotation)
        return (
            (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)),
            (2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)),
            (2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)),
        )


@dataclass(frozen=True, slots=True)
class CutPlane:
    """A plane: what is behind it is cut away, such as a floor.

    point   (3,) on the plane, capture frame
    normal  (3,) to the side that is kept; of any length but 0
    """

    point: Vector
    normal: Vector

    __pydantic_config__ = _STRICT

    def __post_init__(self) -> None:
        _require_direction("the plane's normal", self.normal)


@dataclass(frozen=True, slots=True)
class MeasuredLength:
    """Two points, `start` and `end` (3,) in the capture frame, and the metres between them."""

    start: Vector
    end: Vector
    metres: Annotated[float, BeforeValidator(require_number), Field(ge=LEAST_M, le=MOST_M)]

    __pydantic_config__ = _STRICT

    def __post_init__(self) -> None:
        if self.units < _SHORTEST:
            raise ValueError("the two points of the length are one: choose two that are apart")

    @property
    def units(self) -> float:
        """Distance between the points in capture units."""
        return math.dist(self.start, self.end)

    @property
    def metres_per_unit(self) -> float:
        """Metres per unit of the capture frame, by this length."""
        return self.metres / self.units


@dataclass(frozen=True, slots=True)
class Edits:
    """A recipe. Every part may be left out; {} changes nothing.

    schema   version of this format
    capture  id of the capture that it was made for; "": any. An order with another capture is refused
    crop     box outside of which points are cut away
    planes   behind which points are cut away
    lassos   lines in photos, around what is left out or kept
    up       (3,) direction against gravity in the capture frame, of any length but 0; None: it is estimated
    front    (3,) direction in the capture frame to which its front looks, likewise; None: as the capture's frame has it
    length   gives the true size; None: as the capture tells it
    cut, fill, preset, target  as in a job; "": as the job says. What the job itself names comes first
    """

    schema: Literal[1] = 1
    capture: Name = ""
    crop: CropBox | None = None
    planes: Annotated[tuple[CutPlane, ...], Field(max_length=MOST_PLANES)] = ()
    lassos: Annotated[tuple[PhotoLasso, ...], Field(max_length=MOST_LASSOS)] = ()
    up: Vector | None = None
    front: Vector | None = None
    length: MeasuredLength | None = None
    cut: CutName = ""
    fill: FillName = ""
    preset: Name = ""
    target: Name = ""

    __pydantic_config__ = _STRICT

    def __post_init__(self) -> None:
        if self.up is not None:
            _require_direction("up", self.up)
        if self.front is not None:
            _require_direction("front", self.front)

    @classmethod
    def parse(cls, text: str | bytes) -> Edits:
        """Parse a JSON document. Raises InvalidEdits."""
        size = len(text.encode() if isinstance(text, str) else text)
        if size > MOST_BYTES:
            raise InvalidEdits(f"the recipe has {size:,} bytes; at most {MOST_BYTES:,} are read")
        try:
            return _EDITS.validate_json(text)
        except ValidationError as error:
            raise InvalidEdits(sentence_of(error)) from None

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> Edits:
        """Convert a document that `as_json` has made."""
        return _EDITS.validate_python(document)

    @property
    def cuts_away(self) -> bool:
        """Whether it cuts points away."""
        return self.crop is not None or bool(self.planes or self.lassos)

    @property
    def photos(self) -> frozenset[str]:
        """Names of the photos that its lassos are in."""
        return frozenset(lasso.photo for lasso in self.lassos)

    @property
    def as_json(self) -> dict[str, Any]:
        """Serialise the recipe as JSON, for manifests and the API, without empty parts."""
        document: dict[str, Any] = _EDITS.dump_python(self, mode="json", exclude_defaults=True)
        return {"schema": self.schema, **document}

    @property
    def text(self) -> str:
        """The JSON document that `parse` reads."""
        return _EDITS.dump_json(self, exclude_defaults=True).decode()

    def require_capture(self, capture: str) -> None:
        """Raise InvalidEdits where it was made for another capture."""
        if self.capture and capture and self.capture != capture:
            raise InvalidEdits(f"the recipe was made for capture {self.capture}, and this is {capture}")

    def completed(self, **choices: str) -> Edits:
        """Return the recipe with the cut, fill, preset and target that were chosen, so that it can be replayed without
        the job; the empty recipe stays empty.
        """
        return self if self == NO_EDITS else replace(self, **choices)  # type: ignore[arg-type]


NO_EDITS = Edits()
"""The recipe that changes nothing."""
_EDITS = TypeAdapter(Edits)


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of a recipe."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_EDITS.json_schema()}


def sentence_of(error: ValidationError) -> str:
    """Return what is wrong with a recipe, each field by its path."""
    return "; ".join(fault_sentence(fault["loc"], fault["msg"]) for fault in error.errors()[:5])


def fault_sentence(path: tuple[int | str, ...], message: str) -> str:
    """Return what is wrong with one field of a document."""
    where = ".".join(map(str, path))
    return f"{where}: {message.removeprefix('Value error, ')}" if where else message.removeprefix("Value error, ")


def _require_direction(what: str, direction: Vector) -> None:
    if math.hypot(*direction) < _SHORTEST:
        raise ValueError(f"{what} is 0 0 0, which points nowhere")
