"""Merging two changes of a scene: no change of either is lost without being named, and both orders end in one scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.support.page_scripts import PageScripts

Scene = dict[str, Any]
_MERGE = """async (cases) => {
    const { mergeScenes, isSameContent } = await import('/web/scenes/scene-merge.js');
    return cases.map(([base, mine, theirs]) => [mergeScenes(base, mine, theirs), isSameContent(mine, mine)]);
}"""


def thing(number: int, x: float = 0.0) -> Scene:
    return {"id": f"i{number}", "asset": "chair", "position_m": [x, 0, 0], "rotation": [0, 0, 0, 1], "scale": 1}


def change(random: np.random.Generator, base: Scene, new: int) -> Scene:
    """A scene after somebody has moved, taken away and added some things."""
    kept = [each for each in base["items"] if random.random() < 0.8]
    items = [
        thing(int(each["id"][1:]), float(random.integers(1, 9))) if random.random() < 0.4 else each for each in kept
    ]
    if random.random() < 0.5:
        items.append(thing(new))
    name = f"name {new}" if random.random() < 0.3 else base["name"]
    return {"name": name, "items": items}


def by_id(scene: Scene) -> dict[str, Scene]:
    return {each["id"]: each for each in scene["items"]}


def test_every_change_is_in_the_merged_scene_or_named(scripts: PageScripts) -> None:
    random = np.random.default_rng(1)
    cases = []
    for _ in range(300):
        base = {"name": "Room", "items": [thing(number) for number in range(int(random.integers(0, 6)))]}
        cases.append([base, change(random, base, 100), change(random, base, 200)])
    for (base, mine, theirs), (merged, same) in zip(cases, scripts.evaluate(_MERGE, cases), strict=True):
        assert same
        before, own, others, result = by_id(base), by_id(mine), by_id(theirs), by_id(merged)
        assert len(result) == len(merged["items"]), "each thing once"
        for id_ in before | own | others:
            old, here, there = (each.get(id_) for each in (before, own, others))
            if there != old:
                assert result.get(id_) == there, "what others saved holds"
                assert (id_ in merged["lost"]) == (here != old and here != there), "and whose change it hides is told"
            else:
                assert result.get(id_) == here, "else it is as this page has it"
        assert merged["name"] == (theirs["name"] if theirs["name"] != base["name"] else mine["name"])
        assert ("" in merged["lost"]) == (mine["name"] != base["name"] != theirs["name"] != mine["name"])
