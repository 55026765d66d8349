"""Options of a job: how a capture is reconstructed, and as what the asset is published.

Page, API, command line and recipe make one `JobOptions`, which reaches the pipeline whole. It is converted here to and
from the JSON document that the API and the jobs database share, and in `edge/api/header_options.py` for the wire.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from capture2vr.order.asset_names import UNNAMED, AssetNames
from capture2vr.order.edits import LEAST_M, MOST_M, NO_EDITS, Edits
from capture2vr.order.option_table import OPTION_TABLE, CutName, FillName, VisibilityName
from capture2vr.order.photo_box import PhotoBox
from capture2vr.order.reading import HOW, FileReading, InvalidColumns, TableColumns, UnitName

_IN_RECIPES = ("cut", "fill", "preset", "target")


class InvalidOption(ValueError):  # noqa: N818 - it reads as what it is
    """An option that a job cannot have. The message names the field, what is wrong, and what to do.

    code  for programs, such as FILL_UNKNOWN
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True, slots=True)
class JobOptions:
    """Options of a job, as ordered; what is left out is chosen where the job runs.

    preset      name of the method; "": the default of whoever runs the job
    target      device class whose budget the levels of detail must meet; "": none
    cut         what of the capture is kept; "": auto
    fill        which holes of the mesh are filled; "": "unseen" for photos and depth images, "none" for clouds
    columns     of a table of points, such as "x=2,y=3,z=4"; "": as the table tells
    unit        of the coordinates in a file; "": what the file says, else a plausible one
    longest_m   metres between the two points of the object that are farthest apart; None: unknown
    box         mark of the object in a photo: a rectangle or a tap; None: what stands out, or is near the middle
    edits       recipe of what to cut away, what is up and the scale
    names       of the asset; without a label, its key
    collection  collection that lists the asset; "": the default of whoever runs the job
    visibility  of the asset; "": as it is, or as its collection
    publish_anyway  whether what its grade says to shoot again is published all the same
    """

    preset: str = ""
    target: str = ""
    cut: CutName = ""
    fill: FillName = ""
    columns: str = ""
    unit: UnitName = ""
    longest_m: float | None = None
    box: PhotoBox | None = None
    edits: Edits = NO_EDITS
    names: AssetNames = UNNAMED
    collection: str = ""
    visibility: Literal["", VisibilityName] = ""
    publish_anyway: bool = False

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> JobOptions:
        """Convert a JSON document of `as_json`, in which any field may be left out. The values are not checked.

        Raises InvalidOption for a field that there is not, so that an order of a newer version is not half understood.
        """
        if unknown := document.keys() - OPTION_TABLE.keys():
            what = f"there is no option {', '.join(sorted(unknown))}; a job has {', '.join(OPTION_TABLE)}"
            raise InvalidOption("OPTION_UNKNOWN", what)
        edits, box = document.get("edits") or {}, document.get("box")
        return cls(
            preset=document.get("preset", ""),
            target=document.get("target", ""),
            cut=document.get("cut", ""),
            fill=document.get("fill", ""),
            columns=document.get("columns", ""),
            unit=document.get("unit", ""),
            longest_m=document.get("longest_m"),
            box=PhotoBox.unchecked(box) if box else None,
            edits=edits if isinstance(edits, Edits) else Edits.of(edits),
            names=AssetNames.of(document),
            collection=document.get("collection", ""),
            visibility=document.get("visibility", ""),
            publish_anyway=bool(document.get("publish_anyway", False)),
        )

    @property
    def as_json(self) -> dict[str, Any]:
        """All options as the jobs database and the API have them."""
        return {
            "preset": self.preset,
            "label": self.names.label,
            "target": self.target,
            "cut": self.cut,
            "columns": self.columns,
            "unit": self.unit,
            "longest_m": self.longest_m,
            "collection": self.collection,
            "fill": self.fill,
            "box": self.box.as_json if self.box else [],
            "description": self.names.description,
            "labels": list(self.names.labels),
            "visibility": self.visibility,
            "publish_anyway": self.publish_anyway,
            "edits": self.edits.as_json,
        }

    @property
    def reading(self) -> FileReading:
        """What they say of how a file is read."""
        return FileReading(self.columns, self.unit)

    @property
    def given(self) -> dict[str, Any]:
        """The part of `as_json` that differs from the defaults: what a request to the API says."""
        return {name: value for name, value in self.as_json.items() if value != _DEFAULT_JSON[name]}

    def checked(self) -> JobOptions:
        """Return the options with clean names. Raises InvalidOption for a choice or length that there is not."""
        for field, row in OPTION_TABLE.items():
            if row.choices:
                check_choice(field, getattr(self, field))
        check_columns(self.columns)
        if self.longest_m is not None and not LEAST_M <= self.longest_m <= MOST_M:  # true for NaN too
            raise InvalidOption("LENGTH_INVALID", f"longest_m must be {LEAST_M} to {MOST_M} metres")
        try:
            return replace(self, names=self.names.checked())
        except ValueError as error:
            raise InvalidOption("LABEL_INVALID", str(error)) from None

    def choosing(self, **choices: str) -> JobOptions:
        """Return the options with another cut, fill, preset or target, all four of which the recipe then says too."""
        options = replace(self, **choices)  # type: ignore[arg-type]
        said = {name: getattr(options, name) for name in _IN_RECIPES}
        return replace(options, edits=self.edits.completed(**said))

    def completed(self) -> JobOptions:
        """Return the options with what the recipe says of cut, fill, preset and target where they say nothing."""
        return self.choosing(**{name: getattr(self, name) or getattr(self.edits, name) for name in _IN_RECIPES})

    def following_recipe(self) -> JobOptions:
        """Return the options with what the recipe says of cut, fill, preset and target, whatever they say."""
        return self.choosing(**{name: getattr(self.edits, name) or getattr(self, name) for name in _IN_RECIPES})

    def without_points(self) -> JobOptions:
        """Return the options that are left to do once the points are made: the others are in the points."""
        return replace(self, cut="", columns="", unit="", longest_m=None, box=None, edits=NO_EDITS)


DEFAULT_OPTIONS = JobOptions()
"""Of a job that says nothing."""
_DEFAULT_JSON = DEFAULT_OPTIONS.as_json


def check_choice(field: str, name: str) -> Any:
    """Return the name unchanged if it is one of a field's choices, or "". Raises InvalidOption, which names all."""
    choices = OPTION_TABLE[field].choices
    if name and name not in choices:
        what = f"there is no {field} {name}; use one of {', '.join(choices)}"
        raise InvalidOption(f"{field.upper()}_UNKNOWN", what)
    return name


def check_columns(text: str) -> str:
    """Return a table's columns unchanged. Raises InvalidOption for those that there cannot be."""
    try:
        if text:
            TableColumns.parse(text)
    except InvalidColumns as error:
        raise InvalidOption("COLUMNS_INVALID", f"columns: {error}; {HOW}") from None
    return text
