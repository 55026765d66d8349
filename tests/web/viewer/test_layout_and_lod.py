"""Which levels a scene shows within its budget, and where its things stand side by side."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.support.page_scripts import PageScripts


def things(random: np.random.Generator) -> list[dict[str, Any]]:
    """A scene of up to 24 things of up to four levels, from near to far."""

    def thing() -> dict[str, Any]:
        count = int(random.integers(1, 5))
        triangles = np.sort(random.integers(1, 200_000, count))[::-1].tolist()
        lods = [{"level": level, "triangles": size} for level, size in enumerate(triangles)]
        return {"share": float(random.exponential(0.3)), "lods": lods, "now": int(random.integers(0, count))}

    return [thing() for _ in range(int(random.integers(1, 25)))]


def test_levels_keep_the_budget_and_boxes_their_distance(scripts: PageScripts) -> None:
    random = np.random.default_rng(0)
    scenes = [things(random) for _ in range(200)]
    budgets = [int(each) for each in random.integers(1, 2_000_000, 200)]
    sizes = [random.uniform(0.05, 3, (int(random.integers(1, 25)), 3)).tolist() for _ in range(100)]
    script = """async ([scenes, budgets, sizes]) => {
        const { chooseLevels, placeSideBySide } = await import('/web/scenes/layout-and-lod.js');
        const free = (things) => chooseLevels(things, Infinity);
        const kept = scenes.map((things, place) => chooseLevels(things, budgets[place]));
        return [kept, scenes.map(free), sizes.map(placeSideBySide)];
    }"""
    within, free, placed = scripts.evaluate(script, [scenes, budgets, sizes])
    for scene, budget, levels, wanted in zip(scenes, budgets, within, free, strict=True):
        cost = [each["lods"][level]["triangles"] for each, level in zip(scene, levels, strict=True)]
        least = sum(each["lods"][-1]["triangles"] for each in scene)
        assert sum(cost) <= max(budget, least)
        assert all(level >= want for level, want in zip(levels, wanted, strict=True))
        assert least > budget or sum(cost) == least or sum(cost) <= budget
    for boxes, places in zip(sizes, placed, strict=True):
        expect_apart(np.array(boxes), np.array(places))


def expect_apart(sizes: np.ndarray, places: np.ndarray) -> None:
    """sizes (N,3), places (N,2) of floor centres: no two boxes are nearer than 10 cm on both axes."""
    centres, halves_ = places[:, None] - places[None], (sizes[:, None, ::2] + sizes[None, :, ::2]) / 2
    gaps = (np.abs(centres) - halves_).max(axis=2)
    np.fill_diagonal(gaps, np.inf)
    assert len(sizes) == 1 or gaps.min() > 0.099
