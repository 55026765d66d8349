"""Procrustes alignment: the rotation, translation and scale that map points to their partners, by least squares."""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Floats


def procrustes(points: Floats, partners: Floats, *, scale: bool) -> Floats | None:
    """Return the transform (4,4) that maps points (N,3) nearest to their partners (N,3), None where none is defined.

    scale  whether the size may change too (a similarity), or only the pose (a rigid motion)

    Shinji Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 1991.
    """
    from skimage.transform import EuclideanTransform, SimilarityTransform  # half a second to load, rarely needed

    found = (SimilarityTransform if scale else EuclideanTransform).from_estimate(points, partners)
    return np.asarray(found.params, np.float64) if found else None
