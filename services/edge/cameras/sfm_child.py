"""Child process that runs structure from motion with pycolmap: `python -m capture2vr.edge.cameras.sfm_child FOLDER`.

Reads the `SfmProblem` in FOLDER, writes the `SfmResult` there, and its progress to stdout, one JSON object per line.
COLMAP's first pixel has its centre at (0.5, 0.5), ours at (0, 0): coordinates are converted on the way in and out.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from capture2vr.edge.arrays import Floats, Ints
from capture2vr.edge.cameras.sfm_database import (
    SEED,
    add_matches,
    colmap_camera,
    contradicted_photos,
    drop_contradicting_matches,
    limit_factor,
    match,
    name_of,
    write_database,
)
from capture2vr.edge.cameras.sfm_process import ANSWER, PROBLEM, Lens, SfmProblem, SfmResult, read_problem, write_answer
from capture2vr.edge.cameras.wide_lens import FISHEYE, lens_of_fisheye, refine_wide_lenses
from capture2vr.edge.capture.nouns import Intrinsics
from capture2vr.edge.child_process import ReportFraction, set_up_child

_MATCHING = 0.7  # share of the time that matching takes for 20 to 50 photos; the mapper takes the rest
_SMALLEST_MODEL = 3  # photos of a model
_FEWEST_INLIERS = 15  # points that place a photo; COLMAP's 30 split 20 photos of fruit of 600 x 400 into 9, 7 and 6
_MOST_MODELS = 5  # with more, the photos do not show one object
_BENT = 0.1  # share of a model's photos that it contradicts, above which the others cannot be trusted either
_ADJUSTING_SECONDS = 60.0  # most time for each bundle adjustment of global mapping; all of it takes 300 photos 110 s
_ANY_DISTORTION = 1e6  # COLMAP drops every point of a camera with a coefficient over 1; a long lens has k3 = -6.3
_MOST_MAPPING_SECONDS = 300  # after which the mapper ends with what it has placed; 100 photos take 10, 300 take 60


def main(folder: Path) -> None:
    """Solve the problem in `folder`; every failure is a non-zero exit with its reason on stderr."""
    report = set_up_child()
    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.ERROR)
    pycolmap.set_random_seed(SEED)
    problem = read_problem(folder / PROBLEM)
    database = folder / "database.db"
    write_database(problem, database)
    match(problem, database, folder / "pairs.txt", lambda done: report(_MATCHING * done))
    if problem.learned is not None:
        add_matches(problem, problem.learned, database, folder / "pairs.txt")
    if problem.poses is None:
        models = _map_incrementally(problem, database, folder, lambda done: report(_MATCHING + (1 - _MATCHING) * done))
        if problem.learned is not None:
            models = _without_contradicted_photos(problem, database, models)
        if problem.thorough and _most_placed(models) < len(problem.features):
            others = _without_contradicted_photos(problem, database, _map_globally(database, folder))
            models = max([models, others], key=_most_placed)
        if models:
            options = _options(limit_factor(problem), given=True)
            models = [refine_wide_lenses(database, folder, models[0], options), *models[1:]]
    else:
        drop_contradicting_matches(problem, database)
        models = [_triangulate(problem, database, folder)]
    write_answer(_answer(problem, models), folder / ANSWER)


def _lens(camera: Any) -> Lens:
    """Convert a solved camera, SIMPLE_RADIAL or a fisheye, to a lens."""
    if camera.model_name == FISHEYE:
        return lens_of_fisheye(camera)
    focal, cx, cy, k1 = (float(value) for value in camera.params)
    intrinsics = Intrinsics(focal, focal, cx - 0.5, cy - 0.5, camera.width, camera.height)
    return Lens(intrinsics, (k1, 0.0, 0.0, 0.0, 0.0), known=True)


def _options(slack: float, *, given: bool) -> Any:
    """Return the mapper's options: fewer and shorter bundle adjustments, and limits that suit the features' resolution.

    With 50 photos, bundle adjustment takes a third of the time, at the same error of the positions.
    """
    options = pycolmap.IncrementalPipelineOptions(
        min_model_size=_SMALLEST_MODEL,
        max_num_models=_MOST_MODELS,
        extract_colors=False,
        max_runtime_seconds=_MOST_MAPPING_SECONDS,
        num_threads=1,  # on two threads the same photos gave cameras that differed in the fifth digit
        random_seed=SEED,
        ba_global_frames_ratio=1.4,
        ba_global_points_ratio=1.4,
        ba_global_max_refinements=2,
        ba_local_max_refinements=1,
        ba_global_max_num_iterations=20,
        ba_local_max_num_iterations=12,
        ba_global_function_tolerance=1e-4,
        ba_local_function_tolerance=1e-4,
    )
    if given:
        options.max_extra_param = _ANY_DISTORTION
    options.mapper.init_max_error *= slack
    options.mapper.abs_pose_max_error *= slack
    options.mapper.abs_pose_min_num_inliers = _FEWEST_INLIERS
    options.mapper.filter_max_reproj_error *= slack
    options.triangulation.merge_max_reproj_error *= slack
    options.triangulation.complete_max_reproj_error *= slack
    return options


def _map_incrementally(problem: SfmProblem, database: Path, folder: Path, report: ReportFraction) -> list[Any]:
    """Run incremental mapping: the models, the largest first."""
    placed = 0

    def next_placed() -> None:
        nonlocal placed
        placed += 1
        report(min(1.0, placed / len(problem.features)))

    models = pycolmap.incremental_mapping(
        database, folder, folder, _options(limit_factor(problem), given=False), next_image_callback=next_placed
    )
    return _largest_first(models)


def _map_globally(database: Path, folder: Path) -> list[Any]:
    """Run global mapping, which solves for all photos at once and needs no good pair to begin with: the models.

    Linfei Pan et al., "Global Structure-from-Motion Revisited", ECCV 2024 (GLOMAP). With few matches a pair it places
    photos where the incremental mapper stops. It is no replacement: of 300 photos it takes half as long again.
    """
    options = pycolmap.GlobalPipelineOptions(num_threads=1, random_seed=SEED, min_model_size=_SMALLEST_MODEL)
    options.mapper.num_threads, options.mapper.random_seed = 1, SEED
    options.mapper.bundle_adjustment.ceres.solver_options.max_solver_time_in_seconds = _ADJUSTING_SECONDS
    return _largest_first(pycolmap.global_mapping(database, folder, folder, options))


def _largest_first(models: Mapping[int, Any]) -> list[Any]:
    """Sort the models that are large enough."""
    large = [model for model in models.values() if len(_placed_photos(model)) >= _SMALLEST_MODEL]
    return sorted(large, key=lambda model: (-model.num_reg_images(), -model.num_points3D()))


def _most_placed(models: Sequence[Any]) -> int:
    """Return the number of photos that the first model placed."""
    return len(_placed_photos(models[0])) if models else 0


def _without_contradicted_photos(problem: SfmProblem, database: Path, models: Sequence[Any]) -> list[Any]:
    """Remove photos whose matches contradict their model from it, and models with too many of them."""
    credible = []
    for model in models:
        contradicted = contradicted_photos(problem, database, model)
        if len(contradicted) <= _BENT * model.num_reg_images():
            for photo in contradicted:
                model.deregister_frame(photo + 1)
            credible.append(model)
    return credible


def _triangulate(problem: SfmProblem, database: Path, folder: Path) -> Any:
    """Triangulate points with the poses as given: one model."""
    assert problem.poses is not None
    model = pycolmap.Reconstruction()
    for number, lens in enumerate(problem.lenses, start=1):
        model.add_camera_with_trivial_rig(colmap_camera(number, lens, solved=False))
    for number, (lens_of, pose) in enumerate(zip(problem.lens_of, problem.poses, strict=True), start=1):
        xy = problem.features[number - 1].xy.astype(np.float64) + 0.5
        image = pycolmap.Image(name=name_of(number), keypoints=xy, camera_id=int(lens_of) + 1, image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.linalg.inv(pose)[:3]))
    return pycolmap.triangulate_points(
        model, database, folder, folder, options=_options(limit_factor(problem), given=True)
    )


def _answer(problem: SfmProblem, models: Sequence[Any]) -> SfmResult:
    """Convert the largest model to the result."""
    best = models[0] if models else pycolmap.Reconstruction()
    placed = np.array(_placed_photos(best), np.int32)
    lenses, poses = _lenses(problem, best, placed), _poses(problem, best, placed)
    return SfmResult(lenses, _model_of(len(problem.features), models), placed, poses, *_points(best, placed))


def _placed_photos(model: Any) -> list[int]:
    """Return the photos that see enough of the model's points; a photo with a given pose may see none."""
    return [
        number - 1 for number in sorted(model.reg_image_ids()) if model.image(number).num_points3D >= _FEWEST_INLIERS
    ]


