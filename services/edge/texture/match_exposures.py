"""Match photos' exposures and white balances to each other: a gain per photo and channel, solved for all together.

A phone exposes each photo anew, and the captured points are means over photos of different exposures: a photo that is
matched to them alone differs from its neighbours. Where two photos see a place, their difference in log light is the
difference of their gains; robust least squares over all places finds the gains that leave least of it. Highlights,
which one photo has and the others have not, and prints that lie a pixel apart count little.

Symbols: y_pi = log light that photo i shows at place p, g_i = log of its gain, a_p = log light of the place, and the
residual r_pi = s_p (y_pi + g_i - a_p), where s_p makes of a difference in log light one that is seen, in tones. The a_p
are eliminated: they are weighted means over the photos. The points count as one more photo, whose gain is 1, of little
weight: they keep the overall colour, and a photo that shares no place with another.
"""

from __future__ import annotations

import numpy as np

from capture2vr.edge.arrays import Bools, Floats

_ENOUGH_PLACES = 8_000  # at light that differs by 5 % between photos, gains are then exact to half a percent
_FEWEST_PLACES = 100  # that a photo must see to be compared; one that sees fewer keeps its exposure
_DARK, _BRIGHT = 0.01, 0.9  # linear light that is compared: darker or brighter values may be clipped
_TONE = 0.5  # power of light that is about proportional to tones: they have the same noise, bright and dark
_TIE = 0.1  # weight of the points beside a photo: they decide only what the photos leave open
_ROBUST = 2.0  # residuals of more than so many standard deviations count less (Cauchy)
_LEAST_SPREAD = 0.002  # of residuals, in tones: what 8 bits leave. The points' tie stays where a photo has no neighbour
_ROUNDS = 6  # of least squares, each with weights by the residuals of the one before
_MOST_GAIN = 3.0  # and least 1/3: a photo that differs more shows something else
_DAMPING = 1e-9  # share of the matrix' trace, added to its diagonal: a photo that sees nothing has gain 1


def match_exposures(shown: Floats, quality: Floats, known: Floats) -> Floats:
    """Return gains (N,3) float32 that bring N photos' linear light to one exposure, close to that of the points.

    shown    (P,N,3) linear light of the photos at places
    quality  (P,N) how well they see them, 0 where they do not
    known    (P,3) linear light of the points there

    A photo that shows nothing but deep colours, a channel of which is too dark to be compared, is matched by the mean
    of its channels: that tells its exposure, though not its white balance.
    """
    gains, matched = _gains_of_channels(shown, quality, known)
    if not matched.all():
        grey, known_grey = (each.mean(axis=-1, keepdims=True) for each in (shown, known))
        gains[~matched] = _gains_of_channels(grey, quality, known_grey)[0][~matched]
    return gains


def _gains_of_channels(shown: Floats, quality: Floats, known: Floats) -> tuple[Floats, Bools]:
    """Gains (N,C) float32 of each of the C channels, and a mask (N,) of the photos that could be compared; the others
    have gain 1."""
    seen = (quality > 0) & _unclipped(shown) & _unclipped(known)[:, None]
    seen[:, seen.sum(axis=0) < _FEWEST_PLACES] = False
    chosen = np.flatnonzero(seen.any(axis=1))
    chosen = chosen[:: -(-len(chosen) // _ENOUGH_PLACES) or 1]
    shown, quality, known = (each[chosen] for each in (shown, quality, known))
    seen = seen[chosen]
    if not len(chosen):
        return np.ones(shown.shape[1:], np.float32), np.zeros(shown.shape[1], bool)
    weight = np.column_stack([np.where(seen, quality, 0), np.full(len(seen), _TIE)])
    y = np.log(np.maximum(np.concatenate([shown, known[:, None]], axis=1), _DARK)).astype(np.float64)
    gains = np.stack([_log_gains(y[..., band], weight, seen) for band in range(shown.shape[2])], axis=1)
    clipped = np.clip(gains, -np.log(_MOST_GAIN), np.log(_MOST_GAIN))
    return np.exp(clipped).astype(np.float32), np.asarray(seen.any(axis=0))


def _unclipped(light: Floats) -> Bools:
    """(...) where all channels of light (...,3) are neither too dark nor too bright to be compared."""
    return np.asarray(((light > _DARK) & (light < _BRIGHT)).all(axis=-1))


def _log_gains(y: Floats, weight: Floats, seen: Bools) -> Floats:
    """(N,) g of the photos in one channel, from y and weight (P,N+1), whose last column is the points'.

    Their mean stays that of the photos' median differences from the points.
    """
    size = np.exp(_TONE * y[:, -1:])
    weight = weight * size**2
    trusted = weight
    gains = np.zeros(y.shape[1])
    for _ in range(_ROUNDS):
        gains[:-1] = _least_squares(y, trusted)
        corrected = y + gains
        residual = size * (corrected - _means(corrected, trusted)[:, None])
        spread = max(1.4826 * float(np.median(np.abs(residual[:, :-1][seen]))), _LEAST_SPREAD)
        trusted = weight / (1 + np.square(residual / (_ROBUST * spread)))
    used = np.flatnonzero(seen.any(axis=0))
    usual = [float(np.median(y[seen[:, number], -1] - y[seen[:, number], number])) for number in used]
    gains[used] += np.mean(usual) - gains[used].mean()
    return gains[:-1]


def _means(y: Floats, weight: Floats) -> Floats:
    """(P,) weighted mean of each row."""
    means: Floats = np.einsum("pn,pn->p", weight, y) / weight.sum(axis=1)
    return means


def _least_squares(y: Floats, weight: Floats) -> Floats:
    """(N,) g that minimise Σ w r², the last column's g being 0: the normal equations without the a_p."""
    share = weight / weight.sum(axis=1, keepdims=True)
    matrix = np.diag(weight.sum(axis=0)) - weight.T @ share
    right = -np.einsum("pn,pn->n", weight, y - _means(y, weight)[:, None])
    matrix[np.diag_indices(len(matrix))] += _DAMPING * np.trace(matrix)
    return np.asarray(np.linalg.solve(matrix[:-1, :-1], right[:-1]))
