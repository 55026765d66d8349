"""Programs of others that read what is downloaded: what each reads of a file. None of them is part of the product."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from trimesh.visual import TextureVisuals

from services.edge.arrays import Floats
from tests.referees.usd.reader import UsdCore
from tests.support.npm_packages import installed, wheels
from tests.support.patience import HANG_S

_HERE = Path(__file__).parent
_GODOT = ("godot3", "--audio-driver", "Dummy", "--video-driver", "GLES2")
_NOWHERE = subprocess.DEVNULL
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


def has_godot() -> bool:
    """Whether Godot 3 and a display in memory are installed: Debian's `godot3` and `xvfb`."""
    return bool(shutil.which("godot3") and shutil.which("Xvfb"))


def with_godot(files: Sequence[Path]) -> list[Reading]:
    """Godot's editor imports a project with the files, then a script counts. It tells no bounds."""
    project = files[0].parent / "godot"
    shutil.rmtree(project, ignore_errors=True)
    project.mkdir()
    (project / "project.godot").write_text('config_version=4\n[application]\nconfig/name="formats"\n')
    shutil.copy(_HERE / "godot.gd", project / "read.gd")
    names = [f"file{number}{file.suffix}" for number, file in enumerate(files)]
    for file, name in zip(files, names, strict=True):
        shutil.copy(file, project / name)
        for beside in [*file.parent.glob("*.mtl"), *file.parent.glob("*.jpg")] if file.suffix == ".obj" else []:
            shutil.copy(beside, project)
    display = subprocess.Popen(
        ["Xvfb", "-displayfd", "1", "-screen", "0", "640x480x24"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        assert display.stdout is not None
        number = display.stdout.readline().strip()  # told once it can be drawn on
        environment = os.environ | {
            "DISPLAY": f":{number}",
            "LIBGL_ALWAYS_SOFTWARE": "1",
            "HOME": str(project.parent / "home"),
        }
        _import(project, environment, names)
        said = _godot(project, environment, "-s", "read.gd", *(f"res://{name}" for name in names))
    finally:
        display.terminate()
        display.communicate()
    told = {line.split()[1]: line.split()[2:] for line in said.splitlines() if line.startswith("READ")}
    return [_counted(told.get(f"res://{name}", [])) for name in names]


def _import(project: Path, environment: Mapping[str, str], names: Sequence[str]) -> None:
    """Have Godot's editor import all files, and end it: left to itself 3.2 may crash or hang."""
    deadline = time.monotonic() + HANG_S
    editor = subprocess.Popen([*_GODOT, "-e"], cwd=project, env=environment, stdout=_NOWHERE, stderr=_NOWHERE)
    while not all(any(project.glob(f".import/{name}-*.md5")) for name in names) and time.monotonic() < deadline:
        time.sleep(0.05)
    editor.kill()
    editor.wait()


def _godot(project: Path, environment: Mapping[str, str], *arguments: str) -> str:
    """Run Godot in a project; return what it prints."""
    command = [*_GODOT, *arguments]
    done = subprocess.run(command, cwd=project, env=environment, capture_output=True, text=True, timeout=HANG_S)
    return done.stdout


def _counted(words: Sequence[str]) -> Reading:
    if len(words) != 2 or not words[0].isdigit():
        return Reading(fault="not imported")
    return Reading(int(words[0]), words[1])


def _told(command: Sequence[str], **options: Any) -> list[Reading]:
    done = subprocess.run(command, capture_output=True, text=True, timeout=HANG_S, **options)
    assert done.returncode == 0, done.stderr[-2000:]
    return [Reading.of(told) for told in json.load(io.StringIO(done.stdout))]


TRIMESH = Reader("trimesh", (".glb", ".obj", ".ply", ".stl"), with_trimesh)
USD_CORE = Reader("usd-core", (".usdz",), with_usd_core)
GLTF_TRANSFORM = Reader("glTF-Transform", (".glb",), _in_node("gltf_transform.mjs"))
BABYLON = Reader("Babylon.js", (".glb", ".obj", ".stl", ".ply"), _in_node("babylon.mjs"), turns=(".stl",))
BLENDER = Reader("Blender 4.2", (".glb", ".obj", ".ply", ".stl", ".usdz"), with_blender, z_up=True)
GODOT = Reader("Godot 3.2", (".glb", ".obj"), with_godot)

UNPACKS_MESHOPT = (GLTF_TRANSFORM, BABYLON)
"""Those that know EXT_meshopt_compression; the others say that they do not."""


def turned(reading: Reading, reader: Reader, file_z_up: bool) -> tuple[Floats, Floats]:
    """Corners of the box with Y up, whichever axis is up in the file and in the program."""
    assert reading.low is not None
    assert reading.high is not None
    corners = np.stack([reading.low, reading.high])
    if file_z_up or reader.z_up:
        corners = corners @ _TURNED.T
    return corners.min(axis=0), corners.max(axis=0)