def _lenses(problem: SfmProblem, model: Any, placed: Ints) -> tuple[Lens, ...]:
    """Return the lenses of the placed photos: as given with the poses, or as solved."""
    if problem.poses is not None:
        return tuple(problem.lenses[lens] for lens in problem.lens_of[placed])
    return tuple(_lens(model.image(photo + 1).camera) for photo in placed.tolist())


def _model_of(count: int, models: Sequence[Any]) -> Ints:
    """Return for each photo (N,) the first, hence largest, of the models that placed it, or -1."""
    found = np.full(count, -1, np.int32)
    for number in reversed(range(len(models))):
        found[_placed_photos(models[number])] = number
    return found


def _poses(problem: SfmProblem, model: Any, placed: Ints) -> Floats:
    """Return camera_to_world (V,4,4); given poses exactly as given, without rounding through a quaternion."""
    if problem.poses is not None:
        return problem.poses[placed]
    poses = np.tile(np.eye(4), (len(placed), 1, 1))
    for pose, photo in zip(poses, placed.tolist(), strict=True):
        pose[:3] = model.image(photo + 1).cam_from_world().inverse().matrix()
    return poses


def _points(model: Any, placed: Ints) -> tuple[Floats, Ints, Ints, Ints]:
    """Return xyz (P,3) of the points that two or more placed photos see, and per observation point, view, key point."""
    points = [point for _, point in sorted(model.points3D.items())]
    xyz = np.array([point.xyz for point in points]).reshape(-1, 3)
    seen = [
        (row, element.image_id - 1, element.point2D_idx)
        for row, point in enumerate(points)
        for element in point.track.elements
    ]
    table = np.array(seen, np.int32).reshape(-1, 3)
    table = table[np.isin(table[:, 1], placed)]
    table = table[np.bincount(table[:, 0], minlength=len(xyz))[table[:, 0]] >= 2]
    used, row = np.unique(table[:, 0], return_inverse=True)
    return xyz[used], row.astype(np.int32), np.searchsorted(placed, table[:, 1]).astype(np.int32), table[:, 2]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
