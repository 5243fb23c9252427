"""Find the attractor a period map settles on, and the number of excitation periods after which it repeats."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from continuation.errors import ContinuationError

LARGEST_PERIOD = 64
_BUNCH = 8  # periods between judgements
_FEW = 256  # periods whose samples are held at once
_WINDOW = 16  # periods per half of the record in which decay is judged
_NEAR = 3e-2  # differences over n periods, times n and over the scale, from which the map counts as near a cycle
_NOISE = 1e-9  # differences that may be step selection and rounding
_DECAYING = 0.9  # ratio of successive windows that makes it worth to sum the series
_TIGHT = 0.01  # of the tolerance: length of the last correction on a smooth map
_ROUGH = 10  # tolerances: length of the last correction where step selection at contacts makes the map rough
_DIRECT = 16  # periods up to which the derivative of the map is always worth its cost
_MEMORY = 4 * LARGEST_PERIOD  # periods looked back on
_CONTRACTING = 0.997  # multipliers from differences of CVODES runs are good to about 1e-3
_DIFFERENCE = 3e-4  # over the scale; the maps of CVODES with contact are smooth to 1e-8 or so

Advance = Callable[[np.ndarray], np.ndarray]
"""State (n,) at phase 0 to the states (samples + 1, n) of one excitation period."""

Ahead = Callable[[np.ndarray, int], np.ndarray]
"""State at phase 0 and a number of periods to the states (number, samples + 1, n) of all of them."""


@dataclass(frozen=True, slots=True)
class Settled:
    """Hold where a period map settled.

    Attributes
    ----------
    period : int
        Number of excitation periods after which the response repeats; 0 when that was not recognised.
    periods_used : int
        Excitation periods integrated, all purposes.
    waveform : ndarray (period*samples, n) or (recorded*samples, n)
        States over one period of the response, or over the last recorded excitation periods when it does not repeat.
    state : ndarray (n,)
        State at phase 0 after the last period.
    begin : ndarray (n,)
        State at phase 0 where the waveform begins.
    """

    period: int
    periods_used: int
    waveform: np.ndarray
    state: np.ndarray
    begin: np.ndarray


class Settling:
    """Iterate a period map until it repeats.

    Parameters
    ----------
    advance : callable
        Period map, a function of the state alone.
    tolerance : float
        Distance to the cycle, over the largest value of each state, at which the response counts as settled.
    floor : float
        Value in the unit of the states that is added to the scale of every state.
    transient, limit, recorded : int
        Periods before the first judgement, periods at most, periods kept when the response does not repeat.
    ahead : callable, optional
        The same map over several periods in one call.

    Notes
    -----
    Two ways lead to the verdict "repeats after n periods". Either successive differences have decayed so far that the
    rest of their geometric series is below the tolerance. Or they decay, but slowly: then the derivative of the n-fold
    map is taken by finite differences. If all its multipliers lie inside the unit circle, Newton's method sums the
    series, starting near the cycle; the result is the limit of plain iteration. A cycle with a multiplier close to the
    unit circle is left to plain iteration, so that a small period-2 split is never taken for period 1. For more than 16
    periods the derivative is only taken where it costs less than the limit.

    Attributes
    ----------
    used : int
        Periods integrated so far, all purposes.
    elapsed : int
        Periods along the response itself before those that are being integrated; says when an error came.
    """

    def __init__(
        self,
        advance: Advance,
        *,
        tolerance: float,
        floor: float,
        transient: int,
        limit: int,
        recorded: int,
        ahead: Ahead | None = None,
    ) -> None:
        self._ahead = ahead
        self.advance, self.tolerance, self.floor = advance, tolerance, floor
        self.transient, self.limit, self.recorded = max(transient, 2 * _WINDOW), limit, recorded
        self.used = self.elapsed = 0
        self._failed = dict.fromkeys(range(1, LARGEST_PERIOD + 1), np.inf)

    def run(self, x: np.ndarray) -> Settled:
        """Iterate from a state (n,) until the response repeats or the limit is reached."""
        strobe: deque[np.ndarray] = deque([x], maxlen=_MEMORY + 1)
        sizes: deque[np.ndarray] = deque(maxlen=_WINDOW)
        waves: deque[np.ndarray] = deque(maxlen=max(self.recorded, 1))
        while self.used < self.limit:
            bunch = self._periods(strobe[-1], self._bunch(self.elapsed + 1))
            waves.extend(bunch)
            strobe.extend(wave[-1] for wave in bunch)
            sizes.extend(abs(np.array(bunch[-_WINDOW:])).max(axis=1))
            self.elapsed += len(bunch)
            known = self.elapsed + 1
            if known > self.transient and (known % _BUNCH == 0 or self.used >= self.limit):
                scale = np.max(sizes, axis=0) + self.floor
                found = self._judge(np.array(strobe) / scale, strobe[-1], scale)
                if found is not None:
                    return self._record(*found)
        return Settled(0, self.used, np.vstack([w[:-1] for w in waves]), strobe[-1], waves[0][0])

    def _bunch(self, known: int) -> int:
        """Return the number of periods up to the next judgement, or up to the limit."""
        first = max(known + 1, self.transient + 1)
        wanted = -(-first // _BUNCH) * _BUNCH - known
        return min(wanted, self.limit - self.used, _FEW)

    def _periods(self, x: np.ndarray, count: int) -> list[np.ndarray]:
        self.used += count
        if self._ahead is not None:
            return [*self._ahead(x, count)]
        waves: list[np.ndarray] = []
        for _ in range(count):
            waves.append(self.advance(x))
            x = waves[-1][-1]
        return waves

    def _judge(self, strobe: np.ndarray, x: np.ndarray, scale: np.ndarray) -> tuple[int, np.ndarray] | None:
        """Return the period number and a state on the cycle, for the smallest period that fits."""
        largest = min(LARGEST_PERIOD, len(strobe) - 2 * _WINDOW)
        late = strobe[-_WINDOW:]
        last = np.lib.stride_tricks.sliding_window_view(strobe[-_WINDOW - largest : -1], _WINDOW, axis=0)
        now_all = abs(last - late.T).max(axis=(1, 2))[::-1]  # entry n - 1: largest difference over n periods
        candidates = 1 + np.flatnonzero(now_all <= _NEAR / np.arange(1, largest + 1))
        for n in candidates.tolist():
            before, now = decay(strobe, n)
            if now <= self.tolerance and _remaining(strobe, n, now, before) <= self.tolerance:
                return n, x
            decaying = now < _DECAYING * before or now < _ROUGH * self.tolerance
            affordable = n <= _DIRECT or (len(x) + 3) * n <= self.limit
            if decaying and affordable and now < self._failed[n] / 4:
                self._failed[n] = now
                return self._newton(n, x, scale)  # multiples of n decay as well and tell no more
        return None

    def _newton(self, n: int, x: np.ndarray, scale: np.ndarray) -> tuple[int, np.ndarray] | None:
        """Sum the series of differences of the n-fold map; None unless the cycle attracts and is near."""
        try:
            return self._summed(n, x, scale)
        except (ContinuationError, np.linalg.LinAlgError):  # a trial state that is lost says nothing of the response
            return None

    def _summed(self, n: int, x: np.ndarray, scale: np.ndarray) -> tuple[int, np.ndarray] | None:
        start, size, last = x, np.inf, np.inf
        derivative = self._derivative(n, x, scale)
        if _radius(derivative) >= _CONTRACTING:
            return None
        for _ in range(8):
            step = np.linalg.solve(np.eye(len(x)) - derivative, (self._fold(n, x) - x) / scale)
            last, size = size, float(abs(step).max())
            if not size < last / 2:
                break
            x = x + scale * step
            if size <= _TIGHT * self.tolerance:
                break
        if not min(size, last) <= _ROUGH * self.tolerance:
            return None
        moved = float(abs((x - start) / scale).max())
        if moved > 10 * _NEAR or (moved > 1e-3 and _radius(self._derivative(n, x, scale)) >= _CONTRACTING):
            return None
        return self._shortest(n, x, scale), x

    def _shortest(self, n: int, x: np.ndarray, scale: np.ndarray) -> int:
        """Return the smallest divisor of n after which a cycle repeats.

        A split smaller than the bound used here comes with a multiplier so close to 1 that the cycle was not accepted.
        """
        bound = _ROUGH * self.tolerance
        fits = (m for m in range(1, n) if n % m == 0 and abs((self._fold(m, x) - x) / scale).max() <= bound)
        return next(fits, n)

    def _fold(self, n: int, x: np.ndarray) -> np.ndarray:
        return self._periods(x, n)[-1][-1]

    def _derivative(self, n: int, x: np.ndarray, scale: np.ndarray) -> np.ndarray:
        """Return the derivative (n, n) of the n-fold map in scaled states, by differences."""
        base = self._fold(n, x)
        shifted = [self._fold(n, x + d) for d in np.diag(_DIFFERENCE * scale)]
        return np.column_stack([(s - base) / scale / _DIFFERENCE for s in shifted])

    def _record(self, n: int, x: np.ndarray) -> Settled:
        parts = self._periods(x, n)
        return Settled(n, self.used, np.vstack([w[:-1] for w in parts]), parts[-1][-1], x)


def decay(strobe: np.ndarray, n: int) -> tuple[float, float]:
    """Return the largest difference over n periods in the earlier and in the later half of the record.

    Parameters
    ----------
    strobe : ndarray (k, states)
        Stroboscopic states over their scale, k more than 32 + n.
    n : int
        Candidate period number.

    Examples
    --------
    >>> strobe = 0.5 ** np.arange(40.0)[:, None]
    >>> before, now = decay(strobe, 1)
    >>> round(now / before * 2**16, 6)
    1.0
    """
    recent = strobe[-2 * _WINDOW - n :]
    differences = abs(recent[n:] - recent[:-n]).max(axis=1)
    return float(differences[-2 * _WINDOW : -_WINDOW].max()), float(differences[-_WINDOW:].max())


def _remaining(strobe: np.ndarray, n: int, now: float, before: float) -> float:
    """Estimate the distance still to go, from the drift over two spans of a multiple of n periods.

    Differences at the level of rounding and step selection carry no ratio; when they do not add up to a drift either,
    they are themselves the estimate.
    """
    span = n * -(-_WINDOW // n)
    if len(strobe) <= 2 * span:
        return np.inf
    late = float(abs(strobe[-1] - strobe[-1 - span]).max())
    early = float(abs(strobe[-1 - span] - strobe[-1 - 2 * span]).max())
    if max(now, before) < _NOISE and late < 4 * max(now, before, 1e-14):
        return max(now, late)
    return np.inf if now > before or late >= early else late * late / (early - late)


def _radius(matrix: np.ndarray) -> float:
    return float(abs(np.linalg.eigvals(matrix)).max())
