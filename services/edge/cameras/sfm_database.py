"""COLMAP's database of a problem: photos, key points, and matches that geometry confirms.

COLMAP's first pixel has its centre at (0.5, 0.5), ours at (0, 0). Its numbers of photos and cameras start at 1.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from capture2vr.edge.arrays import Bools, Floats, Ints
from capture2vr.edge.cameras.match_pairs import epipolar_errors
from capture2vr.edge.cameras.sfm_process import Lens, SfmProblem
from capture2vr.edge.child_process import ReportFraction
from capture2vr.edge.parallel import WORKERS

SEED = 0
_PART = 200  # pairs matched per progress report: 1.3 s; 190 pairs in two parts took .2 s longer, in parts of 10 twice
_EPIPOLAR_PX = 4.0  # largest epipolar error of a match: COLMAP's own limit for matches of unposed photos
_CREDIBLE = 0.5  # least share of a pair's matches that its poses allow; true poses allow 0.8 to 1, wrong ones 0 to 0.1
# Inliers of a pair with a network's matches. LighterGlue always finds some that agree: on rendered photos of a plain
# thing on a plain table, of pairs with 100 and more nearly all are right, with fewer than 60 hardly any.
_FEWEST_LEARNED = 60


def write_database(problem: SfmProblem, path: Path) -> None:
    """Write COLMAP's database: each lens as a camera in its own rig, each photo as an image in its own frame.

    Their numbers start at 1."""
    with pycolmap.Database.open(path) as database, pycolmap.DatabaseTransaction(database):
        for number, lens in enumerate(problem.lenses, start=1):
            camera = colmap_camera(number, lens, solved=problem.poses is None)
            database.write_camera(camera, use_camera_id=True)
            rig = pycolmap.Rig(rig_id=number)
            rig.add_ref_sensor(camera.sensor_id)
            database.write_rig(rig, use_rig_id=True)
        for number, features in enumerate(problem.features, start=1):
            _write_photo(database, number, int(problem.lens_of[number - 1]) + 1, features)


def _write_photo(database: Any, number: int, camera: int, features: Any) -> None:
    """Write a photo's image, frame, key points and descriptors to the database."""
    image = pycolmap.Image(name=name_of(number), camera_id=camera, image_id=number)
    database.write_image(image, use_image_id=True)
    frame = pycolmap.Frame(frame_id=number, rig_id=camera)
    frame.add_data_id(image.data_id)
    database.write_frame(frame, use_frame_id=True)
    database.write_keypoints(number, features.xy + np.float32(0.5))
    sift = pycolmap.FeatureExtractorType.SIFT
    database.write_descriptors(number, pycolmap.FeatureDescriptors(sift, features.descriptors))


def name_of(number: int) -> str:
    """Return COLMAP's name for a photo: without blanks, which separate names in the list of pairs."""
    return f"{number:06d}"


def colmap_camera(number: int, lens: Lens, *, solved: bool) -> Any:
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


def match(problem: SfmProblem, database: Path, pair_list: Path, report: ReportFraction) -> None:
    """Match the pairs and verify the matches geometrically, in parts so that progress can be reported.

    Pairs of one photo are in sequence, so that its descriptor index is reused."""
    matching = pycolmap.FeatureMatchingOptions(use_gpu=False, num_threads=WORKERS)
    pairing = pycolmap.ImportedPairingOptions(match_list_path=pair_list)
    parts = np.array_split(problem.pairs, math.ceil(len(problem.pairs) / _PART))
    for done, part in enumerate(parts, start=1):
        _write_pairs(part, pair_list)
        pycolmap.match_image_pairs(database, matching, pairing, _verifying(problem), device=pycolmap.Device.cpu)
        report(done / len(parts))


def _write_pairs(pairs: Ints, pair_list: Path) -> None:
    """Write COLMAP's list of pairs, a line each."""
    pair_list.write_text("".join(f"{name_of(first)} {name_of(second)}\n" for first, second in (pairs + 1).tolist()))


def _verifying(problem: SfmProblem) -> Any:
    """Return the options of the geometric verification."""
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.max_error *= limit_factor(problem)
    options.ransac.random_seed = SEED
    return options


def add_matches(problem: SfmProblem, learned: Ints, database: Path, pair_list: Path) -> None:
    """Add a network's matches to those of the descriptors, and verify these pairs geometrically once more.

    Pairs that then have too few inliers get back what the descriptors alone gave them."""
    pairs, starts = np.unique(learned[:, :2], axis=0, return_index=True)
    numbers, before = (pairs + 1).tolist(), []
    with pycolmap.Database.open(database) as opened, pycolmap.DatabaseTransaction(opened):
        for (first, second), part in zip(numbers, np.split(learned[:, 2:], starts[1:]), strict=True):
            before.append(_take_geometry(opened, first, second))
            known = opened.read_matches(first, second) if opened.exists_matches(first, second) else part[:0]
            opened.delete_matches(first, second)
            opened.write_matches(first, second, np.concatenate([known, part]).astype(np.uint32))
    _write_pairs(pairs, pair_list)
    pycolmap.verify_matches(database, pair_list, _verifying(problem))
    with pycolmap.Database.open(database) as opened, pycolmap.DatabaseTransaction(opened):
        for (first, second), geometry in zip(numbers, before, strict=True):
            if len(opened.read_two_view_geometry(first, second).inlier_matches) < _FEWEST_LEARNED:
                opened.update_two_view_geometry(first, second, geometry)


