"""Programs of others that read what is downloaded: what each reads of a file. None of them is part of the product."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from trimesh.visual import TextureVisuals

from capture2vr.edge.arrays import Floats
from tests.referees.godot.engine import project
from tests.referees.usd.reader import UsdCore
from tests.support.npm_packages import installed, wheels
from tests.support.patience import HANG_S
from tests.support.repository import ROOT

_HERE = Path(__file__).parent
_ADDON = ROOT / "clients" / "godot" / "addons" / "capture2vr"
_TURNED = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # from Z up to Y up


@dataclass(frozen=True)
class Reading:
    """What a program has read of a file.

    colours    texture | vertices | none
    low, high  corners of the bounding box as the program has it; None where it does not say
    fault      why it could not be read, or ""
    """

    triangles: int = 0
    colours: str = ""
    low: Floats | None = None
    high: Floats | None = None
    fault: str = ""

    @classmethod
    def of(cls, told: Mapping[str, Any]) -> Reading:
        if fault := told.get("fault"):
            return cls(fault=fault)
        corners = [np.array(told[name], float) if name in told else None for name in ("low", "high")]
        return cls(round(told["triangles"]), told["colours"], *corners)


Read = Callable[[Sequence[Path]], list[Reading]]


@dataclass(frozen=True)
class Reader:
    """A program.

    endings   of the files that it reads
    z_up      whether its world has Z up, so that it turns files with Y up
    turns     endings of files with Z up that it turns, so that Y is up
    """

    name: str
    endings: tuple[str, ...]
    read: Read
    z_up: bool = False
    turns: tuple[str, ...] = ()


def opened(files: Sequence[Path]) -> list[Path]:
    """The file that a program opens: of a zip the OBJ in it, unpacked beside it."""
    found = []
    for file in files:
        if file.suffix == ".zip":
            folder = file.with_suffix("")
            with zipfile.ZipFile(file) as package:
                package.extractall(folder)
            found += sorted(folder.glob("*.obj"))
        else:
            found.append(file)
    return found


def with_trimesh(files: Sequence[Path]) -> list[Reading]:
    """trimesh, the library: what the product itself uses to write some of them."""
    readings = []
    for file in files:
        found = trimesh.load(file, process=False)
        meshes = found.dump() if isinstance(found, trimesh.Scene) else [found]
        textured = any(isinstance(mesh.visual, TextureVisuals) and mesh.visual.uv is not None for mesh in meshes)
        colours = "texture" if textured else "vertices" if meshes[0].visual.kind == "vertex" else "none"
        low, high = found.bounds
        readings.append(Reading(sum(len(mesh.faces) for mesh in meshes), colours, low, high))
    return readings


def with_usd_core(files: Sequence[Path]) -> list[Reading]:
    """usd-core, with its validators."""
    return [
        Reading(
            len(told.corners),
            "texture" if told.picture else "none",
            told.points.min(axis=0),
            told.points.max(axis=0),
            "; ".join(told.faults),
        )
        for told in UsdCore()(*files)
    ]


def _in_node(script: str) -> Read:
    def read(files: Sequence[Path]) -> list[Reading]:
        folder = installed("formats", _HERE, what="Babylon.js and glTF-Transform")
        return _told(["node", str(_HERE / script), *map(str, files)], cwd=folder)

    return read


def blender_folder() -> Path | None:
    """Where Blender's module is installed; None where it has not been: `install_blender` does it, 1.4 GB."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "capture2vr"
    return next(cache.glob("blender-*[0-9a-f]"), None)


def install_blender() -> Path:
    """Install Blender's module outside the checkout, once."""
    return wheels("blender", _HERE / "requirements.txt", what="Blender")


def with_blender(files: Sequence[Path], renders: Mapping[Path, Path] | None = None) -> list[Reading]:
    """Blender without a window. renders: by file, the picture to draw it into"""
    folder = blender_folder()
    assert folder is not None
    arguments: list[str] = []
    for file in files:
        arguments += ["--render", str(renders[file])] if renders and file in renders else []
        arguments.append(str(file))
    environment = os.environ | {"PYTHONPATH": str(folder)}
    return _told([sys.executable, str(_HERE / "blender.py"), *arguments], env=environment)


def with_godot(files: Sequence[Path]) -> list[Reading]:
    """Godot's editor imports the files, those of `EXT_meshopt_compression` by our addon; a script counts."""
    folder = files[0].parent / "godot"
    shutil.rmtree(folder, ignore_errors=True)
    made = project(folder, _ADDON)
    made.add([_HERE.parent / "godot" / "count.gd"])
    names = [f"file{number}{file.suffix}" for number, file in enumerate(files)]
    for file, name in zip(files, names, strict=True):
        shutil.copy(file, made.folder / name)
        if file.suffix == ".obj":
            made.add([*file.parent.glob("*.mtl"), *file.parent.glob("*.jpg")])
    made.import_files()
    said = made.run("-s", "res://count.gd", "--", *(f"res://{name}" for name in names))
    told = [json.loads(line.removeprefix("READ ")) for line in said.splitlines() if line.startswith("READ ")]
    assert len(told) == len(files), said
    return [Reading.of(each) for each in told]


def _told(command: Sequence[str], **options: Any) -> list[Reading]:
    done = subprocess.run(command, capture_output=True, text=True, timeout=HANG_S, **options)
    assert done.returncode == 0, done.stderr[-2000:]
    return [Reading.of(told) for told in json.load(io.StringIO(done.stdout))]


TRIMESH = Reader("trimesh", (".glb", ".obj", ".ply", ".stl"), with_trimesh)
USD_CORE = Reader("usd-core", (".usdz",), with_usd_core)
GLTF_TRANSFORM = Reader("glTF-Transform", (".glb",), _in_node("gltf_transform.mjs"))
BABYLON = Reader("Babylon.js", (".glb", ".obj", ".stl", ".ply"), _in_node("babylon.mjs"), turns=(".stl",))
BLENDER = Reader("Blender 4.2", (".glb", ".obj", ".ply", ".stl", ".usdz"), with_blender, z_up=True)
GODOT = Reader("Godot 4.6", (".glb", ".obj"), with_godot)

UNPACKS_MESHOPT = (GLTF_TRANSFORM, BABYLON, GODOT)
"""Those that know EXT_meshopt_compression, Godot by our addon; the others say that they do not."""


def turned(reading: Reading, reader: Reader, file_z_up: bool) -> tuple[Floats, Floats]:
    """Corners of the box with Y up, whichever axis is up in the file and in the program."""
    assert reading.low is not None
    assert reading.high is not None
    corners = np.stack([reading.low, reading.high])
    if file_z_up or reader.z_up:
        corners = corners @ _TURNED.T
    return corners.min(axis=0), corners.max(axis=0)
