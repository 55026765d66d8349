"""Child process that runs structure from motion with pycolmap: `python -m services.edge.photos.sfm_child FOLDER`.

Reads the `SfmProblem` in FOLDER, writes the `SfmResult` there, and its progress to stdout, one JSON object per line.
COLMAP's first pixel has its centre at (0.5, 0.5), ours at (0, 0): coordinates are converted on the way in and out.
"""

from __future__ import annotations

import ctypes
import json
import math
import os
import resource
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from services.edge.arrays import Floats, Ints
from services.edge.capture.nouns import Intrinsics
from services.edge.parallel import WORKERS
from services.edge.photos.match_pairs import epipolar_errors
from services.edge.photos.sfm_process import ANSWER, PROBLEM, Lens, SfmProblem, SfmResult, read_problem, write_answer

ReportFraction = Callable[[float], None]
"""Function that reports the fraction done."""

_SEED = 0
_PART = 100  # pairs matched per progress report: 1.5 s; 190 pairs in parts of 10 took twice as long
_MATCHING = 0.7  # share of the time that matching takes for 20 to 50 photos; the mapper takes the rest
_EPIPOLAR_PX = 4.0  # largest epipolar error of a match: COLMAP's own limit for matches of unposed photos
_CREDIBLE = 0.5  # least share of a pair's matches that its poses allow; true poses allow 0.8 to 1, wrong ones 0 to 0.1
_SMALLEST_MODEL = 3  # photos of a model
_FEWEST_INLIERS = 15  # points that place a photo; COLMAP's 30 split 20 photos of fruit of 600 x 400 into 9, 7 and 6
_MOST_MODELS = 5  # with more, the photos do not show one object
_ANY_DISTORTION = 1e6  # COLMAP drops every point of a camera with a coefficient over 1; a long lens has k3 = -6.3
_MOST_MAPPING_SECONDS = 300  # after which the mapper ends with what it has placed; 100 photos take 10, 300 take 60
_PR_SET_PDEATHSIG = 1  # option of Linux's prctl(2): signal for this process when its parent dies


def main(folder: Path) -> None:
    """Solve the problem in `folder`; every failure is a non-zero exit with its reason on stderr."""
    report = _set_up_process()
    problem = read_problem(folder / PROBLEM)
    database = folder / "database.db"
    _write_database(problem, database)
    _match(problem, database, folder / "pairs.txt", lambda done: report(_MATCHING * done))
    if problem.poses is None:
        models = _map_incrementally(problem, database, folder, lambda done: report(_MATCHING + (1 - _MATCHING) * done))
    else:
        _drop_contradicting_matches(problem, database)
        models = [_triangulate(problem, database, folder)]
    write_answer(_answer(problem, models), folder / ANSWER)


def _set_up_process() -> ReportFraction:
    """Set up the process: it dies with its parent, writes no core dump, and stdout has only its progress.

    Returns the function that reports progress."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    output = os.dup(1)
    os.dup2(2, 1)
    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.ERROR)
    pycolmap.set_random_seed(_SEED)
    return lambda fraction: _write_line(output, fraction)


def _write_line(output: int, fraction: float) -> None:
    os.write(output, json.dumps({"fraction": round(fraction, 4)}).encode() + b"\n")


def _write_database(problem: SfmProblem, path: Path) -> None:
    """Write COLMAP's database: each lens as a camera in its own rig, each photo as an image in its own frame.

    Their numbers start at 1."""
    with pycolmap.Database.open(path) as database, pycolmap.DatabaseTransaction(database):
        for number, lens in enumerate(problem.lenses, start=1):
            camera = _camera(number, lens, solved=problem.poses is None)
            database.write_camera(camera, use_camera_id=True)
            rig = pycolmap.Rig(rig_id=number)
            rig.add_ref_sensor(camera.sensor_id)
            database.write_rig(rig, use_rig_id=True)
        for number, features in enumerate(problem.features, start=1):
            _write_photo(database, number, int(problem.lens_of[number - 1]) + 1, features)


def _write_photo(database: Any, number: int, camera: int, features: Any) -> None:
    """Write a photo's image, frame, key points and descriptors to the database."""
    image = pycolmap.Image(name=_name(number), camera_id=camera, image_id=number)
    database.write_image(image, use_image_id=True)
    frame = pycolmap.Frame(frame_id=number, rig_id=camera)
    frame.add_data_id(image.data_id)
    database.write_frame(frame, use_frame_id=True)
    database.write_keypoints(number, features.xy + np.float32(0.5))
    sift = pycolmap.FeatureExtractorType.SIFT
    database.write_descriptors(number, pycolmap.FeatureDescriptors(sift, features.descriptors))


def _name(number: int) -> str:
    """Return COLMAP's name for a photo: without blanks, which separate names in the list of pairs."""
    return f"{number:06d}"


