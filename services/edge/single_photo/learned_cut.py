"""Cut the object out of a photo by a learned model, where whoever runs the worker has added one (IS-Net).

The photo goes on without the model where that is not there, fails, is not sure, or sees no object that lies whole in
the picture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2

from capture2vr.edge.arrays import Bools, Bytes, Floats, Tick
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.models.isnet import SIDE, IsNet
from capture2vr.edge.models.nouns import LearnedViews, ModelError, UsedModel
from capture2vr.edge.single_photo.segmentation import LEAST_AREA, is_cut_off, main_part
from capture2vr.sentences.sentence import say

_BELONGS = 0.5  # of the model's mask: what belongs to the object
_UNSURE = 0.1, 0.9  # values between which the model does not know
# Most pixels of which it does not know, over those of the object. Of 19 photos 14 that are cut rightly have 0.3 and
# less; print, handwriting, a rocket among masts and two white chairs before white have 0.7 and more.
_MOST_UNSURE = 0.5
DIGITS = 12
"""Of a file's SHA-256, by which people tell two files."""


@dataclass(frozen=True, slots=True)
class LearnedCut:
    """What a model made of a photo: mask (h,w), None where it made none, what to tell people, and the model itself."""

    mask: Bools | None = None
    warnings: tuple[str, ...] = ()
    models: tuple[UsedModel, ...] = ()


def learned_cut(
    models: ModelFolder | None, load: Callable[[int], Bytes], shape: tuple[int, ...], name: str, tick: Tick
) -> LearnedCut:
    """Ask IS-Net for the mask of the object, where it is installed.

    load   loads the upright picture (h,w,3) with at most so many pixels on its longer side
    shape  of the mask that is wanted
    name   of the photo

    Raises what `tick` and loading the picture raise.
    """
    try:
        graph = models.find("isnet") if models else None
        if graph is None:
            return LearnedCut()
        propose: LearnedViews = IsNet(graph.run)
        (view,) = propose([load(SIDE)], tick)
    except ModelError as error:
        return LearnedCut(warnings=(say("model_left_out", name=name, why=error.with_remedy),))
    assert view.mask is not None, "IS-Net proposes a mask of every photo"
    mask = main_part(cv2.resize(view.mask, (shape[1], shape[0]), interpolation=cv2.INTER_AREA) > _BELONGS)
    if mask.mean() < LEAST_AREA or is_cut_off(mask) or not _is_sure(view.mask):
        return LearnedCut(warnings=(say("model_found_no_whole_object", model=graph.card.title, name=name),))
    version = graph.used.sha256[:DIGITS]
    return LearnedCut(mask, (say("cut_by_model", name=name, model=graph.card.title, version=version),), (graph.used,))


def _is_sure(mask: Floats) -> bool:
    """Whether the model knows of most pixels whether they belong to the object."""
    unsure = (mask > _UNSURE[0]) & (mask < _UNSURE[1])
    return bool(unsure.sum() <= _MOST_UNSURE * (mask > _BELONGS).sum())
