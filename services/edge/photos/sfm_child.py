"""The process that places photos with pycolmap: `python -m services.edge.photos.solve_child FOLDER`.

Reads the `Problem` in FOLDER, writes the `Answer` there, and its progress to its output, one JSON object a line.
COLMAP puts the centre of the first pixel at (0.5, 0.5); it is moved to ours, at (0, 0), on the way in and out.
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
from services.edge.photos.pairs import epipolar_errors
from services.edge.photos.solve import ANSWER, PROBLEM, Answer, Lens, Problem, read_problem, write_answer
from services.edge.threads import WORKERS

Say = Callable[[float], None]
"""Told the fraction done."""

_SEED = 0
_PART = 100  # pairs between two words on the progress: 1.5 s; 190 pairs in parts of 10 took twice as long
_MATCHING = 0.7  # of the time goes into matching 20 to 50 photos, the rest into the mapper
_EPIPOLAR_PX = 4.0  # COLMAP's own limit for matches of unposed photos
_CREDIBLE = 0.5  # share of a pair's matches that its poses must allow; true poses allow 0.8 to 1, others' 0 to 0.1
_SMALLEST_MODEL = 3  # photos
_FEWEST_INLIERS = 15  # points that place a photo; COLMAP's 30 split 20 photos of fruit of 600 x 400 into 9, 7 and 6
_MOST_MODELS = 5  # a capture of more pieces than that is no capture of one thing
_ANY_DISTORTION = 1e6  # COLMAP drops every point of a camera with a coefficient over 1; a long lens has k3 = -6.3
_PR_SET_PDEATHSIG = 1  # of Linux's prctl(2)


def main(folder: Path) -> None:
    """Solve the problem in the folder; every failure is a non-zero exit with its reason on stderr."""
    say = _alone()
    problem = read_problem(folder / PROBLEM)
    database = folder / "database.db"
    _write_database(problem, database)
    _match(problem, database, folder / "pairs.txt", lambda done: say(_MATCHING * done))
    if problem.poses is None:
        models = _mapped(problem, database, folder, lambda done: say(_MATCHING + (1 - _MATCHING) * done))
    else:
        _drop_contradicted(problem, database)
        models = [_triangulated(problem, database, folder)]
    write_answer(_answer(problem, models), folder / ANSWER)


def _alone() -> Say:
    """Set the process up: it dies with its parent, leaves no core, and its output holds nothing but progress."""
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


def _write_database(problem: Problem, path: Path) -> None:
    """Each lens is a camera in a rig of its own, each photo an image in a frame of its own; numbers start at 1."""
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
    image = pycolmap.Image(name=_name(number), camera_id=camera, image_id=number)
    database.write_image(image, use_image_id=True)
    frame = pycolmap.Frame(frame_id=number, rig_id=camera)
    frame.add_data_id(image.data_id)
    database.write_frame(frame, use_frame_id=True)
    database.write_keypoints(number, features.xy + np.float32(0.5))
    sift = pycolmap.FeatureExtractorType.SIFT
    database.write_descriptors(number, pycolmap.FeatureDescriptors(sift, features.descriptors))


def _name(number: int) -> str:
    """A name without blanks, which the list of pairs cannot hold."""
    return f"{number:06d}"


def _camera(number: int, lens: Lens, *, solved: bool) -> Any:
    """SIMPLE_RADIAL where the mapper is to solve it, which has the fewest numbers to get wrong; else as given."""
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
    """The lens of a solved SIMPLE_RADIAL camera."""
    focal, cx, cy, k1 = (float(value) for value in camera.params)
    intrinsics = Intrinsics(focal, focal, cx - 0.5, cy - 0.5, camera.width, camera.height)
    return Lens(intrinsics, (k1, 0.0, 0.0, 0.0, 0.0), known=True)


def _match(problem: Problem, database: Path, listed: Path, say: Say) -> None:
    """Match and verify in parts, for the sake of the progress: pairs of one photo lie together, its index is reused."""
    matching = pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=WORKERS)
    pairing = pycolmap.ImportedPairingOptions(match_list_path=listed)
    verifying = pycolmap.TwoViewGeometryOptions()
    verifying.ransac.max_error *= _slack(problem)
    verifying.ransac.random_seed = _SEED
    parts = np.array_split(problem.pairs + 1, math.ceil(len(problem.pairs) / _PART))
    for done, part in enumerate(parts, start=1):
        listed.write_text("".join(f"{_name(first)} {_name(second)}\n" for first, second in part.tolist()))
        pycolmap.match_image_pairs(database, matching, pairing, verifying, device=pycolmap.Device.cpu)
        say(done / len(parts))


def _drop_contradicted(problem: Problem, database: Path) -> None:
    """Drop the matches that the given poses forbid, and all of a pair where most are: its poses are wrong.

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
                allowed = errors * focal < _EPIPOLAR_PX * _slack(problem)
                geometry.inlier_matches = matches[allowed & (allowed.mean() > _CREDIBLE)]
                opened.update_two_view_geometry(first + 1, second + 1, geometry)