def _camera(number: int, lens: Lens, *, solved: bool) -> Any:
    """Make COLMAP's camera: SIMPLE_RADIAL if the mapper has to solve it, as it has the fewest parameters; else as given
    (FULL_OPENCV)."""
    at = lens.intrinsics
    centre = (at.cx + 0.5, at.cy + 0.5)
    radial = (at.fx, *centre, lens.distortion[0])
    given = (at.fx, at.fy, *centre, *lens.distortion, 0.0, 0.0, 0.0)
    return pycolmap.Camera(
        camera_id=number,
        model="SIMPLE_RADIAL" if solved else "FULL_OPENCV",
        width=at.width,
        height=at.height,
        params=radial if solved else given,
        has_prior_focal_length=lens.known,
    )


def _lens(camera: Any) -> Lens:
    """Convert a solved SIMPLE_RADIAL camera to a lens."""
    focal, cx, cy, k1 = (float(value) for value in camera.params)
    intrinsics = Intrinsics(focal, focal, cx - 0.5, cy - 0.5, camera.width, camera.height)
    return Lens(intrinsics, (k1, 0.0, 0.0, 0.0, 0.0), known=True)


def _match(problem: SfmProblem, database: Path, pair_list: Path, report: ReportFraction) -> None:
    """Match the pairs and verify the matches geometrically, in parts so that progress can be reported.

    Pairs of one photo are in sequence, so that its descriptor index is reused."""
    matching = pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=WORKERS)
    pairing = pycolmap.ImportedPairingOptions(match_list_path=pair_list)
    verifying = pycolmap.TwoViewGeometryOptions()
    verifying.ransac.max_error *= _limit_factor(problem)
    verifying.ransac.random_seed = _SEED
    parts = np.array_split(problem.pairs + 1, math.ceil(len(problem.pairs) / _PART))
    for done, part in enumerate(parts, start=1):
        pair_list.write_text("".join(f"{_name(first)} {_name(second)}\n" for first, second in part.tolist()))
        pycolmap.match_image_pairs(database, matching, pairing, verifying, device=pycolmap.Device.cpu)
        report(done / len(parts))


def _drop_contradicting_matches(problem: SfmProblem, database: Path) -> None:
    """Drop matches that contradict the given poses, and all matches of a pair where most do: its poses are wrong.

    Without this, poses of other photos give hundreds of points, each from two views whose rays nearly meet by chance.
    """
    assert problem.poses is not None
    with pycolmap.Database.open(database) as opened, pycolmap.DatabaseTransaction(opened):
        for first, second in problem.pairs.tolist():
            geometry = opened.read_two_view_geometry(first + 1, second + 1)
            matches = geometry.inlier_matches
            if len(matches):
                errors = epipolar_errors(
                    _rays(problem, first, matches[:, 0]),
                    _rays(problem, second, matches[:, 1]),
                    problem.poses[first],
                    problem.poses[second],
                )
                focal = problem.lenses[problem.lens_of[first]].intrinsics.fx
                allowed = errors * focal < _EPIPOLAR_PX * _limit_factor(problem)
                geometry.inlier_matches = matches[allowed & (allowed.mean() > _CREDIBLE)]
                opened.update_two_view_geometry(first + 1, second + 1, geometry)


def _rays(problem: SfmProblem, photo: int, key_points: Ints) -> Floats:
    """Return the undistorted key points of a photo (K,2), on the plane one unit in front of its camera."""
    camera = _camera(1, problem.lenses[problem.lens_of[photo]], solved=False)
    return np.asarray(camera.cam_from_img(problem.features[photo].xy[key_points].astype(np.float64) + 0.5))


def _limit_factor(problem: SfmProblem) -> float:
    """Return the factor for COLMAP's limits, most of which are 4 pixels of the stored photos.

    They become 2 pixels of the features' pictures; 4 where a phone's tracking, which drifts, gave the poses.
    """
    return max(1.0, problem.pixel / (2 if problem.poses is None else 1))


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
        random_seed=_SEED,
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
        database, folder, folder, _options(_limit_factor(problem), given=False), next_image_callback=next_placed
    )
    large = [model for model in models.values() if model.num_reg_images() >= _SMALLEST_MODEL]
    return sorted(large, key=lambda model: (-model.num_reg_images(), -model.num_points3D()))


def _triangulate(problem: SfmProblem, database: Path, folder: Path) -> Any:
    """Triangulate points with the poses as given: one model."""
    assert problem.poses is not None
    model = pycolmap.Reconstruction()
    for number, lens in enumerate(problem.lenses, start=1):
        model.add_camera_with_trivial_rig(_camera(number, lens, solved=False))
    for number, (lens_of, pose) in enumerate(zip(problem.lens_of, problem.poses, strict=True), start=1):
        xy = problem.features[number - 1].xy.astype(np.float64) + 0.5
        image = pycolmap.Image(name=_name(number), keypoints=xy, camera_id=int(lens_of) + 1, image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.linalg.inv(pose)[:3]))
    return pycolmap.triangulate_points(
        model, database, folder, folder, options=_options(_limit_factor(problem), given=True)
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
