"""How far a candidate is from the targets: residuals in tolerances, with a graded score for regimes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from continuation import ContinuationError
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.identification.runs import LARGEST_PERIOD, RETURN, Response, Runs, Swept
from sbg_casadi.identification.targets import Target, regime_period

CHAOS = 0.02
"""Growth per mesh period above which a response counts as chaotic in the search."""

POINTS = 36
"""Frequency ratios of a sweep over the default band; others have as many per unit of the ratio."""

LOST = 12.0  # residual of what could not be computed
_MISSED = 1.0  # least residual of a regime that is another one


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """Hold residuals (m,) in tolerances, in the order of the targets, and the cost made of them.

    ``measured`` has the values behind them: a regime's is its period, 0 where nothing repeats.
    """

    residuals: np.ndarray
    cost: float
    measured: tuple[tuple[float, ...], ...]

    @property
    def complete(self) -> bool:
        """Whether all targets were looked at."""
        return not bool(np.isnan(self.residuals).any())


def cost(residuals: np.ndarray) -> float:
    """Return the sum of squares, with residuals beyond one tolerance counted less and less (Huber, then logarithm).

    Examples
    --------
    >>> cost(np.array([0.5, 0.0])), cost(np.array([3.0]))
    (0.25, 5.0)
    """
    r = np.abs(residuals)
    huber = np.where(r <= 1, r**2, 2 * r - 1)
    return float(np.where(r <= 4, huber, 7 + 2 * np.log1p(np.maximum(r - 4, 0))).sum())


def grid(band: tuple[float, float]) -> np.ndarray:
    """Return the frequency ratios of a sweep over a band."""
    return np.linspace(*band, max(9, round(1 + (POINTS - 1) * (band[1] - band[0]) / 2.3)))


def score(runs: Runs, targets: Sequence[Target], states: Mapping[str, Dimensionless], limit: float = np.inf) -> Score:
    """Compare the cheap responses of a candidate with the targets.

    Parameters
    ----------
    runs : Runs
    targets : sequence of Target
    states : mapping of str to Dimensionless
        Numbers of the candidate in every state that a target names.
    limit : float
        Cost from which the rest is not computed; what was not has residuals NaN.
    """
    laboratory = _Laboratory(runs, states)
    order = sorted(range(len(targets)), key=lambda i: targets[i].kind in ("peak", "jump"))  # sweeps take longest
    residuals = [[np.nan] * len(target.labels) for target in targets]
    measured: list[tuple[float, ...]] = [(np.nan,) * len(target.labels) for target in targets]
    total = 0.0
    for i in order:
        measured[i], residuals[i] = laboratory.measure(targets[i])
        total += cost(np.array(residuals[i]))
        if total > limit:
            break
    return Score(np.concatenate([np.array(r, dtype=float) for r in residuals]), total, tuple(measured))


class _Laboratory:
    """Measure one candidate; what several targets need is computed once."""

    def __init__(self, runs: Runs, states: Mapping[str, Dimensionless]) -> None:
        self._runs, self._states = runs, states
        self._swept: dict[tuple[str, tuple[float, float]], Swept | None] = {}
        self._single: dict[tuple[str, float], Response | None] = {}

    def measure(self, target: Target) -> tuple[tuple[float, ...], list[float]]:
        """Return the values of a target and its residuals."""
        d = self._states[target.state]
        if target.kind in ("peak", "jump"):
            key = target.state, target.band
            if key not in self._swept:
                self._swept[key] = _sweep(self._runs, d, target.band)
            values = _from_sweep(target, self._swept[key])
            return values, _residuals(target, values, None)
        at = target.state, target.at
        if at not in self._single:
            self._single[at] = _response(self._runs, d, target.at)
        values = _from_response(target, self._single[at])
        return values, _residuals(target, values, self._single[at])


def lost(targets: Iterable[Target]) -> Score:
    """Return the score of coordinates at which there is no pair."""
    labels = [target.labels for target in targets]
    r = np.full(sum(map(len, labels)), LOST)
    return Score(r, cost(r), tuple((np.nan,) * len(one) for one in labels))


def _sweep(runs: Runs, d: Dimensionless, band: tuple[float, float]) -> Swept | None:
    try:
        return runs.sweep(d, grid(band))
    except ContinuationError:
        return None


def _response(runs: Runs, d: Dimensionless, ratio: float) -> Response | None:
    try:
        return runs.response(d, ratio)
    except ContinuationError:
        return None


def _from_sweep(target: Target, swept: Swept | None) -> tuple[float, ...]:
    if swept is None:
        return (np.nan,) * len(target.wanted)
    if target.kind == "jump":
        return (nearest_jump(swept, target.wanted[0][1]),)
    ratio, height = peak_of(swept)
    return tuple(height if quantity == "height" else ratio for quantity, _, _ in target.wanted)


def peak_of(swept: Swept) -> tuple[float, float]:
    """Return frequency ratio and RMS of the largest response of a sweep, from a parabola where it is smooth there."""
    row, i = np.unravel_index(int(np.argmax(swept.rms)), swept.rms.shape)
    y, x = swept.rms[row], swept.ratios
    if 0 < i < len(x) - 1:
        bend = y[i - 1] - 2 * y[i] + y[i + 1]
        shift = (y[i - 1] - y[i + 1]) / (2 * bend) if bend < 0 else 0.0
        if abs(shift) <= 0.5 and min(y[i - 1], y[i + 1]) > 0.7 * y[i]:
            half = (y[i + 1] - y[i - 1]) / 2
            return float(x[i] + shift * (x[1] - x[0])), float(y[i] + half * shift / 2)
    return float(x[i]), float(y[i])


def nearest_jump(swept: Swept, position: float) -> float:
    """Return the middle of the step nearest to a position over which a sweep jumps, NaN where nothing jumps.

    A jump is a change of the RMS by more than a fifth of the largest RMS and four times the change on both sides.
    """
    middles = (swept.ratios[1:] + swept.ratios[:-1]) / 2
    found = []
    for row in swept.rms:
        change = np.abs(np.diff(row))
        beside = np.maximum(np.append(change[1:], 0.0), np.append(0.0, change[:-1]))
        at = (change > 0.2 * row.max()) & (change > 4 * beside)
        found += middles[at].tolist()
    return min(found, key=lambda m: abs(m - position)) if found else float("nan")


def _from_response(target: Target, found: Response | None) -> tuple[float, ...]:
    if found is None:
        return (np.nan,)
    if target.kind == "rms":
        return (found.rms,)
    if target.kind == "exponent":
        return (found.growth * target.at / (2 * np.pi),)
    return (float(found.period),)


def _residuals(target: Target, values: tuple[float, ...], found: Response | None) -> list[float]:
    if target.kind == "regime":
        return [LOST if found is None else regime_residual(target.regime, found)]
    pairs = zip(target.wanted, values, strict=True)
    return [LOST if np.isnan(v) else (v - wanted) / tolerance for (_, wanted, tolerance), v in pairs]


def regime_residual(regime: str, found: Response) -> float:
    """Return 0 where a response is of a regime, else 1 and more the further it is from it.

    Chaos: growth per period. Period n: distance after n periods; of a response of another period, by how much the
    period differs and how far it is from a doubling. Quasi-periodic: growth.
    """
    wanted, growth = regime_period(regime), found.growth
    if wanted < 0 and regime == "chaotic":
        if found.period == 0 and growth > max(CHAOS, 3 * found.growth_error):
            return 0.0
        return _MISSED + 4 * float(np.clip((CHAOS - growth) / 0.5, 0.02, 1.0)) + (found.period > 0)
    if wanted < 0:
        off = abs(growth) - CHAOS
        return 0.0 if off < 0 and found.period == 0 else _MISSED + float(np.clip(off / 0.2, 0, 3)) + (found.period > 0)
    if found.period == wanted or (wanted == 0 and found.period > 0):
        return 0.0
    if found.period > 0:
        nearness = float(np.clip(-growth / 0.5, 0, 1))  # 0 at a bifurcation
        return _MISSED + min(abs(np.log2(found.period / wanted)), 3.0) / 2 + nearness
    best = found.returns[wanted - 1] if 0 < wanted <= LARGEST_PERIOD else found.returns.min()
    far = float(np.clip(np.log10(max(best, RETURN) / RETURN) / 3, 0, 1))
    return _MISSED + 2 * far + float(np.clip(growth / 0.2, 0, 2))
