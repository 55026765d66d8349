"""A day of a fleet as a discrete-event simulation (SimPy): phones, links, workers, headsets.

Captures arrive as a Poisson process whose rate follows the hours of a day. Each is one of the measured ones, drawn at
random, and goes one of three ways:

centre  phone → uplink → any worker of one pool, which does everything → headset
boxes   phone → Wi-Fi → the one worker of its place, which does everything → the place's uplink → headset
split   phone → Wi-Fi → the worker of its place makes the points → the place's uplink → a pool fits and publishes

A worker has one slot, first come, first served, as the product's queue has for one tenant. A pool is fixed, or grows
and shrinks by the rule of the chart's KEDA scaler. All publish into one collection, the worst case: one commit at a
time, which takes all that wait.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import simpy

Way = Literal["centre", "boxes", "split"]
WAYS: tuple[Way, ...] = ("centre", "boxes", "split")
DAY_S = 86_400.0
_SWING = 0.9  # of the rate about its mean over a day: the busiest hour has 1.9 times the mean
_AFTER_S = 7_200.0
_NOTICE_S = 0.2  # from publishing until the headset has asked: an event, a catalogue
_SEEN_S = 2.5  # from the start of a worker until gateways see it: half the lookup's period, and a poll


@dataclass(frozen=True, slots=True)
class Sample:
    """A measured capture: bytes that are sent, and seconds that a worker of two cores works.

    points_s    from the upload's end to the points;  preview_s  from there to the preview;  refine_s  to the job's end
    points_bytes  what a split sends;  first_bytes  what a headset needs for its first picture;  all_bytes  the bundle
    """

    name: str
    upload_bytes: float
    points_bytes: float
    first_bytes: float
    all_bytes: float
    points_s: float
    preview_s: float
    refine_s: float


@dataclass(frozen=True, slots=True)
class Links:
    """Medians of the links in bytes per second; a phone's and a headset's vary by `spread` (σ of the logarithm)."""

    phone_up: float = 20e6 / 8
    wifi: float = 150e6 / 8
    place_up: float = 50e6 / 8
    headset_down: float = 100e6 / 8
    spread: float = 0.6


@dataclass(frozen=True, slots=True)
class Scaling:
    """How many workers a pool has: `least` to `most`; where these differ, one for every unfinished job.

    The defaults are the chart's: asked every 10 s, none is taken away while there was a job in the last 300 s.
    start_s  from the decision until the worker runs: an image that is there, an import of PyTorch
    """

    least: int
    most: int
    every_s: float = 10.0
    cooldown_s: float = 300.0
    start_s: float = 25.0


@dataclass(frozen=True, slots=True)
class Commits:
    """What it takes to list a version in its collection, of any size: `python -m tests.bench catalogue`.

    seconds  of one commit, where a call of the store takes 20 ms;  most  publications that share one
    """

    seconds: float = 0.5
    most: int = 128


@dataclass(frozen=True, slots=True)
class Fleet:
    """What is simulated: a way, captures a day, places with a worker each, the pool's size."""

    way: Way
    per_day: float
    places: int
    pool: Scaling
    links: Links = Links()
    commits: Commits = Commits()


@dataclass(slots=True)
class Outcome:
    """What came out, in seconds: of every capture that got there the first look and the end, of every publication how
    long it took to be listed, of the workers what they were paid for and what they worked."""

    arrived: int = 0
    listed_s: list[float] = field(default_factory=list)
    first_look_s: list[float] = field(default_factory=list)
    end_s: list[float] = field(default_factory=list)
    pool_s: float = 0.0
    box_s: float = 0.0
    worked_s: float = 0.0
    most_workers: int = 0
    sent_bytes: float = 0.0


class _Collection:
    """Lists what is published: whoever publishes during a commit waits for the next one, which takes all that wait."""

    def __init__(self, env: simpy.Environment, commits: Commits, outcome: Outcome) -> None:
        self._env, self._commits, self._outcome = env, commits, outcome
        self._waiting: list[tuple[float, Any]] = []
        self._commits_now = False

    def publish(self) -> Any:
        """Return the event that a publication is listed."""
        listed = self._env.event()
        self._waiting.append((float(self._env.now), listed))
        if not self._commits_now:
            self._commits_now = True
            self._env.process(self._commit())
        return listed

    def _commit(self) -> Generator[Any, Any, None]:
        while self._waiting:
            batch, self._waiting = self._waiting[: self._commits.most], self._waiting[self._commits.most :]
            yield self._env.timeout(self._commits.seconds)
            for since, listed in batch:
                self._outcome.listed_s.append(float(self._env.now) - since)
                listed.succeed()
        self._commits_now = False


