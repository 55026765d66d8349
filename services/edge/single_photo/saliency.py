"""Saliency of a photo: what differs from the background and lies near the middle, where the background is not plain.

Robust background detection (Zhu et al. 2014, Saliency Optimization from Robust Background Detection): superpixels that
are connected to much of the picture's border through similar colours are background; those that differ from it are the
thing. Here a prior for the picture's middle is added. numpy, scipy and scikit-image.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra, shortest_path

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints

_SUPERPIXELS = 250  # the paper's 200 to 300
_COMPACTNESS = 12.0  # of SLIC: the weight of places against colours
_BLUR = 1.0  # pixels, against noise
_LIGHTNESS = 0.8  # weight of lightness in a distance of colours
_SAME = 3.0  # CIELAB: smaller steps on a way are noise, and cost nothing
_SIMILAR = 10.0  # CIELAB: the paper's sigma of colours
_FAR = 0.4  # of the longer side: the paper's sigma of places
_MIDDLE = 0.5  # of half a side: sigma of the prior for the picture's middle
_NOISE, _NEXT = 2.0, 0.5  # CIELAB: of a step on the way from a pixel, what is noise; and what every step costs
_FREE = 1e-6  # cost of a step without cost, because a sparse graph has no edges of 0


@dataclass(frozen=True, slots=True)
class _Superpixels:
    """labels (h,w) of k superpixels: their colour (k,3) in CIELAB, place (k,2) as shares of the longer side, and
    whether they touch the border (k,); pairs (n,2) of neighbours."""

    labels: Ints
    colour: Floats
    place: Floats
    at_border: Bools
    pairs: Ints


def saliency(rgb: Bytes) -> Floats:
    """Saliency (h,w) in [0,1]: 1 at the most salient place; 0 everywhere in a picture of one colour."""
    parts = _superpixels(rgb)
    apart = np.linalg.norm(parts.colour[:, None] - parts.colour[None], axis=2)
    background = _background(parts, apart)
    near = np.exp(-((parts.place[:, None] - parts.place[None]) ** 2).sum(axis=2) / (2 * _FAR**2))
    contrast = (apart * near * background[None]).sum(axis=1) * _middle_prior(rgb, parts.place)
    if contrast.max() < _FREE:
        return np.zeros(rgb.shape[:2])
    smooth = _optimise(parts, apart, background, contrast / contrast.max())
    smooth = (smooth - smooth.min()) / max(float(np.ptp(smooth)), _FREE)
    return np.asarray(smooth[parts.labels])


def colour_way(rgb: Bytes, at: tuple[int, int]) -> Floats:
    """Colour steps (h,w) in CIELAB on the way from a pixel (x, y) to each other one, at least."""
    parts = _superpixels(rgb)
    one, other = parts.pairs.T
    steps = np.linalg.norm(parts.colour[one] - parts.colour[other], axis=1)
    count = len(parts.colour)
    graph = csr_matrix((np.maximum(steps - _NOISE, 0) + _NEXT, (one, other)), (count, count))
    way = dijkstra(graph, directed=False, indices=parts.labels[at[1], at[0]])
    return np.asarray(way[parts.labels])


def _superpixels(rgb: Bytes) -> _Superpixels:
    from skimage.segmentation import slic  # half a second to load, and needed only where nothing stands out

    blurred = cv2.GaussianBlur(rgb, (0, 0), _BLUR).astype(np.float32) / 255
    lab = cv2.cvtColor(blurred, cv2.COLOR_RGB2LAB) * np.array([_LIGHTNESS, 1, 1], np.float32)
    labels = slic(rgb, n_segments=_SUPERPIXELS, compactness=_COMPACTNESS, sigma=_BLUR, start_label=0)
    height, width = labels.shape
    y, x = np.mgrid[:height, :width] / max(height, width)
    count = np.bincount(labels.ravel())
    mean = [np.bincount(labels.ravel(), each.ravel()) / count for each in (*np.moveaxis(lab, 2, 0), x, y)]
    border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    beside = [(labels[:, :-1], labels[:, 1:]), (labels[:-1], labels[1:])]
    pairs = np.concatenate([np.stack([one.ravel(), other.ravel()], axis=1) for one, other in beside])
    pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)
    at_border = np.isin(np.arange(len(count)), border)
    return _Superpixels(labels, np.stack(mean[:3], axis=1), np.stack(mean[3:], axis=1), at_border, pairs)


def _background(parts: _Superpixels, apart: Floats) -> Floats:
    """Probability (k,) that a superpixel is background, by its connectivity to the border.

    Its way to another costs the colour steps between neighbours. Superpixels along the border are all neighbours: one
    background may be cut in two by the thing.
    """
    k = len(apart)
    border = np.flatnonzero(parts.at_border)
    first, second = np.triu_indices(len(border), 1)
    pairs = np.unique(
        np.concatenate([parts.pairs, np.stack([border[first], border[second]], axis=1)]).reshape(-1, 2), axis=0
    )
    cost = np.maximum(apart[pairs[:, 0], pairs[:, 1]] - _SAME, 0) + _FREE
    way = shortest_path(csr_matrix((cost, pairs.T), (k, k)), directed=False)
    similar = np.exp(-(way**2) / (2 * _SIMILAR**2))
    connectivity = similar @ parts.at_border / np.sqrt(similar.sum(axis=1))
    return np.asarray(1 - np.exp(-(connectivity**2) / 2))


def _middle_prior(rgb: Bytes, place: Floats) -> Floats:
    """Prior (k,) for superpixels near the picture's middle."""
    height, width = rgb.shape[:2]
    middle = np.array([width, height]) / max(width, height) / 2
    return np.asarray(np.exp(-(((place - middle) / middle) ** 2).sum(axis=1) / (2 * _MIDDLE**2)))


def _optimise(parts: _Superpixels, apart: Floats, background: Floats, contrast: Floats) -> Floats:
    """Least squares of the paper: 0 where background, 1 where contrast, and alike between similar neighbours."""
    one, other = parts.pairs.T
    alike = np.zeros_like(apart)
    alike[one, other] = np.exp(-(apart[one, other] ** 2) / (2 * _SIMILAR**2)) + 0.1  # the paper's mu, against noise
    alike += alike.T
    laplacian = np.diag(alike.sum(axis=1)) - alike
    return np.asarray(np.linalg.solve(np.diag(background + contrast + _FREE) + laplacian, contrast))
