"""Fourier coefficients of tabulated values over whole mesh cycles, equation (17), and the checks they rest on."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sbg_casadi.errors import PairError
from sbg_casadi.mesh import fourier_series
from sbg_casadi.tables import MeasuredTable

PERIODIC = 0.02
"""Share of a column's peak-to-peak by which one mesh cycle may differ from the next."""

_SPARSE = 0.05  # least over largest singular value of the weighted fit (0.7 for even samples)


@dataclass(frozen=True, slots=True)
class FourierSeries:
    """Hold a truncated Fourier series and how far it is from the values it was made of.

    Attributes
    ----------
    mean : float
        Constant term, in the unit of the values.
    cosine, sine : tuple of float, equal lengths
        Coefficients of the harmonics 1 to N, in the unit of the values.
    deviation : float
        Largest distance of a sample from the series, in the unit of the values: the truncation error.
    """

    mean: float
    cosine: tuple[float, ...]
    sine: tuple[float, ...]
    deviation: float

    def __call__(self, phase: np.ndarray) -> np.ndarray:
        """Evaluate the series at mesh phases in cycles."""
        return self.mean + fourier_series(self.cosine, self.sine, 2 * math.pi * np.asarray(phase))


@dataclass(frozen=True, slots=True, eq=False)
class Sampling:
    """Say how a table samples its mesh cycles.

    Attributes
    ----------
    phase : numpy.ndarray, shape (samples,)
        In mesh cycles, increasing; a repeated end point is included.
    count : int
        Whole mesh cycles covered.
    closed : bool
        True when the last sample is the first one again, ``count`` cycles later.
    """

    phase: np.ndarray
    count: int
    closed: bool

    @property
    def distinct(self) -> int:
        """Number of samples without a repeated end point."""
        return self.phase.size - int(self.closed)


def sampling(table: MeasuredTable, teeth: tuple[int, int] | None) -> Sampling:
    """Return how a table samples its mesh cycles.

    Raises
    ------
    PairError
        If it doesn't cover whole cycles, with or without a repeated end point.
    """
    phase = table.cycles(teeth)
    steps = np.diff(phase)
    span = float(phase[-1] - phase[0])
    count = max(1, round(span))
    if abs(span - count) <= 0.05 * float(np.median(steps)):
        return Sampling(phase, count, closed=True)
    count = math.ceil(span)
    if count - span <= 2 * float(steps.max()) and count - span < 0.5:
        return Sampling(phase, count, closed=False)
    raise PairError(
        f"{table.place}, lines {table.lines[0]} to {table.lines[-1]}: covers {span:.4g} mesh cycles; expected one or "
        "more whole cycles, evenly from the first to the last sample"
    )


def check_harmonics(table: MeasuredTable, grid: Sampling, harmonics: int) -> None:
    """Raise PairError unless every mesh cycle has the 2 N + 1 samples that N harmonics need."""
    samples = grid.distinct // grid.count
    if samples < 2 * harmonics + 1:
        raise PairError(
            f"{table.place}, lines {table.lines[0]} to {table.lines[-1]}: {samples} samples in a mesh cycle are enough "
            f"for {max(0, (samples - 1) // 2)} harmonics, (N - 1)/2, and {harmonics} are asked for; expected "
            f"{2 * harmonics + 1} samples or fewer harmonics"
        )


def check_periodic(
    table: MeasuredTable, grid: Sampling, values: np.ndarray, name: str, tolerance: float = PERIODIC
) -> None:
    """Raise PairError unless each mesh cycle repeats the first within ``tolerance`` of the peak-to-peak.

    Without a repeated end point, the step from the last sample to the next cycle may be three times the largest
    step between neighbours; further cycles are compared with a cubic spline through the first.
    """
    allowed = tolerance * float(np.ptp(values)) + 1e-9 * float(np.max(np.abs(values)))
    phase = grid.phase
    within = f"{name} is not periodic within {100 * tolerance:g} % of its peak-to-peak"
    place = f"{table.place}, line"
    if grid.closed:
        if abs(values[-1] - values[0]) > allowed:
            raise PairError(f"{place} {table.lines[-1]}: {within}; expected the values of line {table.lines[0]}")
    elif abs(values[-1] - values[0]) > max(allowed, 3 * float(np.max(np.abs(np.diff(values))))):
        raise PairError(
            f"{place} {table.lines[-1]}: {within}, the step back to line {table.lines[0]} is larger than three times "
            "any other; expected values that repeat"
        )
    first = phase - phase[0] < 1 - 0.5 * float(np.min(np.diff(phase)))
    if grid.count > 1 and int(first.sum()) > 2:
        from scipy.interpolate import CubicSpline  # imported here: most pairs have no table, and it takes its time

        knots = np.append(phase[first], phase[0] + 1)
        spline = CubicSpline(knots, np.append(values[first], values[0]), bc_type="periodic")
        apart = np.abs(spline(phase) - values)
        worst = int(np.argmax(apart))
        if apart[worst] > allowed:
            raise PairError(f"{place} {table.lines[worst]}: {within}; expected the values of the first mesh cycle")


def fourier_fit(table: MeasuredTable, grid: Sampling, values: np.ndarray, harmonics: int) -> FourierSeries:
    """Return the Fourier series of sampled values.

    Even samples go through the FFT; uneven ones through least squares on the harmonics asked for, each sample
    weighted with the phase it stands for, which is the FFT again when the samples are even.

    Parameters
    ----------
    table : MeasuredTable
        Names file and lines in messages.
    grid : Sampling
    values : numpy.ndarray, shape (samples,)
    harmonics : int
        At most (samples in a cycle - 1) / 2.

    Raises
    ------
    PairError
        If uneven samples leave a gap too wide for the harmonics.
    """
    phase, data = grid.phase[: grid.distinct], values[: grid.distinct]
    gaps = np.diff(np.append(phase, phase[0] + grid.count))
    if np.max(np.abs(gaps - grid.count / grid.distinct)) <= 1e-12 * (grid.count + abs(phase[0])):
        bins = grid.count * np.arange(1, harmonics + 1)
        spectrum = np.fft.rfft(data)[np.concatenate([[0], bins])] / data.size
        amplitude = 2 * spectrum[1:] * np.exp(-2j * np.pi * np.arange(1, harmonics + 1) * phase[0])
        mean, cosine, sine = float(spectrum[0].real), amplitude.real, -amplitude.imag
    else:
        turns = 2 * np.pi * np.outer(phase, np.arange(1, harmonics + 1))
        weights = np.sqrt((gaps + np.roll(gaps, 1)) / 2)
        columns = np.hstack([np.ones((phase.size, 1)), np.cos(turns), np.sin(turns)]) * weights[:, None]
        found, _, _, singular = np.linalg.lstsq(columns, data * weights, rcond=None)
        if singular[-1] < _SPARSE * singular[0]:
            wide = int(np.argmax(gaps))
            raise PairError(
                f"{table.place}, line {table.lines[wide]}: the next sample is {gaps[wide]:.3g} mesh cycles away, too "
                f"far for {harmonics} harmonics; expected closer samples or fewer harmonics"
            )
        mean, cosine, sine = float(found[0]), found[1 : harmonics + 1], found[harmonics + 1 :]
    series = FourierSeries(mean, tuple(cosine.tolist()), tuple(sine.tolist()), 0.0)
    deviation = float(np.max(np.abs(series(phase) - data)))
    return FourierSeries(series.mean, series.cosine, series.sine, deviation)
