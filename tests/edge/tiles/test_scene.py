"""A scene of a few tiles from points to tileset: levels, seams, failures, cancelling, and going on after a kill -9."""

from __future__ import annotations

import io
import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

from capture2vr.edge.arrays import no_tick
from capture2vr.edge.asset.target import NO_TARGET
from capture2vr.edge.capture.nouns import Cloud, CloudParts
from capture2vr.edge.convert.join_tiles import join_tiles
from capture2vr.edge.engine.address import open_engine
from capture2vr.edge.engine.nouns import Engine, Needs, OpenEngine
from capture2vr.edge.errors import Cancelled, EdgeError
from capture2vr.edge.export.tileset import TILESET_FILE
from capture2vr.edge.job_resources import JobResources
from capture2vr.edge.mesh.edges import border_edges
from capture2vr.edge.mesh.nouns import Mesh
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.preset import load_preset
from capture2vr.edge.progress import Bar, Clock, Progress, Watch, ignore_progress
from capture2vr.edge.render.posed_picture import PosedPicture
from capture2vr.edge.texture import texture_mesh
from capture2vr.edge.tiles import tile_points
from capture2vr.edge.tiles.folder import SceneFolder
from capture2vr.edge.tiles.grid import TileGrid, name_of
from capture2vr.edge.tiles.level_files import LevelFiles
from capture2vr.edge.tiles.parts import Span, run_parts
from capture2vr.edge.tiles.scene import TILE_STARTS, LargeScene, TiledScene, choose_grid, reconstruct_tiles
from capture2vr.edge.tiles.tile_levels import Node, ancestor_level, tile_level
from capture2vr.edge.tiles.tile_points import bounds_of, sort_into_tiles, thin_tile
from capture2vr.edge.tiles.tile_views import TileViews
from tests.edge.tiles.hall import hall
from tests.referees.glb_reader import Glb
from tests.support import surfaces
from tests.support.patience import PATIENCE_S

CELL_M = 0.01
ROOM = Needs(2, 0, 4 << 30)
Made = tuple[TiledScene, list[Progress], Path]
PRESET = replace(load_preset("scene-tiles"), resolution=184)  # cells along the hall's floor


def points() -> Points:
    """The hall in metres, one cell to a centimetre, with colours."""
    xyz = hall() * CELL_M
    rgb = np.clip(60 + 100 * xyz, 0, 255).astype(np.uint8)
    return Points(xyz, rgb, np.ones(len(xyz), np.float32), 1.0, "metric", np.array([0.0, 1, 0]))


def run(
    folder: Path, watch: Watch = ignore_progress, engine: OpenEngine | None = None, some: Points | None = None
) -> tuple[TiledScene, list[Progress]]:
    """Make the scene, in tiles of some 100 cells. some: its points; None: the hall"""
    bar = Bar(watch)
    bar.set_range(TILE_STARTS, 0.0, 1.0)
    scene = LargeScene(some or points(), np.eye(4), PRESET, NO_TARGET)
    steps = reconstruct_tiles(scene, folder, Clock(), bar, JobResources(engine=engine), side=100)
    said = []
    while True:
        try:
            said.append(next(steps))
        except StopIteration as ended:
            return ended.value, said


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("scene")
    return *run(folder), folder


@pytest.mark.slow
def test_every_tile_and_ancestor_is_a_file(made: Made) -> None:
    scene, _, _ = made
    nodes = list(scene.root)
    assert (scene.tiles, scene.levels) == (2, 2)
    assert {node.name for node in nodes} == set(scene.files)
    assert all(path.read_bytes().startswith(b"glTF") for path in scene.files.values())
    assert json.loads(scene.document)["asset"]["version"] == "1.1"


@pytest.mark.slow
def test_a_tile_of_slivers_alone_is_empty(made: Made) -> None:
    """A surface may reach into a tile by less than what positions are rounded to."""
    corner = made[0].grid.corner_of((1, 0, 0)) + 5
    sliver = Mesh(corner + np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-4, 0]]), np.array([[0, 1, 2]]))
    points = Cloud(sliver.vertices, np.full((3, 3), 90, np.uint8))
    level = tile_level(no_tick, sliver, points, [red_picture()], made[0].grid, (1, 0, 0), NO_TARGET)
    assert (len(level.mesh.faces), level.content) == (0, b"")