def _rays(problem: Problem, photo: int, key_points: Ints) -> Floats:
    """(K,2) where the rays of a photo's key points meet the plane one unit before its camera."""
    camera = _camera(1, problem.lenses[problem.lens_of[photo]], solved=False)
    return np.asarray(camera.cam_from_img(problem.features[photo].xy[key_points].astype(np.float64) + 0.5))


def _slack(problem: Problem) -> float:
    """What to multiply COLMAP's limits with, most of which are 4 pixels.

    2 pixels of the features' pictures, and 4 where a phone's tracking, which drifts, gave the poses.
    """
    return max(1.0, problem.pixel / (2 if problem.poses is None else 1))


def _options(slack: float, *, given: bool) -> Any:
    """The mapper's settings: its own, except for fewer and shorter adjustments and limits that suit the features.

    On 50 photos that takes a third of the adjustments' time, at the same error of the positions.
    """
    options = pycolmap.IncrementalPipelineOptions(
        min_model_size=_SMALLEST_MODEL,
        max_num_models=_MOST_MODELS,
        extract_colors=False,
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


def _mapped(problem: Problem, database: Path, folder: Path, say: Say) -> list[Any]:
    """The models, the largest first."""
    placed = 0

    def next_placed() -> None:
        nonlocal placed
        placed += 1
        say(min(1.0, placed / len(problem.features)))

    models = pycolmap.incremental_mapping(
        database, folder, folder, _options(_slack(problem), given=False), next_image_callback=next_placed
    )
    large = [model for model in models.values() if model.num_reg_images() >= _SMALLEST_MODEL]
    return sorted(large, key=lambda model: (-model.num_reg_images(), -model.num_points3D()))


def _triangulated(problem: Problem, database: Path, folder: Path) -> Any:
    """One model with the poses as given."""
    assert problem.poses is not None
    model = pycolmap.Reconstruction()
    for number, lens in enumerate(problem.lenses, start=1):
        model.add_camera_with_trivial_rig(_camera(number, lens, solved=False))
    for number, (lens_of, pose) in enumerate(zip(problem.lens_of, problem.poses, strict=True), start=1):
        xy = problem.features[number - 1].xy.astype(np.float64) + 0.5
        image = pycolmap.Image(name=_name(number), keypoints=xy, camera_id=int(lens_of) + 1, image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.linalg.inv(pose)[:3]))
    return pycolmap.triangulate_points(model, database, folder, folder, options=_options(_slack(problem), given=True))


def _answer(problem: Problem, models: Sequence[Any]) -> Answer:
    best = models[0] if models else pycolmap.Reconstruction()
    placed = np.array(_placed(best), np.int32)
    lenses, poses = _lenses(problem, best, placed), _poses(problem, best, placed)
    return Answer(lenses, _model_of(len(problem.features), models), placed, poses, *_points(best, placed))


def _placed(model: Any) -> list[int]:
    """The photos that see enough of the model's points; one with a given pose may see none."""
    return [
        number - 1 for number in sorted(model.reg_image_ids()) if model.image(number).num_points3D >= _FEWEST_INLIERS
    ]


def _lenses(problem: Problem, model: Any, placed: Ints) -> tuple[Lens, ...]:
    if problem.poses is not None:
        return tuple(problem.lenses[lens] for lens in problem.lens_of[placed])
    return tuple(_lens(model.image(photo + 1).camera) for photo in placed.tolist())


def _model_of(count: int, models: Sequence[Any]) -> Ints:
    """(N,) for each photo the first, so the largest, of the models that placed it, or -1."""
    found = np.full(count, -1, np.int32)
    for number in reversed(range(len(models))):
        found[_placed(models[number])] = number
    return found


def _poses(problem: Problem, model: Any, placed: Ints) -> Floats:
    """camera_to_world (V,4,4); given ones as given, without the detour through a quaternion."""
    if problem.poses is not None:
        return problem.poses[placed]
    poses = np.tile(np.eye(4), (len(placed), 1, 1))
    for pose, photo in zip(poses, placed.tolist(), strict=True):
        pose[:3] = model.image(photo + 1).cam_from_world().inverse().matrix()
    return poses


def _points(model: Any, placed: Ints) -> tuple[Floats, Ints, Ints, Ints]:
    """xyz (P,3) of the points that two placed photos see, and for every observation its point, view and key point."""
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
