"""The last word on a candidate: every target measured in the time domain with the accuracy of ``sbg sweep``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from continuation.timedomain.sweep import task
from continuation.timedomain.sweep_result import Sweep
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.documents import STATE
from sbg_casadi.identification.parametric import Parametric
from sbg_casadi.identification.runs import Runs
from sbg_casadi.identification.scoring import grid, nearest_jump, peak_of
from sbg_casadi.identification.targets import Target, regime_period
from sbg_casadi.model import static_state
from sbg_casadi.pair import Pair
from sbg_casadi.response import PARAMETER

_FINER = 4  # frequency ratios for one of the search
_TRANSIENT, _RECORDED = 80, 160  # mesh periods at each of them
_LEAST, _LIMIT, _KEPT, _TOLERANCE = 32, 600, 64, 1e-7  # of the sweep that settles single responses
_OTHER_REGIME = 1.0


@dataclass(frozen=True, slots=True)
class Checked:
    """Hold what was measured for one target.

    Attributes
    ----------
    values : tuple of float
        In the order of the quantities wanted; empty for a regime.
    words : str
        What the response is, for a regime, an RMS or an exponent; empty else.
    """

    values: tuple[float, ...]
    words: str


def check_targets(
    pair: Pair, equations: Parametric, targets: Sequence[Target], tell: Callable[[float, str], None] | None = None
) -> list[Checked]:
    """Measure all targets on a pair.

    Single responses begin at rest under the mean load and settle as in ``sbg section``; peaks and jumps come from a
    sweep up and down with four times the frequency ratios of the search.
    """
    runs, swept = Runs(equations, transient=400, recorded=512), dict[str, Sweep]()
    found = []
    for i, target in enumerate(targets):
        if tell:
            tell(i / len(targets), target.name)
        d = pair.dimensionless(target.state)
        if target.kind in ("peak", "jump"):
            found.append(_from_sweep(runs, d, target))
            continue
        if target.state not in swept:
            own = (t for t in targets if t.state == target.state and t.kind in ("rms", "regime", "exponent"))
            swept[target.state] = _settled(equations, d, list(dict.fromkeys(t.at for t in own)))
        found.append(_from_single(runs, d, target, swept[target.state]))
    return found


def _settled(equations: Parametric, d: Dimensionless, ratios: list[float]) -> Sweep:
    """Return the responses at frequency ratios, each from rest, as ``sbg sweep`` judges them."""
    starts = np.tile(static_state(d), (len(ratios), 1))
    plain = task(
        equations.system, PARAMETER, np.array(ratios), STATE, "", None, starts, _LEAST, _LIMIT, _KEPT, _TOLERANCE
    )
    values = {**dict(plain.model.parameters), **equations.values(d)}
    return replace(plain, model=replace(plain.model, parameters=tuple(values.items()))).run()


def _from_sweep(runs: Runs, d: Dimensionless, target: Target) -> Checked:
    ratios = grid(target.band)
    fine = np.linspace(ratios[0], ratios[-1], _FINER * (len(ratios) - 1) + 1)
    swept = runs.sweep(d, fine, _TRANSIENT, _RECORDED)
    if target.kind == "jump":
        return Checked((nearest_jump(swept, target.wanted[0][1]),), "")
    ratio, height = peak_of(swept)
    return Checked(tuple(height if q == "height" else ratio for q, _, _ in target.wanted), "")


def _from_single(runs: Runs, d: Dimensionless, target: Target, swept: Sweep) -> Checked:
    i = int(np.argmin(np.abs(swept.values - target.at)))
    words = swept.verdicts[i]
    if target.kind == "regime":
        return Checked((), words)
    if target.kind == "rms":
        return Checked((float(swept.rms[i]),), words)
    exponent = float(swept.exponent[i])
    if not np.isfinite(exponent):  # it repeats
        exponent = runs.response(d, target.at, swept.states[i]).growth * target.at / (2 * np.pi)
    return Checked((exponent,), words)


def residuals_of(target: Target, found: Checked, cheap: Sequence[float]) -> list[float]:
    """Return the residuals of a checked target; a missed regime keeps its graded one of the search, 1 at least."""
    if target.kind == "regime":
        return [0.0 if has_regime(found.words, target.regime) else max(_OTHER_REGIME, float(np.nan_to_num(cheap[0])))]
    return [(v - wanted) / tolerance for v, (_, wanted, tolerance) in zip(found.values, target.wanted, strict=True)]


def has_regime(words: str, regime: str) -> bool:
    """Tell whether a verdict of a sweep is of a regime.

    Examples
    --------
    >>> has_regime("period-4", "periodic"), has_regime("period-4", "period-2"), has_regime("chaotic", "chaotic")
    (True, False, True)
    """
    if regime_period(regime) == 0:
        return words.startswith("period-")
    return words == regime
