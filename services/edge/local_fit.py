"""Points → the preview's field: choose the preset, hold points out, denoise the others, fit the local field."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace

import numpy as np

from capture2vr.edge.arrays import Bools, DistanceFn, Floats, Tick
from capture2vr.edge.certificate import Evidence, hold_out
from capture2vr.edge.field.denoise import denoise
from capture2vr.edge.field.folds import noise_of
from capture2vr.edge.field.local import local_field
from capture2vr.edge.field.noise import Noise
from capture2vr.edge.paper_field.network_config import NetworkConfig
from capture2vr.edge.points.downsample import downsample_points
from capture2vr.edge.points.nouns import Points, UnitFrame
from capture2vr.edge.points.unit import unit_frame
from capture2vr.edge.preset import AUTOMATIC, Preset, load_preset
from capture2vr.edge.preset_choice import choose, traits_of
from capture2vr.edge.progress import Bar, Clock, Progress
from capture2vr.sentences.sentence import say


@dataclass(frozen=True, slots=True)
class SplitPoints:
    """A job's points, split into those that its fields are fitted to and those that are held out.

    preset    as named, or as chosen from the points: then `because` says why
    fitted    at most as many as the preset wants; they are none of the held-out ones
    evidence  (N,3) capture frame: points that surfaces are compared with
    watched   (M,3) capture frame: points on which a training stops early
    """

    preset: Preset
    because: str
    all: Points
    fitted: Points
    evidence: Floats
    watched: Floats


@dataclass(frozen=True, slots=True)
class LocalFit:
    """The preview's field, and the points that it was fitted to in the unit frame, (N,3): as measured, and denoised.

    watched  (M,3) unit frame: points on which a training stops early
    """

    unit: UnitFrame
    measured: Floats
    noise: Noise
    xyz_unit: Floats
    distance: DistanceFn
    evidence: Evidence
    watched: Floats


def split_points(points: Points, preset: Preset, device: str) -> SplitPoints:
    """Choose the preset if it is automatic, hold points out, and thin the others to what the preset takes."""
    preset, because = _resolve_preset(preset, points, device)
    held_out, given = np.zeros(len(points), np.int64), points.given
    held_out[given] = hold_out(int(given.sum()), sets=2 if _early_stop_steps(preset) else 1)
    fitted = downsample_points(points.subset(held_out == 0), preset.most_points)
    return SplitPoints(preset, because, points, fitted, points.xyz[held_out == 1], points.xyz[held_out == 2])


def fit_local(split: SplitPoints, clock: Clock, bar: Bar) -> Generator[Progress, None, LocalFit]:
    """Fit the preview's field, in a unit frame around its points."""
    counted = say("count_points", count=len(split.fitted))
    chosen = say("with_preset_because", what=counted, preset=split.preset.name, because=split.because)
    yield bar.begin("FITTING", chosen if split.because else counted)
    with clock("FITTING"):
        unit = unit_frame(split.fitted.xyz)
        measured = unit.to_unit(split.fitted.xyz)
        noise, xyz_unit = _denoised(measured, split.fitted.given, bar.tick("FITTING"))
        distance = local_field(xyz_unit, tick=bar.tick("FITTING"))
    evidence = Evidence.of(xyz_unit[split.fitted.given], unit.to_unit(split.evidence))
    return LocalFit(unit, measured, noise, xyz_unit, distance, evidence, unit.to_unit(split.watched))


def _denoised(xyz_unit: Floats, given: Bools, tick: Tick) -> tuple[Noise, Floats]:
    """Return the noise of points (N,3), and the points without it; inferred ones have none, and stay."""
    found = noise_of(xyz_unit[given], tick=tick)
    noise = Noise(np.zeros(len(xyz_unit)), np.zeros(len(xyz_unit)))
    noise.sigma[given], noise.share[given] = found.sigma, found.share
    left = xyz_unit.copy()
    left[given] = denoise(xyz_unit[given], found, tick=tick)
    return noise, left


def _resolve_preset(preset: Preset, points: Points, device: str) -> tuple[Preset, str]:
    """Return the preset to use, chosen from the points if it is automatic, and the reason; "" for a named one.

    A resolution that was asked for stays.
    """
    if preset.name != AUTOMATIC:
        return preset, ""
    choice = choose(traits_of(points, gpu=device != "cpu"))
    chosen = load_preset(choice.preset)
    return replace(chosen, resolution=preset.resolution, finest=choice.finest or chosen.finest), choice.because


def _early_stop_steps(preset: Preset) -> int:
    """Steps without a gain on held-out points after which training stops early; 0: it never does."""
    return preset.fit.patience if isinstance(preset.fit, NetworkConfig) else 0
