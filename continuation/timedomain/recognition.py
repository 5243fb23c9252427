"""What a response is that does not repeat: quasi-periodic, chaotic, or not known, with the evidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from continuation.errors import ContinuationError
from continuation.model.system import System
from continuation.timedomain.fixed_step import FixedStep, FixedStepIntegrator, SuitableSteps
from continuation.timedomain.fixed_step_functions import mode_model
from continuation.timedomain.lyapunov import standard_error, variational_model
from continuation.timedomain.settling import LARGEST_PERIOD

QUASI_PERIODIC, CHAOTIC, UNKNOWN = "quasi-periodic", "chaotic", "not recognised"

_ROUNDS = 3  # records, each twice as long as the one before, until one decides
_GROUP = 8  # periods over which a rate of growth of the tangent vector is taken
_CALL = 32  # periods between two normalisations of the tangent vector
_SAME_AVERAGES = 1e-3  # of the standard deviation: averages of both halves of a torus agree by far better
_NEUTRAL = 0.01  # exponent per period: growth along a torus is algebraic, log(periods)/periods
_SAME_FREQUENCY = 1e-5
_PRECISION = 1e-7  # of a frequency by the maximum of its line
_LOCKED = 10  # errors within which a frequency may be locked to a fraction n/64 or simpler


@dataclass(frozen=True, slots=True)
class Evidence:
    """Hold what tells quasi-periodic from chaotic.

    Attributes
    ----------
    verdict : str
        ``quasi-periodic``, ``chaotic`` or ``not recognised``.
    reason : str
        A sentence.
    exponent, exponent_error : float
        Largest Lyapunov exponent per unit of time and its standard error; NaN where it could not be had.
    rotation, rotation_error : float
        Frequency of the largest line among the stroboscopic points over the excitation frequency, 0 to 1/2, and the
        difference between both halves of the record. Half windings and their number can't be told from it.
    averages : float
        Largest difference between the weighted averages of both halves, over the standard deviation.
    periods : int
        Excitation periods looked at.
    """

    verdict: str
    reason: str
    exponent: float
    exponent_error: float
    rotation: float
    rotation_error: float
    averages: float
    periods: int

    @property
    def settles(self) -> bool:
        """Whether the exponent says that the response will repeat, now or after a longer transient."""
        return self.verdict == UNKNOWN and self.exponent < -3 * self.exponent_error


def no_evidence(reason: str) -> Evidence:
    """Return the verdict that nothing is known."""
    return Evidence(UNKNOWN, reason, np.nan, np.nan, np.nan, np.nan, np.nan, 0)


class Witness:
    """Look closer at responses of a driven System that were not recognised as periodic; built once per System.

    Parameters
    ----------
    system : System
    integrator : FixedStep, optional
        Of order 4 when absent, with half the steps that a sweep takes: its error is no matter here.
    periods : int
        Excitation periods of the first record, a multiple of 256; where it does not decide, a second and a third one
        of twice the length follow.

    Notes
    -----
    One march carries the state and one tangent vector with fixed steps that land on contact changes. Chaotic: the
    exponent is three standard errors above 0 and more than 0.01 per period, and averages converge slowly.
    Quasi-periodic: the exponent is 0 within the same bounds, averages of the halves of the record with smooth weights
    (Das, Saiki, Sander and Yorke, Nonlinearity 30 (2017) 4111-4140) agree to 1e-3 of the standard deviation, as they do
    on a torus and neither in chaos nor while a response settles, and the halves have the same rotation number, which is
    no fraction with a denominator up to 64; a locking with more periods is not told from a torus. All else is not
    recognised. Chaos that ends later than the periods looked
    at is called chaos. A period takes about twice as long as one of the sweep.
    """

    def __init__(self, system: System, integrator: FixedStep | None = None, periods: int = 512) -> None:
        settings = FixedStep() if integrator is None else integrator
        self._base = FixedStepIntegrator(settings, variational_model(mode_model(system, land=settings.land), 1), system)
        self._suitable = SuitableSteps(system) if integrator is None else None
        self._frequency = system.parameter_names.index(str(system.frequency))
        self._with = {settings.steps_per_period: self._base}
        self.periods = periods

    def look(self, x: np.ndarray, p: np.ndarray) -> tuple[Evidence, np.ndarray]:
        """Judge the response that continues from a state (n,) with parameters (q,); failures are a verdict, too.

        Returns
        -------
        Evidence
        end : ndarray (n,)
            Last state, from which a response that still settles may be followed on.
        """
        length, periods = 2 * np.pi / float(p[self._frequency]), self.periods
        z = np.concatenate([x, np.full(len(x), 1 / np.sqrt(len(x))), [0.0]])
        for _ in range(_ROUNDS):
            try:
                strobe, growth, z = self._march(z, p, periods)
            except ContinuationError as error:
                return no_evidence(str(error)), x
            found = judge(strobe, growth / (_GROUP * length), length)
            if found.verdict != UNKNOWN:
                break
            if found.settles:
                break
            periods *= 2
        return found, z[: len(x)]

    def _march(self, z: np.ndarray, p: np.ndarray, periods: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the stroboscopic states (periods, n), the logarithms of growth over groups of periods, and the end."""
        if self._suitable is None:
            integrator = self._base
        else:
            steps = self._suitable(p) // 2
            integrator = self._with.setdefault(steps, self._base.with_steps(steps))
        n = len(z) // 2
        points, growth = [], []
        for j in range(-periods // 8, periods, _CALL):
            run = integrator.run(z, p, _CALL)
            sizes = np.linalg.norm(run.strobe[::_GROUP, n:-1], axis=1)
            if not np.all(sizes > 0):
                raise ContinuationError("the tangent vector vanished")
            z = np.concatenate([run.end[:n], run.end[n:-1] / sizes[-1], [0.0]])
            if j >= 0:
                points.append(run.strobe[1:, :n])
                growth.append(np.diff(np.log(sizes)))
        return np.vstack(points), np.concatenate(growth), z


def judge(strobe: np.ndarray, growth: np.ndarray, length: float) -> Evidence:
    """Return the verdict on stroboscopic states (k, n) and rates of growth of a tangent vector (m,) over blocks.

    Examples
    --------
    >>> turn = 2 * np.pi * np.arange(512) * (np.sqrt(5) - 1) / 2
    >>> found = judge(np.column_stack([np.cos(turn), np.sin(turn + 0.3)]), np.zeros(64), 1.0)
    >>> found.verdict, round(found.rotation, 7)                                                  # (3 - sqrt 5)/2
    ('quasi-periodic', 0.381966)
    """
    exponent, error = float(growth.mean()), standard_error(growth)
    components = principal(strobe)
    averages = average_difference(components)
    rotation, rotation_error = rotation_number(components)
    numbers = (exponent, error, rotation, rotation_error, averages, len(strobe))
    bound = max(3 * error, _NEUTRAL / length)
    words = f"largest exponent {exponent:.3g} +- {error:.1g} per unit time over {len(strobe)} periods"
    if exponent > bound and averages > _SAME_AVERAGES:
        return Evidence(CHAOTIC, words, *numbers)
    if exponent < -bound:
        return Evidence(UNKNOWN, f"{words}: it still settles, or repeats after more than {LARGEST_PERIOD}", *numbers)
    if abs(exponent) > bound or averages > _SAME_AVERAGES:
        return Evidence(UNKNOWN, f"{words}; averages of both halves differ by {averages:.1g} deviations", *numbers)
    words += f", rotation number {rotation:.8g} +- {rotation_error:.1g}"
    gap = min(abs(rotation * m - round(rotation * m)) / m for m in range(1, LARGEST_PERIOD + 1))
    if rotation_error > _SAME_FREQUENCY or gap < _LOCKED * rotation_error:
        return Evidence(UNKNOWN, f"{words}: too uncertain, or within {_LOCKED} errors of a simple fraction", *numbers)
    return Evidence(QUASI_PERIODIC, words, *numbers)


def principal(points: np.ndarray) -> np.ndarray:
    """Return the two largest principal components of points (k, n), the columns scaled first; (k, 2), deviation 1."""
    centred = points - points.mean(axis=0)
    deviation = centred.std(axis=0)
    scaled = centred[:, deviation > 0] / deviation[deviation > 0]
    if scaled.shape[1] == 0:
        return np.zeros((len(points), 2))
    values, vectors = np.linalg.eigh(scaled.T @ scaled / len(points))
    along = scaled @ vectors[:, ::-1] / np.sqrt(np.maximum(values[::-1], 1e-15 * values[-1]))
    return np.column_stack([along, np.zeros(len(points))])[:, :2]


def _weights(count: int) -> np.ndarray:
    t = (np.arange(count) + 0.5) / count
    w = np.exp(-1 / (t * (1 - t)))
    return w / w.sum()


def average_difference(components: np.ndarray) -> float:
    """Return the largest difference between the weighted averages of the halves: components, squares, product."""
    a, b = components.T
    values = np.column_stack([a, b, a * a, b * b, a * b, a**3])
    half = len(values) // 2
    w = _weights(half)
    return float(abs(w @ values[:half] - w @ values[half : 2 * half]).max())


def rotation_number(components: np.ndarray) -> tuple[float, float]:
    """Return the frequency of the largest line of points (k, 2), per point, 0 to 1/2, and the halves' difference."""
    half = len(components) // 2
    parts = [components, components[:half], components[half : 2 * half]]
    whole, first, second = (_frequency(part[:, 0] + 1j * part[:, 1]) for part in parts)
    return whole, max(abs(first - second), _PRECISION)


def _frequency(z: np.ndarray) -> float:
    w, k = _weights(len(z)), np.arange(len(z))
    z = w * (z - w @ z)
    size = 8 * len(z)
    coarse = int(abs(np.fft.fft(z, size)).argmax()) / size
    found = minimize_scalar(
        lambda f: -abs(z @ np.exp(-2j * np.pi * f * k)),
        bounds=(coarse - 1.5 / size, coarse + 1.5 / size),
        method="bounded",
        options={"xatol": 1e-13},
    ).x
    return float(abs(found - round(found)))
