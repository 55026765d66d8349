"""What is measured on a thing: lengths, angles, heights and areas of known shapes, and how far off they may be."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from tests.support.page_scripts import PageScripts

SIZE = (0.4, 0.4, 0.4)
AREA = """async ([vertices, faces, loop]) => {
    const THREE = await import('/web/vendor/three-0.187.0.module.js');
    const { areaInside } = await import('/web/viewer/surface-area.js');
    const corners = vertices.map((vertex) => new THREE.Vector3(...vertex));
    const triangles = faces.map((face) => face.map((corner) => corners[corner]));
    return areaInside(loop.map((point) => new THREE.Vector3(...point)), triangles);
}"""
MEASURE = """async ([kind, points, manifest]) => {
    const THREE = await import('/web/vendor/three-0.187.0.module.js');
    const { accuracyOf, errorOf, measure } = await import('/web/viewer/measurement.js');
    const places = points.map((point) => new THREE.Vector3(...point));
    const value = measure(kind, places, () => [places.slice(0, 3)]);
    const accuracy = accuracyOf({ scale_confidence: manifest.scale, size_m: [1, 0.5, 0.5] }, manifest);
    return [value, errorOf({ kind, points: places, value, version: 1 }, accuracy)];
}"""


def test_lengths_angles_and_heights_are_exact(scripts: PageScripts) -> None:
    def of(kind: str, *points: list[float]) -> float:
        return float(scripts.evaluate(MEASURE, [kind, points, {"scale": "metric"}])[0])

    assert of("distance", [0, 0, 0], [0.3, 0.4, 1.2]) == pytest.approx(1.3, abs=1e-12)
    assert of("angle", [1, 0, 0], [0, 0, 0], [0, 2, 0]) == pytest.approx(90, abs=1e-9)
    assert of("angle", [1, 0, 0], [0, 0, 0], [-1, 0, 1]) == pytest.approx(135, abs=1e-9)
    assert of("height", [3, 0.7, 1]) == 0.7


def test_how_far_off_they_may_be_agrees_with_points_that_are_moved(scripts: PageScripts) -> None:
    """The worst first-order change by points that move by the surface's distance, combined as independent ones are."""
    point = 0.001  # of a longest side of one metre
    manifest = {"scale": "metric", "quality": {"held_out_mean": point}}
    around = np.random.default_rng(0).uniform(0, 2 * np.pi, 5)
    loop = np.column_stack([np.cos(np.sort(around)), np.sin(np.sort(around)), np.zeros(5)])
    for kind, points, of in (("angle", loop[:3], corner), ("area", loop, inside)):
        _, error = scripts.evaluate(MEASURE, [kind, points.tolist(), manifest])
        slopes = [slope(of, points, each) for each in range(len(points))]
        assert error == pytest.approx(point * np.linalg.norm(slopes), rel=1e-3), kind
    estimated = {"scale": "estimated", "quality": {"held_out_mean": point}, "edits": {"length": {"metres": 0.5}}}
    value, error = scripts.evaluate(MEASURE, ["distance", [[0, 0, 0], [1, 0, 0]], estimated])
    assert error == pytest.approx(np.hypot(2**0.5 * point, 2**0.5 * point / 0.5 * value))
    assert scripts.evaluate(MEASURE, ["distance", [[0, 0, 0], [1, 0, 0]], {**manifest, "scale": "unknown"}])[1] is None
    by_model = {**estimated, "scale_by_model": True}
    assert scripts.evaluate(MEASURE, ["distance", [[0, 0, 0], [1, 0, 0]], by_model])[1] is None
    assert scripts.evaluate(MEASURE, ["distance", [[0, 0, 0], [1, 0, 0]], {"scale": "metric"}])[1] is None


def corner(points: np.ndarray) -> float:
    """The angle at the second of three points, in degrees."""
    one, other = points[0] - points[1], points[2] - points[1]
    return float(np.degrees(np.arccos(one @ other / np.linalg.norm(one) / np.linalg.norm(other))))


def inside(loop: np.ndarray) -> float:
    """The area of a loop on the plane z = 0 (the shoelace formula)."""
    (x, y), (u, v) = loop[:, :2].T, np.roll(loop, -1, axis=0)[:, :2].T
    return float(abs((x * v - u * y).sum()) / 2)


