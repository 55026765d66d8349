"""The worker's inspection, and the readers behind it, in a process that has read nothing before."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from tests.edge.capture import test_posed_photos
from tests.edge.films.test_film import FILMS, VIEWS
from tests.edge.recordings import test_colmap
from tests.support import captures
from tests.support.fresh_process import run_fresh
from tests.support.photos import private_pictures

pytestmark = pytest.mark.slow

# A worker's inspection of each archive, and then every pixel, which readers decode only when asked. One interpreter
# loads what an inspection loads at its start, and forks for each: none knows what the others have loaded.
INSPECT = """
import os, sys, traceback
from pathlib import Path
from capture2vr.edge.read_capture import read_capture
from capture2vr.edge.jobs.inspection_work import inspect
from capture2vr.edge.jobs.unpack_capture import unpack_capture

def answer(archive, scratch):
    found = inspect(unpack_capture(archive, scratch), None)
    capture = read_capture(scratch / "capture")
    for frame in capture.frames:
        frame.load_depth_m()
        if frame.load_rgb:
            frame.load_rgb()
    for photo in capture.photos:
        photo.load()
    return f"{found.kind} {found.format}"

for folder in sorted(Path(sys.argv[1]).iterdir()):
    if os.fork() == 0:
        try:
            said = answer(folder / "capture.zip", folder)
        except BaseException:
            said = traceback.format_exc()
        (folder / "answer").write_text(said)
        os._exit(0)
    os.wait()
"""

XYZ, RGB, NORMALS = captures.sphere()


def _one_file(name: str, content: Callable[[], bytes], folder: Path) -> Path:
    folder.mkdir()
    (folder / name).write_bytes(content())
    return folder


def _las(name: str, folder: Path) -> Path:
    folder.mkdir()
    captures.save_las(folder / name, XYZ, RGB)
    return folder


def _mesh(kind: str, folder: Path) -> Path:
    folder.mkdir()
    exported = captures.hemisphere().export(file_type=kind)
    files = exported if isinstance(exported, dict) else {f"mesh.{kind}": exported}
    for name, content in files.items():
        (folder / name).write_bytes(captures.as_bytes(content))
    return folder


def _photos(kind: str, folder: Path) -> Path:
    folder.mkdir()
    for number in range(3):
        (folder / f"{number}.{kind}").write_bytes(getattr(private_pictures, kind)())
    return folder


def _film(kind: str, folder: Path) -> Path:
    name, make = FILMS[kind]
    folder.mkdir()
    make(folder / name, VIEWS)
    return folder


def _colmap(folder: Path) -> Path:
    folder.mkdir()
    test_colmap.write(folder)
    return folder


# What an inspection says of it, and how it is made.
CAPTURES: dict[str, tuple[str, Callable[[Path], Path]]] = {
    **{f"rgbd {kind}": (kind, write) for kind, write in captures.RGBD.items()},
    "rgbd r3d": ("record3d", captures.write_r3d),
    "photos polycam": ("polycam", test_posed_photos.polycam),
    "photos stray": ("stray", test_posed_photos.stray),
    "photos colmap": ("colmap", _colmap),
    **{f"photos {kind}": ("photos", partial(_photos, kind)) for kind in ("heic", "webp", "tiff", "png", "jpeg")},
    **{f"photos from {kind}": ("video", partial(_film, kind)) for kind in ("HEVC", "H.264", "VP9")},
    "points ply": ("ply", partial(_one_file, "a.ply", lambda: captures.ply_bytes(XYZ, RGB, NORMALS))),
    "points pcd": (
        "pcd",
        partial(_one_file, "a.pcd", lambda: captures.pcd_bytes(XYZ, RGB, NORMALS, form="binary_compressed")),
    ),
    "points npy": ("npy", partial(_one_file, "a.npy", lambda: captures.npy_bytes(XYZ))),
    "points las": ("las", partial(_las, "a.las")),
    "points laz": ("las", partial(_las, "a.laz")),
    **{f"points of {kind}": (kind, partial(_mesh, kind)) for kind in ("obj", "off", "stl", "glb", "gltf")},
}


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What a worker that has just started says of each of `CAPTURES`, and finds in it."""
    root = tmp_path_factory.mktemp("captures")
    folders = {name: root / f"{number:02}" for number, name in enumerate(CAPTURES)}
    for name, folder in folders.items():
        folder.mkdir()
        _, make = CAPTURES[name]
        made = Path(str(make(tmp_path_factory.mktemp("made") / "given")))
        if made.suffix == ".r3d":  # is a zip itself, and goes to the worker as it is
            shutil.copy(made, folder / "capture.zip")
        else:
            shutil.make_archive(str(folder / "capture"), "zip", made)
    run_fresh(INSPECT, root, extras=["edge"], cwd=root)
    return {name: (folder / "answer").read_text() for name, folder in folders.items()}


@pytest.mark.parametrize("name", CAPTURES)
def test_a_worker_that_has_just_started_inspects_and_reads_it(name: str, answers: dict[str, str]) -> None:
    told, _ = CAPTURES[name]
    assert answers[name] == f"{name.partition(' ')[0]} {told}"
