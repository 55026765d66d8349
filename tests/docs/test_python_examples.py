"""The Python code of docs/python.md runs, from top to bottom, in a folder with a cloud and a photo."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.clouds import sphere_points
from tests.support.gateway_of_zips import gateway_of_zips
from tests.support.repository import ROOT

PAGE = (ROOT / "docs" / "python.md").read_text()


@pytest.mark.slow
def test_the_examples_of_the_page_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ("XDG_STATE_HOME", "XDG_CACHE_HOME"):
        monkeypatch.setenv(variable, str(tmp_path / variable))
    monkeypatch.delenv("CAPTURE2VR_KEY", raising=False)
    monkeypatch.chdir(tmp_path)
    np.save("cloud.npy", sphere_points(300))
    Path("photos").mkdir()
    picture = np.full((120, 160, 3), 215, np.uint8)
    cv2.circle(picture, (80, 60), 35, (40, 60, 180), cv2.FILLED)
    cv2.imwrite("photos/ball.png", picture)
    blocks = re.findall(r"```python\n(.*?)```", PAGE, re.S)
    assert len(blocks) == 3
    with gateway_of_zips(tmp_path) as served:
        for block in blocks:
            exec(compile(block.replace("http://127.0.0.1:8080", served.url), "docs/python.md", "exec"), {})
    assert Path("mesh.glb").is_file()
    assert Path("result/lod0.glb").is_file()
    assert Path("boot/mesh.ply").is_file()


def test_the_tree_of_errors_is_the_one_that_the_package_has() -> None:
    from capture2vr import errors

    names = re.findall(r"^[│├└─ ]*(\w+)(?:  |$)", PAGE.split("```text\n")[1].split("```")[0], re.M)
    documented = re.findall(r"^[│├└─ ]*(\w+)(?:  |$)", (errors.__doc__ or "").split("\n\n")[1], re.M)
    assert names == documented
    assert len(names) == 7