def slope(of: Callable[[np.ndarray], float], points: np.ndarray, moved: int) -> float:
    """How much a figure changes with the place of one of its points at most, by differences."""
    steps = [np.where(np.arange(len(points))[:, None] == moved, step, 0) for step in np.eye(3) * 1e-6]
    return float(np.linalg.norm([(of(points + step) - of(points - step)) / 2e-6 for step in steps]))


def area(scripts: PageScripts, mesh: trimesh.Trimesh, loop: np.ndarray | list[list[float]]) -> float | None:
    found: float | None = scripts.evaluate(
        AREA, [mesh.vertices.tolist(), mesh.faces.tolist(), np.asarray(loop).tolist()]
    )
    return found


def test_the_area_of_a_face_leaves_the_other_side_of_the_box_out(scripts: PageScripts) -> None:
    cube = trimesh.creation.box(SIZE).subdivide().subdivide()
    corners = np.array([[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]]) * 0.2
    assert area(scripts, cube, corners) == pytest.approx(0.16, abs=1e-9)
    assert area(scripts, cube, corners[::-1]) == pytest.approx(0.16, abs=1e-9), "in whichever order"
    assert area(scripts, cube, corners * [0.5, 0.31, 1]) == pytest.approx(0.16 * 0.5 * 0.31, abs=1e-9)
    hooked = np.array([[0, 0], [0.1, 0], [0.1, 0.1], [0.05, 0.02]])  # with a corner that points inward
    assert area(scripts, cube, np.column_stack([hooked, np.full(4, 0.2)])) == pytest.approx(0.0035, abs=1e-9)
    assert area(scripts, cube, corners[[0, 2, 1, 3]]) is None, "its lines cross"
    assert area(scripts, cube, [[0, 0, 0.2], [0.1, 0, 0.2], [0.2, 0, 0.2]]) is None, "one line has no inside"


def test_the_area_of_a_curved_surface_is_that_of_its_triangles(scripts: PageScripts) -> None:
    ball = trimesh.creation.icosphere(subdivisions=4)
    around = np.linspace(0, 2 * np.pi, 12, endpoint=False) + 0.1
    loop = np.column_stack([0.6 * np.cos(around), 0.8 * np.ones(12), 0.6 * np.sin(around)])
    crumbs = ball.subdivide().subdivide().subdivide()  # the same surface; each crumb is inside or not
    middles, ends = crumbs.triangles_center, np.roll(loop, -1, axis=0)
    inward = np.cross(ends - loop, [0, 1, 0]) * -1
    inward *= np.sign((inward * -loop).sum(axis=1))[:, None]
    kept = ((middles @ inward.T - (loop * inward).sum(axis=1)) > 0).all(axis=1) & (middles[:, 1] > 0)
    cap = float(crumbs.area_faces[kept].sum())
    assert area(scripts, ball, loop) == pytest.approx(cap, rel=1e-3)
    assert cap > 1.05 * 0.36 * 6 * np.sin(np.pi / 6), "more than the flat polygon"
    fine = np.linspace(0, 2 * np.pi, 128, endpoint=False)
    latitude = np.column_stack([0.75**0.5 * np.cos(fine), np.full(128, 0.5), 0.75**0.5 * np.sin(fine)])
    assert area(scripts, ball, latitude) == pytest.approx(np.pi, rel=3e-3), "2πh (Archimedes), the other side left out"


def test_a_sheet_behind_and_torn_off_is_not_counted_but_a_seam_is_crossed(scripts: PageScripts) -> None:
    front = trimesh.creation.box((1, 1, 1e-9))
    square = np.array([[-0.4, -0.4, 0], [0.4, -0.4, 0], [0.4, 0.4, 0], [-0.4, 0.4, 0]])
    vertices = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    sheet = trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], process=False)
    behind = trimesh.Trimesh(vertices - [0, 0, 0.2], [[0, 1, 2], [0, 2, 3]], process=False)
    assert area(scripts, trimesh.util.concatenate([sheet, behind]), square) == pytest.approx(0.64, abs=1e-9)
    assert area(scripts, sheet, square) == area(scripts, front, square)
    split = trimesh.Trimesh(np.concatenate([vertices, vertices + 1e-6]), [[0, 1, 2], [4, 6, 7]], process=False)
    assert area(scripts, split, square) == pytest.approx(0.64, abs=1e-5), "corners that are rounded apart are one"
