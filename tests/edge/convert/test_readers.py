"""What others' programs read of each format: all triangles, the colours, in one place and upright."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from capture2vr.edge.convert.convert_bundle import convert
from capture2vr.order.download_formats import FORMATS
from tests.referees.formats import readers
from tests.referees.formats.readers import Reader
from tests.support.downloadable import SHEET, downloadable, written

COLOURS = {
    "glb": "texture",
    "glb-meshopt": "texture",
    "obj": "texture",
    "ply": "vertices",
    "stl": "none",
    "usdz": "texture",
}
Z_UP = ("ply", "stl")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The files that a program opens, by format."""
    folder = tmp_path_factory.mktemp("formats")
    bundle = written(downloadable(), folder / "bundle")
    made = {}
    for name in COLOURS:
        path = folder / FORMATS[name].file_name("sheet")
        path.write_bytes(convert(bundle, name, "sheet"))
        (made[name],) = readers.opened([path])
    return made


def check(reader: Reader, files: dict[str, Path]) -> None:
    readable = [name for name, file in files.items() if file.suffix in reader.endings]
    names = [name for name in readable if name != "glb-meshopt" or reader in readers.UNPACKS_MESHOPT]
    for name, found in zip(names, reader.read([files[name] for name in names]), strict=True):
        assert (found.fault, found.triangles) == ("", len(SHEET.faces)), name
        assert found.colours == COLOURS[name], name
        if found.low is not None:
            scale = 1000 if name == "stl" else 1
            low, high = readers.turned(found, reader, name in Z_UP and files[name].suffix not in reader.turns)
            np.testing.assert_allclose(low / scale, SHEET.vertices.min(axis=0), atol=2e-4, err_msg=name)
            np.testing.assert_allclose(high / scale, SHEET.vertices.max(axis=0), atol=2e-4, err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize(
    "reader", [readers.TRIMESH, readers.USD_CORE, readers.GLTF_TRANSFORM, readers.BABYLON], ids=lambda each: each.name
)
def test_libraries_read_them(reader: Reader, files: dict[str, Path]) -> None:
    check(reader, files)


@pytest.mark.slow
def test_blender_imports_them(files: dict[str, Path]) -> None:
    if readers.blender_folder() is None:
        pytest.skip("Blender is not installed, 1.4 GB: `python -m tests.bench formats` does it")
    check(readers.BLENDER, files)


@pytest.mark.slow
def test_godot_imports_them(files: dict[str, Path]) -> None:
    check(readers.GODOT, files)
