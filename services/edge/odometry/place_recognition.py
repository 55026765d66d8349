"""Place recognition: find key frames that show the same place by their pictures, wherever their poses say they are.

Each picture becomes one vector: for every visual word, the sum of the differences between the word and the features
nearest to it (VLAD: H. Jégou et al., Aggregating local descriptors into a compact image representation, 2010), of
square-rooted SIFT (R. Arandjelović and A. Zisserman, Three things everyone should know, 2012). The words are learned
from the walk itself.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from capture2vr.edge.arrays import Bytes, Floats, Ints
from capture2vr.edge.odometry.features import RgbdFeatures

_WORDS = 64
_SAMPLES_PER_WORD = 500
"""Features that the words are learned from: more do not change them."""
_ITERATIONS = 20
"""Most iterations of k-means."""


def similar_pairs(features: Sequence[RgbdFeatures | None], olds: Sequence[Ints]) -> list[tuple[int, int]]:
    """Return a pair (old, new) for every picture: the one most like it among those that `olds` (N) names for it."""
    known = [number for number, each in enumerate(features) if each is not None]
    if len(known) < 2:
        return []
    vectors = dict(zip(known, _vectors([each for each in features if each is not None]), strict=True))
    pairs = []
    for new in known:
        before = [old for old in olds[new].tolist() if old in vectors]
        if before:
            alike = np.stack([vectors[old] for old in before]) @ vectors[new]
            pairs.append((before[int(np.argmax(alike))], new))
    return pairs


def _vectors(features: Sequence[RgbdFeatures]) -> Floats:
    """Describe pictures by one vector each (N,128·_WORDS) float32, of length 1."""
    words = _learn_words(features)
    return np.stack([_vector(each.descriptors, words) for each in features])


def _learn_words(features: Sequence[RgbdFeatures]) -> Floats:
    """Learn the visual words (W,128) by k-means from features all along the walk."""
    import cv2

    each = max(1, _WORDS * _SAMPLES_PER_WORD // len(features))
    sample = np.concatenate([_rooted(found.descriptors[:each]) for found in features])
    count = min(_WORDS, len(sample))
    stop = (cv2.TERM_CRITERIA_MAX_ITER, _ITERATIONS, 0.0)
    cv2.setRNGSeed(0)
    _, _, words = cv2.kmeans(sample, count, None, stop, 1, cv2.KMEANS_PP_CENTERS)  # type: ignore[call-overload]
    return np.asarray(words)


def _vector(descriptors: Bytes, words: Floats) -> Floats:
    """Describe a picture by its features' differences from their words, each word's sum of length 1 or 0."""
    rooted = _rooted(descriptors)
    nearest = np.argmax(rooted @ words.T - np.square(words).sum(axis=1) / 2, axis=1)
    sums = np.zeros_like(words)
    np.add.at(sums, nearest, rooted - words[nearest])
    sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12)
    flat = sums.ravel()
    vector: Floats = flat / max(float(np.linalg.norm(flat)), 1e-12)
    return vector


def _rooted(descriptors: Bytes) -> Floats:
    """Square roots (N,128) float32 of descriptors that sum to 1."""
    values = descriptors.astype(np.float32)
    rooted: Floats = np.sqrt(values / np.maximum(values.sum(axis=1, keepdims=True), 1e-12))
    return rooted
