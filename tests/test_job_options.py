"""Options of a job: one table, and the same options on the wire, in the jobs database, in the API and on the command
line. What CONTRIBUTING says of "a job option" fails here where a step is left out.
"""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from capture2vr.cli.main import app
from capture2vr.edge.api import edge_pb2 as pb
from capture2vr.edge.api.header_options import header_fields, options_of
from capture2vr.gateway.jobs.job import Order
from capture2vr.gateway.schemas import JobRequest
from capture2vr.order.asset_names import AssetNames
from capture2vr.order.edits import LEAST_M, MOST_M, NO_EDITS, Edits
from capture2vr.order.job_options import DEFAULT_OPTIONS, InvalidOption, JobOptions
from capture2vr.order.option_table import OPTION_TABLE
from capture2vr.order.photo_box import PhotoBox
from capture2vr.storage.catalogue.visibility import Visibility

WORDS = st.text("abc é-", min_size=1, max_size=9).map(str.strip).filter(bool)
SHARES = st.floats(0, 0.4)
PHOTOS = st.sampled_from(["", "IMG_1.jpg"])
RECIPE = Edits(up=(0.0, 0.0, 1.0), fill="all")
OPTIONS = st.builds(
    JobOptions,
    preset=st.sampled_from(["", "draft", "mine"]),
    target=st.sampled_from(["", "quest3", "web-ktx2"]),
    cut=st.sampled_from(["", *OPTION_TABLE["cut"].choices]),
    fill=st.sampled_from(["", *OPTION_TABLE["fill"].choices]),
    columns=st.sampled_from(["", "x=2,y=3,z=4", "x=1,y=2,z=3,r=5,g=6,b=7,i=9"]),
    unit=st.sampled_from(["", *OPTION_TABLE["unit"].choices]),
    longest_m=st.none() | st.floats(LEAST_M, MOST_M),
    box=st.none()
    | st.builds(lambda left, top, photo: PhotoBox(left, top, left + 0.5, top + 0.25, photo), SHARES, SHARES, PHOTOS),
    edits=st.sampled_from([NO_EDITS, RECIPE, Edits(cut="object", preset="mine", target="web"), Edits(cut="scene")]),
    names=st.builds(AssetNames, WORDS, WORDS, st.lists(WORDS, max_size=3, unique_by=str.casefold).map(tuple)),
    collection=st.sampled_from(["", "ada"]),
    visibility=st.sampled_from(["", *OPTION_TABLE["visibility"].choices]),
    publish_anyway=st.booleans(),
)
GIVEN: dict[str, tuple[JobOptions, str]] = {
    "preset": (JobOptions(preset="draft"), "draft"),
    "target": (JobOptions(target="quest3"), "quest3"),
    "cut": (JobOptions(cut="scene"), "scene"),
    "fill": (JobOptions(fill="all"), "all"),
    "columns": (JobOptions(columns="x=2,y=3,z=4"), "x=2,y=3,z=4"),
    "unit": (JobOptions(unit="us-ft"), "us-ft"),
    "longest_m": (JobOptions(longest_m=0.31), "0.31"),
    "box": (JobOptions(box=PhotoBox(0.25, 0.125, 0.75, 1.0, "a.jpg")), "0.25,0.125,0.75,1,photo=a.jpg"),
    "edits": (JobOptions(edits=RECIPE), "recipe.json"),
    "label": (JobOptions(names=AssetNames("Dress")), "Dress"),
    "description": (JobOptions(names=AssetNames(description="of silk")), "of silk"),
    "labels": (JobOptions(names=AssetNames(labels=("summer",))), "summer"),
    "collection": (JobOptions(collection="ada"), "ada"),
    "visibility": (JobOptions(visibility="public"), "public"),
    "publish_anyway": (JobOptions(publish_anyway=True), ""),
}
"""For every option: a job that gives it alone, and the value of its flag; "" for a switch."""
AT_A_GATEWAY = {"label", "description", "labels", "visibility", "publish_anyway"}
"""Options that a run on this machine has not: nobody else sees what it makes."""


@given(OPTIONS)
def test_options_round_trip_on_the_wire(options: JobOptions) -> None:
    sent = pb.Header(**header_fields(options)).SerializeToString()
    assert options_of(pb.Header.FromString(sent)) == options


@given(OPTIONS)
def test_options_round_trip_in_the_jobs_database(options: JobOptions) -> None:
    order = Order("cap_1", "dress", options)
    assert Order.of(json.loads(json.dumps(order.as_json))) == order


@given(OPTIONS)
def test_options_round_trip_in_the_api(options: JobOptions) -> None:
    body = json.dumps({"capture": "cap_1", "asset_key": "dress", **options.given})
    assert JobRequest.model_validate_json(body).options == options


def test_the_table_has_every_option_and_no_other() -> None:
    parts = {"names": ["label", "description", "labels"]}
    flat = [name for field in fields(JobOptions) for name in parts.get(field.name, [field.name])]
    assert sorted(flat) == sorted(OPTION_TABLE) == sorted(GIVEN)
    assert OPTION_TABLE["visibility"].choices == tuple(Visibility)