class _Pool:
    """Workers with one slot each, as tokens in a store: who has one, works."""

    def __init__(self, env: simpy.Environment, scaling: Scaling, outcome: Outcome) -> None:
        self._env, self._scaling, self._outcome = env, scaling, outcome
        self.idle: Any = simpy.Store(env)
        self.idle.items.extend(range(scaling.least))
        self.unfinished, self._workers, self._starting = 0, scaling.least, 0
        self._busy_until = self._since = float(env.now)
        outcome.most_workers = scaling.least
        if scaling.most > scaling.least:
            env.process(self._scale())

    def work(self, parts: Sequence[tuple[float, Callable[[], Any] | None]]) -> Generator[Any, Any, None]:
        """Wait for a worker, and let it do the parts, each (seconds, what it publishes at its end: an event)."""
        self.unfinished += 1
        token = yield self.idle.get()
        for seconds, publish in parts:
            began = float(self._env.now)
            yield self._env.timeout(seconds)
            if publish is not None:
                yield publish()
            self._outcome.worked_s += float(self._env.now) - began
        self.unfinished -= 1
        self._busy_until = self._env.now
        yield self.idle.put(token)

    def settle(self) -> None:
        """Add up what the workers were paid for until now."""
        now = float(self._env.now)
        self._outcome.pool_s += (now - self._since) * (self._workers + self._starting)
        self._since = now

    def _scale(self) -> Generator[Any, Any, None]:
        scaling = self._scaling
        while True:
            yield self._env.timeout(scaling.every_s)
            self.settle()
            wanted = min(max(self.unfinished, scaling.least), scaling.most)
            have = self._workers + self._starting
            for _ in range(have, wanted):
                self._starting += 1
                self._env.process(self._start())
            if wanted < have and (wanted > 0 or self._env.now - self._busy_until >= scaling.cooldown_s):
                for _ in range(min(have - wanted, len(self.idle.items))):  # those that work are drained: they end
                    self.idle.items.pop()
                    self._workers -= 1
            self._outcome.most_workers = max(self._outcome.most_workers, self._workers + self._starting)

    def _start(self) -> Generator[Any, Any, None]:
        yield self._env.timeout(self._scaling.start_s + _SEEN_S)
        self.settle()
        self._starting -= 1
        self._workers += 1
        yield self.idle.put(object())


def simulate(
    fleet: Fleet, samples: Sequence[Sample], *, seed: int = 0, from_hour: float = 0.0, to_hour: float = 24.0
) -> Outcome:
    """Simulate these hours of a day, and two more in which nothing arrives: what has not ended then never does."""
    begin, end = from_hour * 3600, to_hour * 3600
    env, outcome, chance = simpy.Environment(begin), Outcome(), random.Random(seed)
    pool = _Pool(env, fleet.pool, outcome) if fleet.way != "boxes" else None
    own = Outcome()  # of the boxes: paid for all day, counted apart
    at_places = fleet.way != "centre"
    boxes = [_Pool(env, Scaling(1, 1), own) for _ in range(fleet.places)] if at_places else []
    uplinks = [simpy.Resource(env) for _ in boxes]
    collection = _Collection(env, fleet.commits, outcome)

    def capture(sample: Sample) -> Generator[Any, Any, None]:
        began, links = float(env.now), fleet.links
        outcome.arrived += 1
        up, down = (median * chance.lognormvariate(0, links.spread) for median in (links.wifi, links.headset_down))
        if not boxes:
            up = links.phone_up * chance.lognormvariate(0, links.spread)
        place = chance.randrange(len(boxes)) if boxes else 0
        yield env.timeout(sample.upload_bytes / up)

        def first_look(_: Any) -> None:
            way = sample.first_bytes / down + (sample.first_bytes / links.place_up if pool is None else 0.0)
            outcome.first_look_s.append(env.now - began + _NOTICE_S + way)

        def publish_preview() -> Any:
            listed = collection.publish()
            listed.callbacks.append(first_look)
            return listed

        points, look = (sample.points_s, None), (sample.preview_s, publish_preview)
        rest = (sample.refine_s, collection.publish)
        if not boxes:
            assert pool is not None
            yield from pool.work((points, look, rest))
        elif pool is None:
            yield from boxes[place].work((points, look, rest))
            yield from send(place, sample.all_bytes)
        else:
            yield from boxes[place].work((points,))
            yield from send(place, sample.points_bytes)
            yield from pool.work((look, rest))
        outcome.sent_bytes += sample.first_bytes + sample.all_bytes
        outcome.end_s.append(env.now - began)

    def send(place: int, size: float) -> Generator[Any, Any, None]:
        with uplinks[place].request() as turn:
            yield turn
            yield env.timeout(size / fleet.links.place_up)

    def arrivals() -> Generator[Any, Any, None]:
        for pause in _pauses(fleet.per_day, chance, begin, end):
            yield env.timeout(pause)
            env.process(capture(chance.choice(samples)))

    env.process(arrivals())
    env.run(until=end)
    if pool is not None:
        pool.settle()
    paid_s = outcome.pool_s
    env.run(until=end + _AFTER_S)
    outcome.pool_s = paid_s
    outcome.worked_s += own.worked_s
    outcome.box_s = (end - begin) * len(boxes)
    return outcome


def _pauses(per_day: float, chance: random.Random, begin_s: float, end_s: float) -> Iterator[float]:
    """Yield the seconds between arrivals: a Poisson process whose rate swings over the day, by thinning (Lewis and
    Shedler 1979)."""
    most = per_day / DAY_S * (1 + _SWING)
    last = now = begin_s
    while True:
        now += chance.expovariate(most)
        if now >= end_s:
            return
        rate = 1 - _SWING * math.cos(2 * math.pi * now / DAY_S)  # least at midnight
        if chance.random() * (1 + _SWING) < rate:
            yield now - last
            last = now