@pytest.mark.slow
def test_an_ancestor_is_coarser_and_says_by_how_much(made: Made) -> None:
    root = made[0].root
    assert root.children
    assert all(child.error_m == 0 for child in root.children)
    assert 0 < root.error_m < CELL_M
    assert len(made[0].mesh.faces) < 0.8 * made[0].triangles


@pytest.mark.slow
def test_the_whole_of_a_street_keeps_as_many_triangles_as_a_tile() -> None:
    """Its tiles lie in a row, so two are merged at a time, where on a floor it is four."""
    grid = TileGrid(np.zeros(3), CELL_M, np.array([64, 64, 64]))
    nodes = {Node(0, (number, 0, 0)): wavy_tile(number) for number in range(8)}
    while len(nodes) > 1:
        children: dict[Node, list[Mesh]] = {}
        for node, mesh in nodes.items():
            children.setdefault(node.parent, []).append(mesh)
        nodes = {node: ancestor_level(no_tick, below, 0.0, grid, node, NO_TARGET).mesh
                 for node, below in children.items()}  # fmt: skip
    (whole,) = nodes.values()
    assert 0.9 * len(wavy_tile(0).faces) < len(whole.faces) <= len(wavy_tile(0).faces)


def wavy_tile(number: int) -> Mesh:
    """A tile of 64 cells in a row of them, metres."""
    sheet = surfaces.patch(lambda u, v: [u, v, 0 * u], 64, 64)
    x, z, _ = ((sheet.vertices + 0.5) * 64).T
    x = x + 64 * number
    return Mesh(CELL_M * np.stack([x, 20 + 3 * np.sin(x / 5) * np.cos(z / 6), z], axis=1), sheet.faces)


@pytest.mark.slow
def test_tiles_as_delivered_share_their_border_vertices(made: Made) -> None:
    scene = made[0]
    assert_they_meet(*(Glb.of(scene.files[child.name].read_bytes()) for child in scene.root.children))


def assert_they_meet(left: Glb, right: Glb) -> None:
    """Assert that border vertices of one tile near those of the other are vertices of both."""
    rims = [rim(file) for file in (left, right)]
    near = rims[0][cKDTree(rims[1]).query(rims[0])[0] < 0.3 * CELL_M]
    assert len(near) > 50
    assert {tuple(place) for place in near} <= {tuple(place) for place in rims[1]}


def rim(file: Glb) -> np.ndarray:
    """Border vertices of a tile, metres; those of a texture's seams are inside."""
    places, number = np.unique(file.positions.round(6), axis=0, return_inverse=True)
    return np.asarray(places[np.unique(border_edges(number.ravel()[file.faces.astype(np.int64)]))])


def red_picture() -> PosedPicture:
    """A red picture of the hall from above; its points have other colours."""
    down = np.array([[1.0, 0, 0, -0.95], [0, 0, 1, -0.3], [0, -1, 0, 3], [0, 0, 0, 1]])
    red = np.broadcast_to(np.array([200, 10, 10], np.uint8), (64, 64, 3))
    return PosedPicture(down, np.array([1.0, 1]), np.array([0.5, 0.5]), lambda: red)


def made_again(made: Made, folder: Path, nodes: list[Node], engine: Engine | None = None) -> list[Glb]:
    """Make tiles of a scene again, in a copy of its folder, with a picture that shows them."""
    shutil.copytree(made[2], folder)
    files = LevelFiles(SceneFolder(folder), made[0].grid, TileViews([red_picture()]), NO_TARGET)
    for node in nodes:
        (folder / "level" / f"{node.name}.json").unlink()
    bar = Bar(ignore_progress)
    bar.set_range(TILE_STARTS, 0.0, 1.0)
    list(run_parts(engine, nodes, files.work_of_tiles(), Span(bar, "TEXTURING")))
    return [Glb.of((folder / "level" / f"{node.name}.glb").read_bytes()) for node in nodes]