@pytest.mark.parametrize("name", OPTION_TABLE)
def test_every_option_is_on_the_wire_in_a_row_and_in_the_api(name: str) -> None:
    options, _ = GIVEN[name]
    assert [field.name for field, _ in pb.Header(**header_fields(options)).ListFields()] == [name]
    assert list(options.given) == [name]
    assert Order("", "", options).as_json[name] == options.given[name]
    assert name in JobRequest.model_fields


@pytest.mark.parametrize("name", OPTION_TABLE)
@pytest.mark.parametrize("command", ["run", "push"])
def test_the_command_line_has_the_flags_choices_and_help_of_the_table(command: str, name: str) -> None:
    row = OPTION_TABLE[name]
    known = {flag: each for each in typer.main.get_command(app).commands[command].params for flag in each.opts}
    if command == "run" and name in AT_A_GATEWAY:
        assert row.flag not in known
        return
    assert known[row.flag].help.startswith(row.help)
    if row.choices:
        refused = CliRunner().invoke(app, [command, "scan.ply", row.flag, "nonsense"])
        assert refused.exit_code == 2
        assert all(f"'{choice}'" in refused.output for choice in row.choices)


@pytest.mark.parametrize(
    ("command", "name"),
    [
        *(("push", name) for name in (*OPTION_TABLE, "")),
        *(("run", name) for name in (*OPTION_TABLE, "") if name not in AT_A_GATEWAY),
    ],
)
def test_the_command_line_gives_the_options_whole(
    command: str, name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("recipe.json").write_text(RECIPE.text)
    told: list[Any] = []

    def record(*given: Any, **named: Any) -> None:
        told.append(named["options"] if command == "push" else given[2].job)

    called = {"run": "capture2vr.cli.local.run.run_capture", "push": "capture2vr.cli.remote.push.push_capture"}
    monkeypatch.setattr(called[command], record)
    monkeypatch.setattr("capture2vr.cli.stop_signals.exit_on_signals", lambda: None)
    others = {"run": ["-o", "out"], "push": ["--key", "dress"]}
    flag = [each for each in (OPTION_TABLE[name].flag, GIVEN[name][1]) if each] if name else []
    said = CliRunner().invoke(app, [command, "scan.ply", *others[command], *flag], catch_exceptions=False)
    assert said.exit_code == 0, said.output
    expected = GIVEN[name][0] if name else DEFAULT_OPTIONS
    if command == "run" and name != "collection":
        expected = replace(expected, collection="default")
    assert told == [expected]


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        ({"cut": "half"}, "CUT_UNKNOWN", "there is no cut half; use one of auto, object, scene"),
        ({"fill": "some"}, "FILL_UNKNOWN", "there is no fill some; use one of none, unseen, all"),
        ({"visibility": "mine"}, "VISIBILITY_UNKNOWN", "no visibility mine; use one of private, unlisted, public"),
        ({"longest_m": float("nan")}, "LENGTH_INVALID", "longest_m must be 0.001 to 1000.0 metres"),
        ({"longest_m": -1.0}, "LENGTH_INVALID", "longest_m must be"),
        ({"names": AssetNames("two\nlines")}, "LABEL_INVALID", "U+000A"),
        ({"names": AssetNames(labels=("",))}, "LABEL_INVALID", "a tag is empty"),
    ],
)  # fmt: skip
def test_an_option_that_a_job_cannot_have_is_named(options: dict[str, Any], code: str, message: str) -> None:
    with pytest.raises(InvalidOption) as refused:
        JobOptions(**options).checked()
    assert refused.value.code == code
    assert message in str(refused.value)


@given(OPTIONS)
def test_good_options_stay_as_they_are(options: JobOptions) -> None:
    assert options.checked() == options


def test_an_order_of_a_newer_version_is_not_half_understood() -> None:
    with pytest.raises(InvalidOption, match="there is no option glow, shine; a job has preset, target, "):
        JobOptions.of({"preset": "draft", "shine": 1, "glow": 2})


@given(OPTIONS)
def test_what_a_job_says_comes_before_its_recipe_and_the_recipe_then_says_it(options: JobOptions) -> None:
    completed, following = options.completed(), options.following_recipe()
    for name in ("cut", "fill", "preset", "target"):
        own, recipes = getattr(options, name), getattr(options.edits, name)
        assert getattr(completed, name) == (own or recipes)
        assert getattr(following, name) == (recipes or own)
        for each in (completed, following):
            assert options.edits == NO_EDITS or getattr(each.edits, name) == getattr(each, name)
    assert completed.completed() == completed


def test_nothing_is_done_twice_once_the_points_are_made() -> None:
    options = replace(GIVEN["box"][0], cut="scene", longest_m=1.0, edits=RECIPE, fill="none", target="web")
    assert options.without_points() == JobOptions(fill="none", target="web")
