"""Scenes: several assets, each placed, turned and scaled, saved as one small JSON document of a tenant.

Places are in the scene's own frame: metres, Y up, the floor at y = 0. A document is hostile until it has been
validated, whether a request brings it or the store.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError

from capture2vr.order.json_numbers import array_schema, require_number
from capture2vr.order.one_line import one_line
from capture2vr.sentences.sentence import say
from capture2vr.storage.catalogue.entry import check_key
from capture2vr.storage.catalogue.faults import SCENE_DAMAGED, CatalogueFault

SCENE_ID = r"scn_[0-9a-f]{24}"
NAME_CHARS = 100
MOST_ITEMS = 50
"""Most things of a scene: their coarsest levels, of 5,000 triangles each, leave most of a headset's budget."""
_FAR_M = 100.0  # from the scene's middle, along each axis: farther away nobody finds it again
_SCALES = (0.05, 20.0)  # against true size; the viewer allows no others
_UNIT_WITHIN = 0.01  # of a quaternion's length: what is sent is rounded
STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
"""How documents of scenes are validated: nothing unknown, and numbers that are finite."""


def _not_empty(name: str) -> str:
    if not name.strip():
        raise ValueError(say("scene_needs_name"))
    return name


def check_unit(rotation: tuple[float, float, float, float]) -> None:
    """Raises ValueError for a rotation that is no unit quaternion."""
    length = math.hypot(*rotation)
    if abs(length - 1) > _UNIT_WITHIN:
        raise ValueError(f"the rotation is no unit quaternion: its length is {length:g}")


Metres = Annotated[float, BeforeValidator(require_number), Field(ge=-_FAR_M, le=_FAR_M)]
Part = Annotated[float, BeforeValidator(require_number), Field(ge=-1.01, le=1.01)]
ItemId = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,40}$")]
Position = Annotated[tuple[Metres, Metres, Metres], array_schema(3, _FAR_M)]
Rotation = Annotated[tuple[Part, Part, Part, Part], array_schema(4, 1.01)]
Scale = Annotated[float, BeforeValidator(require_number), Field(ge=_SCALES[0], le=_SCALES[1])]
SceneName = Annotated[str, Field(max_length=NAME_CHARS), AfterValidator(one_line), AfterValidator(_not_empty)]


@dataclass(frozen=True, slots=True)
class PlacedAsset:
    """An asset in a scene.

    id          within the scene, since one asset may stand in it twice
    asset       its key; the asset may be gone
    position_m  (3,) of its origin, the middle of its underside, in the scene's frame
    rotation    unit quaternion x, y, z, w
    scale       against its true size
    """

    id: ItemId
    asset: Annotated[str, Field(max_length=100), AfterValidator(check_key)]
    position_m: Position
    rotation: Rotation = (0.0, 0.0, 0.0, 1.0)
    scale: Scale = 1.0

    __pydantic_config__ = STRICT

    def __post_init__(self) -> None:
        check_unit(self.rotation)


def check_ids(items: tuple[PlacedAsset, ...]) -> tuple[PlacedAsset, ...]:
    """Return the things of a scene unchanged. Raises ValueError where two have one id."""
    ids = [item.id for item in items]
    twice = next((each for each in ids if ids.count(each) > 1), None)
    if twice is not None:
        raise ValueError(say("two_things_scene_have_id", id=twice))
    return items


PlacedAssets = Annotated[tuple[PlacedAsset, ...], Field(max_length=MOST_ITEMS), AfterValidator(check_ids)]


@dataclass(frozen=True, slots=True)
class Scene:
    """A scene. `version` grows by one with every change; times are ISO 8601 in UTC."""

    id: Annotated[str, Field(pattern=f"^{SCENE_ID}$")]
    name: SceneName
    version: Annotated[int, Field(ge=1)]
    created: str
    updated: str
    items: PlacedAssets

    __pydantic_config__ = STRICT

    @property
    def assets(self) -> frozenset[str]:
        """The keys of the assets that stand in it."""
        return frozenset(item.asset for item in self.items)

    @property
    def as_json(self) -> dict[str, Any]:
        """Serialise the arrangement as the JSON document on the store."""
        document: dict[str, Any] = _SCENE.dump_python(self, mode="json")
        return document


_SCENE = TypeAdapter(Scene)


def parse_scene(name: str, data: bytes) -> Scene:
    """Parse a document of the store. Raises CatalogueFault for one that is damaged. name: of the object"""
    try:
        return _SCENE.validate_json(data)
    except ValidationError:
        hint = say("restore_object_from_backup_delete")
        raise CatalogueFault(SCENE_DAMAGED, name, say("scene_document_damaged"), hint=hint) from None
