"""The table of a job's options: their choices, their flags on the command line, and one text of help for each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from capture2vr.order.reading import Unit

Cut = Literal["auto", "object", "scene"]
"""What of a capture is kept. auto: the object where photos were taken around one, else the scene; object: without what
it stands on and what stands around it; scene: everything that was seen."""

Fill = Literal["none", "unseen", "all"]
"""What is closed: nothing; the underside of what stands on something, and holes in a surface that goes on around them,
unless views saw through; all that no view saw through, also the ends of tubes and sides that nobody saw."""

VisibilityName = Literal["private", "unlisted", "public"]
"""Who may read the asset besides its tenant; storage/catalogue/visibility.py says more."""

GENERATE = "generate"
"""Preset by which a generator makes the object in one photo up, where the worker has one (EDGE_GENERATOR)."""

CutName = Literal["", Cut]
FillName = Literal["", Fill]


@dataclass(frozen=True, slots=True)
class OptionRow:
    """One option of a job.

    flag     on the command line
    help     what it does, in one or two sentences, for the command line and the API
    default  what happens without it, where `help` does not say so; ends without a full stop
    choices  the values that it may have; (): it is not chosen from a list
    """

    flag: str
    help: str
    default: str = ""
    choices: tuple[str, ...] = ()

    def text(self, default: str = "") -> str:
        """Return the help with what happens without the option, which is not the same everywhere."""
        default = default or self.default
        return f"{self.help} Default: {default}." if default else self.help


OPTION_TABLE = {
    "preset": OptionRow("--preset", "Method of reconstruction, see `capture2vr presets`."),
    "target": OptionRow(
        "--target",
        "Device class whose budget the levels of detail must meet: quest3, quest2, web or archive. "
        "With -unlit (quest3-unlit): colours as captured, independent of the scene's light. With -ktx2 (quest3-ktx2, "
        "quest3-unlit-ktx2): KTX2 textures, made by the encoder in the folder EDGE_KTX2. With -normals "
        "(quest3-normals): normal maps, which show the full mesh's shape on the levels of detail.",
    ),
    "cut": OptionRow(
        "--cut",
        "What to keep: object, without the floor or table and the surroundings; scene: everything that was seen; "
        "auto, the default: the object if the photos were taken around one.",
        choices=get_args(Cut),
    ),
    "fill": OptionRow(
        "--fill",
        "What to close: none; unseen: undersides, and holes in the surface that no photo sees through; all: also "
        "open ends and sides that no photo shows.",
        "unseen for photos and depth images, none for point clouds",
        get_args(Fill),
    ),
    "columns": OptionRow(
        "--columns",
        "Columns of a table of points, by their numbers from 1, such as x=2,y=3,z=4; also r, g, b for colours, nx, ny, "
        "nz for normals and i for an intensity.",
        "as the table's header and numbers tell",
    ),
    "unit": OptionRow(
        "--unit",
        "Unit of the coordinates in a file of points or a mesh. deg: longitude, latitude and heights in metres.",
        "what the file says, else metres if the object then has a plausible size",
        get_args(Unit),
    ),
    "longest_m": OptionRow("--longest", "Metres between the farthest points of the object, if you measured it."),
    "box": OptionRow(
        "--box",
        "Rectangle around the object in a photo: left,top,right,bottom as shares of the upright photo's width and "
        "height, such as 0.2,0.1,0.8,0.95; or x,y of a place on the object, such as 0.5,0.6. Of several photos it is "
        "drawn in the first, or in the one that is named behind it: 0.2,0.1,0.8,0.95,photo=IMG_1.jpg.",
        "what stands out of a single photo, else the largest object near the middle",
    ),
    "edits": OptionRow(
        "--edits",
        "Recipe (JSON) of what to cut away, which way is up and the true size, such as `edits` of a manifest. "
        "What it says of cut, fill, preset and target holds where the job itself says nothing.",
    ),
    "label": OptionRow("--label", "A name for people.", "the key"),
    "description": OptionRow("--description", "Some lines about the asset, for people."),
    "labels": OptionRow("--tag", "A tag of the asset, such as summer; may be repeated."),
    "collection": OptionRow("--collection", "Name of the collection."),
    "visibility": OptionRow(
        "--visibility",
        "Who may read the asset besides its tenant. private: nobody; unlisted: whoever has its address; public: "
        "everybody.",
        "as it is, or as its collection",
        get_args(VisibilityName),
    ),
    "publish_anyway": OptionRow(
        "--publish-anyway",
        "Publish it even if its grade says to shoot again; otherwise it is held back then: no list has it, and an "
        "earlier version goes on being served, until somebody keeps it.",
    ),
}
"""By the names that the API, the jobs database and `JobOptions` use, in the order in which a job is stored."""
