"""Where checkpoints lie: taken over by newer leases, out of reach of older ones, and gone in time."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from capture2vr.edge.tiles.folder import tiles_folder
from capture2vr.edge.worker.checkpoint_files import KEEP_S, CheckpointFiles


@pytest.fixture
def checkpoints(tmp_path: Path) -> CheckpointFiles:
    return CheckpointFiles(tmp_path)


def test_a_newer_lease_goes_on_from_what_the_older_one_left(checkpoints: CheckpointFiles) -> None:
    first = checkpoints.take("job_1", 1)
    assert not first.exists()
    first.write_text("of the first")
    second = checkpoints.take("job_1", 3)
    assert second.read_text() == "of the first"
    assert second != first


def test_the_newest_is_taken_over_and_no_half_of_one(checkpoints: CheckpointFiles) -> None:
    for fence in (2, 10, 9):
        checkpoints.take("job_1", fence).write_text(str(fence))
    half = checkpoints.take("job_1", 10).with_name("11.checkpoint.part")
    half.write_text("torn")
    assert checkpoints.take("job_1", 12).read_text() == "10"


def test_finished_tiles_are_taken_over_with_the_checkpoint_and_go_with_it(
    checkpoints: CheckpointFiles, tmp_path: Path
) -> None:
    tiles = tiles_folder(checkpoints.take("job_1", 1))
    (tiles / "mesh").mkdir(parents=True)
    (tiles / "mesh" / "0-0-0.npz").write_text("finished")
    taken = tiles_folder(checkpoints.take("job_1", 2))
    assert (taken / "mesh" / "0-0-0.npz").read_text() == "finished"
    assert not tiles.exists()
    checkpoints.drop("job_1", 2)
    assert list(tmp_path.iterdir()) == []


def test_tiles_that_are_still_made_are_kept(checkpoints: CheckpointFiles, tmp_path: Path) -> None:
    tiles = tiles_folder(checkpoints.take("job_1", 1))
    (tiles / "mesh").mkdir(parents=True)
    long_ago = time.time() - 2 * KEEP_S
    for folder in (tiles, tmp_path / "job_1"):
        os.utime(folder, (long_ago, long_ago))
    checkpoints.take("job_2", 1)
    assert tiles.exists()


def test_a_worker_that_was_cut_off_does_not_touch_its_successors(checkpoints: CheckpointFiles) -> None:
    cut_off = checkpoints.take("job_1", 1)
    cut_off.write_text("early")
    current = checkpoints.take("job_1", 2)
    cut_off.write_text("late")
    assert current.read_text() == "early"
    checkpoints.drop("job_1", 1)
    assert current.read_text() == "early"
    assert not cut_off.exists()


def test_a_job_that_is_over_leaves_nothing(checkpoints: CheckpointFiles, tmp_path: Path) -> None:
    own = checkpoints.take("job_1", 2)
    own.write_text("x")
    own.with_name("2.checkpoint.part").write_text("torn")
    checkpoints.drop("job_1", 2)
    checkpoints.drop("job_unknown", 2)
    assert list(tmp_path.iterdir()) == []


def test_jobs_do_not_share(checkpoints: CheckpointFiles) -> None:
    checkpoints.take("job_1", 1).write_text("x")
    assert not checkpoints.take("job_2", 2).exists()


def test_what_nobody_comes_back_for_goes_in_time(checkpoints: CheckpointFiles, tmp_path: Path) -> None:
    for job, age_s in (("job_old", KEEP_S + 60), ("job_young", KEEP_S - 60)):
        checkpoints.take(job, 1).write_text("x")
        then = time.time() - age_s
        os.utime(tmp_path / job, (then, then))
    checkpoints.take("job_next", 1)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["job_next", "job_young"]
