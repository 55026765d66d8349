"""The bench of fleets: the simulation against queueing theory, and what its tables are made of."""

from __future__ import annotations

import math
from statistics import mean

import pytest

from tests.bench.load.fleet import POOLS, Prices, at_share, capacity, cost_cents, read_samples
from tests.bench.load.fleet_model import WAYS, Commits, Fleet, Links, Sample, Scaling, Way, simulate

EXACT = Links(phone_up=1e12, wifi=1e12, place_up=1e12, headset_down=1e12, spread=0.0)
AT_ONCE = Commits(seconds=0.0)
TEN_S = Sample("ten seconds", 1, 1, 1, 1, points_s=4.0, preview_s=5.0, refine_s=1.0)


def one_pool(per_day: float, workers: int) -> Fleet:
    return Fleet("centre", per_day, 0, Scaling(workers, workers), EXACT, AT_ONCE)


@pytest.mark.slow
def test_waiting_is_what_queueing_theory_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """M/D/1 (Pollaczek and Khinchine): with Poisson arrivals, a constant time of service s and a load ρ, the mean wait
    is s ρ / (2 (1 − ρ))."""
    monkeypatch.setattr("tests.bench.load.fleet_model._SWING", 0.0)
    for load in (0.3, 0.6, 0.8):
        looks = [
            look for seed in range(8) for look in simulate(one_pool(load * 8_640, 1), [TEN_S], seed=seed).first_look_s
        ]
        waited = mean(looks) - TEN_S.points_s - TEN_S.preview_s - 0.2
        assert waited == pytest.approx(10 * load / (2 * (1 - load)), rel=0.12)


@pytest.mark.parametrize("way", WAYS)
def test_every_capture_ends_once_and_no_time_is_lost(way: Way) -> None:
    fleet = Fleet(way, 500, 5, Scaling(0, 50), EXACT, AT_ONCE)
    outcome = simulate(fleet, [TEN_S])
    assert len(outcome.first_look_s) == len(outcome.end_s) == outcome.arrived
    assert outcome.arrived == pytest.approx(500, abs=5 * math.sqrt(500))
    assert outcome.worked_s == pytest.approx(10 * outcome.arrived)
    assert outcome.pool_s + outcome.box_s >= outcome.worked_s * (0.6 if way == "split" else 1) - 1e-6
    assert min(outcome.first_look_s) >= 9


def test_who_publishes_during_a_commit_shares_the_next_one() -> None:
    def listed(most: int) -> list[float]:
        fleet = Fleet("centre", 20_000, 0, Scaling(60, 60), EXACT, Commits(2.0, most))
        return simulate(fleet, [TEN_S], from_hour=11, to_hour=12.5).listed_s

    shared, alone = listed(128), listed(1)
    assert min(shared) == pytest.approx(2.0)
    assert max(shared) < 4.001, "the rest of a commit, and a whole one, however many publish"
    assert at_share(alone, len(alone), 0.5) > 60


def test_the_same_seed_is_the_same_day() -> None:
    fleet = Fleet("split", 300, 3, Scaling(0, 9))
    assert simulate(fleet, read_samples(), seed=3) == simulate(fleet, read_samples(), seed=3)
    assert simulate(fleet, read_samples(), seed=3) != simulate(fleet, read_samples(), seed=4)


def test_a_pool_grows_with_the_queue_and_shrinks_to_none() -> None:
    quiet = simulate(Fleet("centre", 20, 0, Scaling(0, 100), EXACT, AT_ONCE), [TEN_S])
    busy = simulate(Fleet("centre", 20_000, 0, Scaling(0, 100), EXACT, AT_ONCE), [TEN_S])
    assert quiet.most_workers <= 3
    assert quiet.pool_s < 0.2 * 86_400, "it costs nothing while nobody comes"
    assert min(quiet.first_look_s) >= 9
    assert 3 <= busy.most_workers < 60


@pytest.mark.slow
def test_what_cannot_be_borne_is_not_hidden() -> None:
    outcome = simulate(one_pool(86_400, 1), [TEN_S], from_hour=11, to_hour=12)
    assert len(outcome.first_look_s) < outcome.arrived
    assert at_share(outcome.first_look_s, outcome.arrived, 0.95) == math.inf


@pytest.mark.slow
def test_capacity_is_below_what_the_workers_could_do_without_a_pause() -> None:
    most = capacity([TEN_S], lambda load: one_pool(load, 4), at_most=50_000)
    assert 0.5 < most * 1.9 / (4 * 8_640) < 1.02


def test_shares_count_what_never_arrived() -> None:
    assert at_share([3.0, 1.0, 2.0], 3, 0.5) == 2.0
    assert at_share([3.0, 1.0, 2.0], 4, 0.75) == 3.0
    assert at_share([3.0, 1.0, 2.0], 4, 0.95) == math.inf


def test_costs_are_those_of_what_was_paid_for() -> None:
    outcome = simulate(one_pool(864, 1), [TEN_S])
    hour = Prices(worker_h=1.0, box_h=0.0, gb_out=0.0, gb_year=0.0)
    assert cost_cents(outcome, [TEN_S], hour) == pytest.approx(100 * 24 / len(outcome.end_s))


def test_the_measured_captures_are_whole() -> None:
    samples = read_samples()
    assert len(samples) >= 5
    for each in samples:
        assert min(each.upload_bytes, each.points_bytes, each.first_bytes) > 0
        assert each.all_bytes > each.first_bytes
        assert min(each.points_s, each.preview_s, each.refine_s) > 0
    assert tuple(sorted(POOLS)) == POOLS
