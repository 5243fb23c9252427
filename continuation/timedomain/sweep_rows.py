"""What a sweep keeps of one value, and the table made of all values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from continuation.errors import ContinuationError
from continuation.timedomain.cvodes import CVODES
from continuation.timedomain.exact import describe
from continuation.timedomain.period_map import FEW, PeriodMap
from continuation.timedomain.recognition import Evidence, no_evidence
from continuation.timedomain.settling import Settled
from continuation.timedomain.sweep_result import FAILED, HARMONICS, Sweep, joined, period_verdict
from continuation.timedomain.waveform import harmonics

if TYPE_CHECKING:
    from continuation.timedomain.sweep import SweepTask

_MARCHED = " after 50 periods of compiled Runge-Kutta"


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """Hold the results at one value; ``numbers`` are rms, mean, minimum and maximum."""

    period: int
    verdict: str
    used: int
    numbers: np.ndarray
    factor: float
    harmonics: np.ndarray
    points: np.ndarray
    state: np.ndarray
    step_error: float
    evidence: Evidence
    failure: str = ""


def row_of(task: SweepTask, period_map: PeriodMap, settled: Settled) -> Row:
    """Describe a settled response over its period, or over the recorded periods where it was not recognised."""
    again = period_map.described_again and not settled.period
    begin, count = settled.begin, settled.period or task.recorded
    if again:  # the periods to describe follow those of the search
        begin, waves = settled.state, np.empty((0, 1, len(settled.state)))
    else:
        samples = settled.waveform
        count = settled.period or min(task.recorded, settled.periods_used)
        parts = samples.reshape(count, -1, samples.shape[1])
        ends = np.vstack([parts[1:, 0], settled.state])
        waves = np.concatenate([parts, ends[:, None]], axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        numbers, strobe = period_map.describe(begin, count, waves, bool(settled.period))
    _check_finite(task, numbers, begin)
    if again:
        size, amplitudes = _along(period_map, begin, count)
    else:
        size, amplitudes = float(abs(waves).max()), harmonics(period_map.quantity(waves), count, HARMONICS)
    error = period_map.step_error(begin, settled.period) / max(size, 1e-300) if settled.period else np.nan
    factor = np.nan
    if task.load:
        load = numbers[-1] if task.load != task.quantity else numbers[0]
        factor = load[3] / load[1] if load[1] > 0 else np.nan
    return Row(
        period=settled.period,
        verdict=period_verdict(settled.period),
        used=settled.periods_used + (count if again else 0),
        numbers=numbers[0],
        factor=float(factor),
        harmonics=amplitudes,
        points=strobe[:count],
        state=strobe[-1],
        step_error=float(error),
        evidence=no_evidence("the response repeats within the tolerance" if settled.period else ""),
    )


def _along(period_map: PeriodMap, x: np.ndarray, count: int) -> tuple[float, np.ndarray]:
    """Return the largest state and the harmonics of the quantity over periods from x, few at a time."""
    size, total = 0.0, np.zeros(HARMONICS + 1, dtype=complex)
    for done in range(0, count, FEW):
        waves = period_map.ahead(x, min(FEW, count - done))
        size = max(size, float(abs(waves).max()))
        total += len(waves) * harmonics(period_map.quantity(waves), len(waves), HARMONICS)
        x = waves[-1, -1]
    return size, total / count


def _check_finite(task: SweepTask, numbers: np.ndarray, begin: np.ndarray) -> None:
    for name, row in zip(dict.fromkeys(q for q in (task.quantity, task.load) if q), numbers, strict=True):
        if not np.all(np.isfinite(row)):
            state = describe(dict(zip(task.model.state_names, begin.tolist(), strict=True)))
            raise ContinuationError(
                f"{name!r} of {task.model.name!r} is no finite number all along the response that has the state "
                f"{state} at time 0, phase 0; check its expression there"
            )


def failed_row(task: SweepTask, reason: str, used: int) -> Row:
    """Return the row of a value at which the integration failed."""
    n = len(task.model.state_names)
    nothing = np.full(n, np.nan)
    return Row(
        FAILED, period_verdict(FAILED), used, np.full(4, np.nan), np.nan, np.full(HARMONICS + 1, np.nan + 0j),
        np.empty((0, n)), nothing, np.nan, no_evidence(reason), reason,
    )  # fmt: skip


def collect(task: SweepTask, rows: list[Row], before: Sweep | None) -> Sweep:
    """Return the table of the values done so far, after those that were known before."""
    known = 0 if before is None else len(before.values)
    if not rows:
        assert before is not None
        return before
    fixed = dict(task.model.parameters)
    del fixed[task.parameter]
    longest = max(len(r.points) for r in rows)
    points = np.full((len(rows), longest, len(task.model.state_names)), np.nan)
    for table, row in zip(points, rows, strict=True):
        table[: len(row.points)] = row.points
    statistics = np.array([r.numbers for r in rows])
    found = [r.evidence for r in rows]
    new = Sweep(
        system=task.model.name,
        parameter=task.parameter,
        quantity=task.quantity,
        method=method_words(task),
        fixed=fixed,
        state_names=task.model.state_names,
        values=np.array(task.values[known : known + len(rows)]),
        **dict(zip(("rms", "mean", "minimum", "maximum"), statistics.T.copy(), strict=True)),
        period=np.array([r.period for r in rows]),
        periods_used=np.array([r.used for r in rows]),
        states=np.array([r.state for r in rows]),
        failures=tuple(r.failure for r in rows),
        verdicts=tuple(r.verdict for r in rows),
        evidence=tuple(e.reason for e in found),
        dynamic_factor=np.array([r.factor for r in rows]),
        step_error=np.array([r.step_error for r in rows]),
        exponent=np.array([e.exponent for e in found]),
        exponent_error=np.array([e.exponent_error for e in found]),
        rotation=np.array([e.rotation for e in found]),
        rotation_error=np.array([e.rotation_error for e in found]),
        harmonics=np.array([r.harmonics for r in rows]),
        points=points,
    )
    return new if before is None else joined([before, new])


def method_words(task: SweepTask) -> str:
    """Return the integrator in words."""
    if task.integrator is None:
        return "FixedStep of order 4, 256 steps a period or more as needed"
    return repr(task.integrator) + (_MARCHED if task.march and isinstance(task.integrator, CVODES) else "")
