"""Pictures are found under the paths of other machines, and no picture is taken for another."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture2vr.edge.capture.files import Folder
from capture2vr.edge.capture.listed_pictures import find_pictures
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from tests.support import captures

BY = "transforms.json"
OTHER_MACHINES = ["", "./", "../", "/home/ada/lego/", "C:\\Scans\\lego\\", "\\\\server\\scans\\"]
PARTS = st.text(st.sampled_from("ab01._ "), min_size=1, max_size=6).filter(lambda part: part.strip(". ") == part)
PHOTOS = st.lists(st.tuples(st.sampled_from(["", "left/", "right/"]), PARTS), min_size=1, max_size=8, unique=True)


def found(names: list[str], *written: str) -> list[str | None]:
    places = find_pictures(Folder(Path("/nowhere"), tuple(names)), written, by=BY)
    return [places.get(path) for path in written]


@given(PHOTOS, st.sampled_from(OTHER_MACHINES), st.sampled_from([".png", ".JPG", ".dng", ""]), st.data())
def test_photos_are_found_whatever_stands_before_and_behind_their_names(
    photos: list[tuple[str, str]], machine: str, suffix: str, data: st.DataObject
) -> None:
    names = [f"images/{place}{stem}.jpg" for place, stem in photos]
    others = [f"depth/{place}{stem}.png" for place, stem in photos] + [name.replace("s/", "s_4/", 1) for name in names]
    written = [f"{machine}images/{place}{stem}{suffix}" for place, stem in photos]
    assert found(data.draw(st.permutations(names + others)), *written) == names


@pytest.mark.parametrize(
    ("names", "written", "expected"),
    [
        (["images/1.jpg", "1.jpg"], ["1.jpg"], ["1.jpg"]),
        (["images/1.jpg", "images/1.png"], ["x/images/1.png"], ["images/1.png"]),
        (["a/1.jpg"], ["left/1.jpg", "right/1.jpg"], [None, None]),  # of two cameras: nobody knows whose it is
        (["a/1.jpg", "a/2.jpg"], ["a/1.jpg", "b/1.jpg"], ["a/1.jpg", None]),
        (["images/1.jpg"], ["depth/1.png"], [None]),
        (["depth/1.png", "masks/1.png"], ["images/1.png"], [None]),
        (["depth/1.png", "images/1.png"], ["/mnt/x/depth/1.png"], ["depth/1.png"]),
        (["images/1.txt"], ["/mnt/x/images/1.jpg"], [None]),
    ],
)
def test_no_picture_is_taken_for_another(names: list[str], written: list[str], expected: list[str | None]) -> None:
    if all(each is None for each in expected) and written[0].startswith("/"):
        with pytest.raises(CaptureError, match="outside the capture's folder"):
            found(names, *written)
    else:
        assert found(names, *written) == expected


@pytest.mark.parametrize("written", [None, 3, "", ["images/1.jpg"], "..", "/"])
def test_what_is_no_path_is_refused(written: object) -> None:
    with pytest.raises(CaptureError) as caught:
        find_pictures(Folder(Path("/nowhere"), ("images/1.jpg",)), [written], by=BY)
    assert (caught.value.code, caught.value.file) == ("CAPTURE_UNREADABLE", BY)


def test_a_capture_of_another_machine_is_read_with_its_depth(tmp_path: Path) -> None:
    folder = captures.write_nerfstudio(tmp_path)
    tree = json.loads((folder / BY).read_text())
    for frame in tree["frames"]:
        frame["file_path"] = "/home/ada/scan/" + frame["file_path"].removeprefix("./").replace(".jpg", ".png")
        frame["depth_file_path"] = "/home/ada/scan/" + frame["depth_file_path"]
    (folder / BY).write_text(json.dumps(tree))
    capture = read_capture(folder)
    assert (capture.kind, len(capture.frames), capture.warnings) == ("rgbd", len(tree["frames"]), ())
    assert all(frame.load_rgb is not None for frame in capture.frames)
