"""A recipe of edits: it round-trips as JSON, its schema accepts what it accepts, and bad ones are named."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.order.edits import (
    MOST_BYTES,
    NO_EDITS,
    CropBox,
    CutPlane,
    Edits,
    InvalidEdits,
    MeasuredLength,
    json_schema,
)
from capture2vr.order.photo_lasso import MOST_CORNERS, MOST_LASSOS, PhotoLasso

NUMBERS = st.floats(-1e6, 1e6)
VECTORS = st.tuples(NUMBERS, NUMBERS, NUMBERS)
DIRECTIONS = VECTORS.filter(lambda each: max(map(abs, each)) > 1e-3)
SIDES = st.floats(1e-3, 1e3)
BOXES = st.builds(CropBox, VECTORS, st.tuples(SIDES, SIDES, SIDES), st.tuples(NUMBERS, NUMBERS, NUMBERS, SIDES))
PLANES = st.lists(st.builds(CutPlane, VECTORS, DIRECTIONS), max_size=3).map(tuple)
LENGTHS = st.builds(
    lambda start, way, metres: MeasuredLength(start, tuple(np.add(start, way).tolist()), metres),
    VECTORS, DIRECTIONS, SIDES,
)  # fmt: skip
SHARES = st.integers(0, 10_000).map(lambda number: number / 10_000)
LINES = st.lists(st.tuples(SHARES, SHARES), min_size=3, max_size=8).filter(
    lambda line: all(max(side) - min(side) > 0.01 for side in zip(*line, strict=True))
)
LASSOS = st.builds(
    PhotoLasso, st.sampled_from(["a.jpg", "é/b 1.heic"]), LINES.map(tuple), keeps=st.booleans(), through=st.booleans()
)
SQUARE = [[0.1, 0.1], [0.9, 0.1], [0.9, 0.9]]
RECIPES = st.builds(
    Edits,
    capture=st.sampled_from(["", "cap_1"]),
    crop=st.none() | BOXES,
    planes=PLANES,
    lassos=st.lists(LASSOS, max_size=3).map(tuple),
    up=st.none() | DIRECTIONS,
    front=st.none() | DIRECTIONS,
    length=st.none() | LENGTHS,
    cut=st.sampled_from(["", "object", "scene"]),
    fill=st.sampled_from(["", "none", "all"]),
    preset=st.sampled_from(["", "draft"]),
    target=st.sampled_from(["", "quest3"]),
)
BAD = {
    "no JSON": ("{", "Invalid JSON"),
    "no object": ("[]", "should be an object"),
    "null": ("null", "should be an object"),
    "a key that there is not": ('{"crops": {}}', "crops: "),
    "a key inside that there is not": ('{"crop": {"center": [0, 0, 0], "size": [1, 1, 1]}}', "crop.center"),
    "a later format": ('{"schema": 2}', "schema: "),
    "NaN": ('{"up": [NaN, 0, 1]}', "up.0: "),
    "infinity": ('{"up": [1e999, 0, 1]}', "up.0: "),
    "a text for a number": ('{"up": ["1", 0, 1]}', "up.0: must be a number"),
    "a truth value": ('{"up": [true, 0, 1]}', "up.0: must be a number"),
    "two coordinates": ('{"up": [0, 1]}', "up.2: "),
    "far away": ('{"up": [1e10, 0, 1]}', "up.0: "),
    "no direction": ('{"up": [0, 0, 0]}', "up is 0 0 0, which points nowhere"),
    "no front": ('{"front": [0, 0, 0]}', "front is 0 0 0, which points nowhere"),
    "a box inside out": ('{"crop": {"centre": [0, 0, 0], "size": [1, -2, 3]}}', "crop: the crop box is inside out"),
    "a flat box": ('{"crop": {"centre": [0, 0, 0], "size": [1, 0, 3]}}', "1 × 0 × 3"),
    "no rotation": ('{"crop": {"centre": [0,0,0], "size": [1,1,1], "rotation": [0,0,0,0]}}', "turns to nowhere"),
    "a plane without a side": ('{"planes": [{"point": [0, 0, 0], "normal": [0, 0, 0]}]}', "planes.0: the plane's norm"),
    "21 planes": (json.dumps({"planes": 21 * [{"point": [0, 0, 0], "normal": [0, 1, 0]}]}), "planes: "),
    "a length of zero": ('{"length": {"start": [0, 0, 0], "end": [1, 0, 0], "metres": 0}}', "length.metres: "),
    "one point twice": ('{"length": {"start": [1, 2, 3], "end": [1, 2, 3], "metres": 1}}', "two points of the length"),
    "a tiny line": ('{"length": {"start": [0, 0, 0], "end": [1e-320, 0, 0], "metres": 1}}', "two points of the length"),
    "a cut that there is not": ('{"cut": "half"}', "cut: "),
    "a name with a path": ('{"preset": "../x"}', "preset: "),
    "a lasso without a photo": (json.dumps({"lassos": [{"line": SQUARE}]}), "lassos.0.photo: "),
    "a lasso in no photo": (json.dumps({"lassos": [{"photo": "", "line": SQUARE}]}), "lassos.0.photo: "),
    "a lasso of two corners": (json.dumps({"lassos": [{"photo": "a", "line": SQUARE[:2]}]}), "lassos.0.line: "),
    "a corner of one number": (json.dumps({"lassos": [{"photo": "a", "line": [[0], *SQUARE]}]}), "lassos.0.line.0.1: "),
    "a corner beyond": (json.dumps({"lassos": [{"photo": "a", "line": [*SQUARE, [0, 1.01]]}]}), "lassos.0.line.3.1: "),
    "a corner before": (json.dumps({"lassos": [{"photo": "a", "line": [*SQUARE, [-0.1, 1]]}]}), "lassos.0.line.3.0: "),
    "a corner that is none": (
        '{"lassos": [{"photo": "a", "line": [[NaN, 0], [0, 1], [1, 1]]}]}',
        "lassos.0.line.0.0: ",
    ),
    "a corner of text": ('{"lassos": [{"photo": "a", "line": [["0", 0], [0, 1], [1, 1]]}]}', "must be a number"),
    "a lasso around nothing": (json.dumps({"lassos": [{"photo": "a", "line": 3 * [[0.5, 0.5]]}]}), "round nothing"),
    "a lasso along a line": (json.dumps({"lassos": [{"photo": "a", "line": [[0, 0], [0, 1], [0, 0.5]]}]}), "width"),
    "keeps that is no truth value": (json.dumps({"lassos": [{"photo": "a", "line": SQUARE, "keeps": "yes"}]}), "keeps"),
    "a key of a lasso that there is not": (json.dumps({"lassos": [{"photo": "a", "lines": SQUARE}]}), "lassos.0.lines"),
    "too many lassos": (json.dumps({"lassos": (MOST_LASSOS + 1) * [{"photo": "a", "line": SQUARE}]}), "lassos: "),
    "too many corners": (json.dumps({"lassos": [{"photo": "a", "line": 22 * SQUARE}]}), "lassos.0.line: "),
    "half a letter": ('{"capture": "\\ud800"}', "Invalid JSON"),
    "too much": (" " * (MOST_BYTES + 1), "bytes"),
}


@pytest.mark.slow
@given(RECIPES)
def test_a_recipe_round_trips(edits: Edits) -> None:
    assert Edits.parse(edits.text) == Edits.parse(json.dumps(edits.as_json)) == Edits.of(edits.as_json) == edits


def test_the_largest_lassos_fit_into_a_recipe() -> None:
    """With names of the longest kind and corners of too many digits, which are rounded."""
    corner = [0.123456789, 0.98765432101]
    line = [*(MOST_CORNERS - 2) * [corner], [0.00011111, 0.00012], [0.5, 0.5]]
    lasso = {"photo": 200 * "é", "line": line, "keeps": True, "through": True}
    edits = Edits.parse(json.dumps({"lassos": [lasso]}))
    assert edits.lassos[0].line[0] == (0.1235, 0.9877)
    largest = Edits(lassos=MOST_LASSOS * edits.lassos)
    assert len(largest.text.encode()) < MOST_BYTES - 3_000
    assert Edits.parse(largest.text) == largest


def test_nothing_is_a_recipe_too() -> None:
    assert Edits.parse("{}") == NO_EDITS
    assert NO_EDITS.as_json == {"schema": 1}
    assert NO_EDITS.completed(cut="scene") == NO_EDITS


@pytest.mark.parametrize("what", BAD)
def test_a_bad_recipe_is_named(what: str) -> None:
    text, said = BAD[what]
    with pytest.raises(InvalidEdits) as refused:
        Edits.parse(text)
    assert said in str(refused.value)


def test_a_recipe_of_another_capture_is_refused() -> None:
    edits = Edits(capture="cap_1")
    edits.require_capture("cap_1")
    edits.require_capture("")
    with pytest.raises(InvalidEdits, match="made for capture cap_1, and this is cap_2"):
        edits.require_capture("cap_2")


@given(BOXES)
def test_the_axes_of_a_box_are_a_rotation(box: CropBox) -> None:
    axes = np.array(box.axes)
    assert np.allclose(axes @ axes.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(axes) == pytest.approx(1)


def test_the_schema_names_every_field() -> None:
    schema = json_schema()
    assert set(schema["properties"]) == set(Edits.__slots__)
    assert all(each["additionalProperties"] is False for each in (schema, *schema["$defs"].values()))
