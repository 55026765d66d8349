"""Fields are fitted to measured and inferred points; what they are judged by is measured."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.local_fit import fit_local, split_points
from capture2vr.edge.origin import FILLED, marked
from capture2vr.edge.points.nouns import Points
from capture2vr.edge.preset import load_preset
from capture2vr.edge.progress import Bar, Clock, ignore_progress


def test_inferred_points_are_fitted_but_never_judge() -> None:
    rng = np.random.default_rng(0)
    xyz = rng.normal(size=(3_000, 3))
    xyz /= np.linalg.norm(xyz, axis=1, keepdims=True)
    below = xyz[:, 2] < 0
    xyz[~below] *= 1 + rng.normal(0, 0.02, (int((~below).sum()), 1))  # measured with noise, inferred without
    points = Points(xyz, None, np.ones(len(xyz), np.float32), 1.0, "metric", None, origin=marked(below, FILLED))
    split = split_points(points, load_preset("draft"), "cpu")
    assert (split.evidence[:, 2] >= -0.1).all()
    bar = Bar(ignore_progress)
    bar.set_range({"FITTING": 0.0}, 0.0, 1.0)
    steps = fit_local(split, Clock(), bar)
    try:
        while True:
            next(steps)
    except StopIteration as stop:
        local = stop.value
    assert len(local.xyz_unit) == len(split.fitted)
    assert len(local.evidence.xyz) == int(split.fitted.given.sum())
    inferred = ~split.fitted.given
    assert np.array_equal(local.xyz_unit[inferred], local.measured[inferred]), "they have no noise, and stay"
    assert not local.noise.sigma[inferred].any()
    assert (local.xyz_unit[~inferred] != local.measured[~inferred]).any()