@pytest.mark.slow
def test_a_tile_that_pictures_show_gets_a_texture_of_them(made: Made, tmp_path: Path) -> None:
    with open_engine("local", ROOM) as engine:
        (content,) = made_again(made, tmp_path / "scene", [Node(0, (0, 0, 0))], engine)
    with Image.open(io.BytesIO(content.image)) as texture:
        colours = np.asarray(texture.convert("RGB")).reshape(-1, 3).astype(int)
    red, green, blue = colours.T  # in the brightness of the points, whose green and blue are 60 at least
    assert ((red > 80) & (green < 30) & (blue < 30)).mean() > 0.3


@pytest.mark.slow
def test_tiles_still_meet_where_a_texture_needs_fewer_triangles(
    made: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(texture_mesh, "_FACES", 2_000)
    nodes = [Node(0, (0, 0, 0)), Node(0, (1, 0, 0))]
    left, right = made_again(made, tmp_path / "scene", nodes)
    assert left.image
    assert right.image
    assert len(left.faces) <= 2_000 < made[0].triangles / 2
    assert_they_meet(left, right)


@pytest.mark.parametrize(("size", "cell"), [(0.1, 5e-5), (2.0, 1e-3), (4.0, 0.01)])
def test_a_thing_gets_finer_cells_than_a_room(size: float, cell: float) -> None:
    xyz = np.random.default_rng(0).uniform(0, size, (20_000, 3)) * (1, 1, 0)
    cloud = Points(xyz, None, np.ones(len(xyz), np.float32), 1.0, "metric", np.array([0.0, 1, 0]))
    preset = load_preset("scene-tiles")
    grid = choose_grid(cloud, 50_000_000, np.eye(4), xyz.min(axis=0), xyz.max(axis=0), preset)
    assert grid.cell == pytest.approx(cell, rel=0.01)


@pytest.mark.slow
def test_a_scene_of_millimetres_keeps_its_triangles(tmp_path: Path) -> None:
    """As scanners of small things make it: steps of 0.1 mm are coarser than its cells."""
    hall_m = points()
    scene, _ = run(tmp_path / "scene", some=replace(hall_m, xyz=hall_m.xyz * 0.005, scale_confidence="unknown"))
    assert scene.grid.cell < 1e-4
    tiles = [Glb.of(scene.files[node.name].read_bytes()) for node in scene.root if not node.children]
    assert sum(len(tile.faces) for tile in tiles) > 0.99 * scene.triangles
    files = {TILESET_FILE: scene.document} | {name: path.read_bytes() for name, path in scene.files.items()}
    whole = join_tiles(files.__getitem__, lambda: scene.mesh)
    assert len(np.unique(whole.faces)) == len(whole.vertices) > 0.45 * scene.triangles
    assert (np.diff(np.sort(whole.faces, axis=1), axis=1) > 0).all()


@pytest.mark.slow
def test_progress_counts_tiles(made: Made) -> None:
    said = [step.message for step in made[1] if step.stage == "EXTRACTING"]
    assert said[-3:] == ["0 of 2 tiles", "1 of 2 tiles", "2 of 2 tiles"]
    fractions = [step.fraction for step in made[1]]
    assert fractions == sorted(fractions)


@pytest.mark.slow
def test_points_may_come_in_parts(made: Made, tmp_path: Path) -> None:
    whole = points()

    def parts() -> Iterator[Cloud]:
        for rows in np.array_split(np.arange(len(whole)), 7):
            assert whole.rgb is not None
            yield Cloud(whole.xyz[rows], whole.rgb[rows])

    some = CloudParts(len(whole), parts)
    low, high = bounds_of(some, np.eye(4), no_tick)
    files = SceneFolder(tmp_path / "scene")
    files.begin({})
    sort_into_tiles(some, np.eye(4), choose_grid(whole, len(whole), np.eye(4), low, high, PRESET, 100), files, no_tick)
    assert files.tiles == SceneFolder(made[2]).tiles


@pytest.mark.slow
def test_a_crowded_tile_is_thinned_in_parts(made: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a tile beside a scanner must be; the points are the same."""
    shutil.copytree(made[2], tmp_path / "scene")
    files, tile = SceneFolder(tmp_path / "scene"), (0, 0, 0)
    cells, rgb = files.load_points(name_of(tile))
    read, counts = np.fromfile, list[int]()

    def count(*args: object, **named: object) -> np.ndarray:
        part = read(*args, **named)  # type: ignore[call-overload]
        counts.append(len(part))
        return np.asarray(part)

    monkeypatch.setattr(tile_points, "_PART", 1_000)
    monkeypatch.setattr(np, "fromfile", count)
    thin_tile(files, made[0].grid, tile, coloured=True)
    again, colours = files.load_points(name_of(tile))
    assert again.tobytes() == cells.tobytes()
    assert colours.tobytes() == rgb.tobytes()
    assert sum(counts) == (files.tiles or {})[name_of(tile)]
    assert max(counts) <= 1_000


@pytest.mark.slow
def test_an_engine_makes_the_same_meshes(made: Made, tmp_path: Path) -> None:
    """In two processes, to the last bit; what is there already is not made again."""
    scene, said = run(tmp_path / "scene", engine=lambda: open_engine("local", ROOM))
    here, there = SceneFolder(made[2]), SceneFolder(tmp_path / "scene")
    for name in here.tiles or {}:
        assert there.path("mesh", name).read_bytes() == here.path("mesh", name).read_bytes()
    assert scene.mesh.vertices.tobytes() == made[0].mesh.vertices.tobytes()
    assert scene.document == made[0].document
    assert [step.message for step in said if step.stage == "EXTRACTING"][-1] == "2 of 2 tiles"

    def refuse() -> AbstractContextManager[Engine]:
        raise EdgeError("ENGINE_LOST", "there is none", retryable=True)

    with pytest.raises(EdgeError, match="there is none"):
        run(tmp_path / "other", engine=refuse)


@pytest.mark.slow
def test_a_cancelled_scene_stops_inside_a_tile(tmp_path: Path) -> None:
    def stop(progress: Progress) -> None:
        if progress.stage == "EXTRACTING":
            raise Cancelled

    with pytest.raises(Cancelled):
        run(tmp_path / "scene", stop)
    assert not list((tmp_path / "scene" / "mesh").glob("*.npz"))


@pytest.mark.slow
def test_a_tile_that_always_fails_is_named(tmp_path: Path, made: Made) -> None:
    folder = tmp_path / "scene"

    def spoil(progress: Progress) -> None:
        if progress.stage == "EXTRACTING" and folder.exists():
            (folder / "points" / "1-0-0.npz").write_bytes(b"a disk error")

    with pytest.raises(EdgeError, match=r"tile [01]-0-0 of the scene failed 3 times") as error:
        run(folder, spoil)
    assert error.value.code == "TILE_FAILED"
    assert error.value.hints


@pytest.mark.slow
def test_a_killed_run_goes_on_from_finished_tiles(tmp_path: Path, made: Made) -> None:
    folder = tmp_path / "scene"
    program = f"from pathlib import Path; from tests.edge.tiles.test_scene import run; run(Path({str(folder)!r}))"
    first = folder / "mesh" / "0-0-0.npz"
    with subprocess.Popen([sys.executable, "-c", program]) as child:
        deadline = time.monotonic() + PATIENCE_S
        while not first.exists() and child.poll() is None and time.monotonic() < deadline:
            time.sleep(0.01)
        child.send_signal(signal.SIGKILL)
    finished = first.stat().st_mtime_ns
    scene, _ = run(folder)
    assert first.stat().st_mtime_ns == finished
    assert {node.sha256 for node in scene.root} == {node.sha256 for node in made[0].root}


def test_other_points_begin_anew(tmp_path: Path) -> None:
    files = SceneFolder(tmp_path / "scene")
    files.begin({"points": 1})
    kept, other = files.path("mesh", "0-0-0"), {"points": 2}
    kept.write_bytes(b"")
    files.begin({"points": 1})
    assert kept.exists()
    files.begin(other)
    assert not kept.exists()