def _take_geometry(database: Any, first: int, second: int) -> Any:
    """Remove and return a pair's verified matches; none where the pair was not matched."""
    if not database.exists_two_view_geometry(first, second):
        return pycolmap.TwoViewGeometry()
    geometry = database.read_two_view_geometry(first, second)
    database.delete_two_view_geometry(first, second)
    return geometry


def drop_contradicting_matches(problem: SfmProblem, database: Path) -> None:
    """Drop matches that contradict the given poses, and all matches of a pair where most do: its poses are wrong.

    Without this, poses of other photos give hundreds of points, each from two views whose rays nearly meet by chance.
    """
    assert problem.poses is not None
    placed = {
        photo: (colmap_camera(1, problem.lenses[lens], solved=False), pose)
        for photo, (lens, pose) in enumerate(zip(problem.lens_of.tolist(), problem.poses, strict=True))
    }
    with pycolmap.Database.open(database) as opened, pycolmap.DatabaseTransaction(opened):
        for pair in _matched_pairs(problem):
            geometry = _geometry(opened, pair)
            allowed = _allowed(problem, pair, geometry.inlier_matches, placed)
            if len(allowed):
                geometry.inlier_matches = geometry.inlier_matches[allowed & (allowed.mean() > _CREDIBLE)]
                opened.update_two_view_geometry(pair[0] + 1, pair[1] + 1, geometry)


def contradicted_photos(problem: SfmProblem, database: Path, model: Any) -> list[int]:
    """Return the photos of a model most of whose verified matches with others in it contradict its poses.

    Where a texture repeats, a network's matches may be wrong by one repeat and still agree within their pair: the model
    is then bent to follow some of them, and contradicts the others.
    """
    placed = {
        number - 1: (image.camera, image.cam_from_world().inverse().matrix())
        for number in model.reg_image_ids()
        for image in [model.image(number)]
    }
    agreeing, matched = Counter[int](), Counter[int]()
    with pycolmap.Database.open(database) as opened:
        for pair in _matched_pairs(problem):
            if pair[0] in placed and pair[1] in placed:
                allowed = _allowed(problem, pair, _geometry(opened, pair).inlier_matches, placed)
                for photo in pair:
                    agreeing[photo] += int(allowed.sum())
                    matched[photo] += len(allowed)
    return [photo for photo in sorted(placed) if agreeing[photo] < _CREDIBLE * matched[photo]]


def _matched_pairs(problem: SfmProblem) -> list[tuple[int, int]]:
    """Return the pairs that were matched by descriptors or by a network."""
    learned = problem.pairs[:0] if problem.learned is None else problem.learned[:, :2]
    return [(first, second) for first, second in np.unique(np.concatenate([problem.pairs, learned]), axis=0).tolist()]


def _geometry(database: Any, pair: tuple[int, int]) -> Any:
    return database.read_two_view_geometry(pair[0] + 1, pair[1] + 1)


def _allowed(
    problem: SfmProblem, pair: tuple[int, int], matches: Ints, placed: Mapping[int, tuple[Any, Floats]]
) -> Bools:
    """Return which matches (K,2) of a pair the poses allow; placed: camera and camera_to_world of the photos."""
    if not len(matches):
        return np.zeros(0, np.bool_)
    rays = [
        np.asarray(placed[photo][0].cam_from_img(problem.features[photo].xy[key_points].astype(np.float64) + 0.5))
        for photo, key_points in zip(pair, matches.T, strict=True)
    ]
    first, second = (_square(placed[photo][1]) for photo in pair)
    errors = epipolar_errors(rays[0], rays[1], first, second) * placed[pair[0]][0].focal_length_x
    return np.asarray(errors < _EPIPOLAR_PX * limit_factor(problem))


def _square(pose: Floats) -> Floats:
    return np.vstack([pose[:3], [0.0, 0.0, 0.0, 1.0]])


def limit_factor(problem: SfmProblem) -> float:
    """Return the factor for COLMAP's limits, most of which are 4 pixels of the stored photos.

    They become 2 pixels of the features' pictures; 4 where a phone's tracking, which drifts, gave the poses.
    """
    return max(1.0, problem.pixel / (2 if problem.poses is None else 1))
