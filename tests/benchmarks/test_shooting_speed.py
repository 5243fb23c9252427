"""Cost of an event-exact period with its matrix, and of an orbit by shooting, for the dimensionless gear pair.

``pytest tests/benchmarks --benchmark-enable -n 0`` times; ``python tests/benchmarks/test_shooting_speed.py`` prints
processor times and counts. In the ordinary test run everything here runs once, untimed.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

import reference_systems as rs

from continuation import Shooting
from continuation.model.compiled import find_compiler
from continuation.timedomain.exact import ExactIntegrator
from continuation.timedomain.variational import tangents

RATIOS = (2.4, 1.1, 0.7, 0.5)  # without contact loss but for 0.7, which meets two contact changes
KINDS = [False, pytest.param(True, marks=pytest.mark.skipif(find_compiler() is None, reason="no C compiler"))]


class Period:
    """An event-exact period of the gear pair from an initial state, with its 14 x 14 matrix."""

    def __init__(self, ratio: float, machine_code: bool) -> None:
        system = rs.gear()
        self.p = system.parameter_vector({"frequency_ratio": ratio})
        self.integrator = ExactIntegrator(system, machine_code=machine_code)
        start = np.zeros(14)
        start[0] = 1.14
        self.x = self.integrator.with_tolerance(1e-6, 1e-8).integrate(start, self.p, 200).end

    def run(self) -> np.ndarray:
        """Return the matrix."""
        run = self.integrator.integrate(self.x, self.p)
        return tangents(self.integrator, [run], self.p).whole(0)

    def counts(self) -> tuple[int, int, int]:
        """Return steps of the state, steps of the matrix, contact changes."""
        run = self.integrator.integrate(self.x, self.p)
        return len(run.modes), len(tangents(self.integrator, [run], self.p).h), len(run.changes)


def orbit_errors(problem, u: np.ndarray, p: float) -> float:
    """Return the largest error bar of an orbit made from scratch: residual, matrices, error bars, harmonics."""
    problem._paths.clear()
    problem._estimates.clear()
    return float(problem.orbits([(u, p, problem.error(u, p))])[0].multiplier_error.max())


@pytest.mark.parametrize("machine_code", KINDS)
@pytest.mark.parametrize("ratio", RATIOS)
def test_period_with_matrix(benchmark, ratio, machine_code):
    period = Period(ratio, machine_code)
    matrix = benchmark(period.run)
    assert abs(np.linalg.eigvals(matrix)).max() < 1


def test_steps_of_a_period():
    """Counts, not clocks: the matrix needs hardly more steps than the state."""
    for ratio in RATIOS:
        steps, of_matrix, changes = Period(ratio, False).counts()
        assert steps < 60
        assert of_matrix < 1.1 * steps + 2
        assert changes == (2 if ratio == 0.7 else 0)


@pytest.mark.parametrize("machine_code", KINDS)
def test_orbit_with_error_bars(benchmark, machine_code):
    problem = Shooting(machine_code=machine_code).discretise(rs.gear(), "frequency_ratio")
    u, p = problem.first_state(frequency_ratio=1.1)
    assert benchmark(orbit_errors, problem, u, p) < 1e-8


def best(work: Callable[[], object], repeats: int = 50) -> float:
    """Return the least processor time of many runs in milliseconds."""
    times = []
    for _ in range(repeats):
        began = time.process_time()
        work()
        times.append(time.process_time() - began)
    return 1e3 * min(times)


def report() -> str:
    """Return processor times as Markdown; run it alone on an idle machine."""
    lines = ["| frequency ratio | steps | changes | virtual machine | machine code |", "|---|---|---|---|---|"]
    for ratio in RATIOS:
        periods = [Period(ratio, False), Period(ratio, True)]
        steps, _, changes = periods[0].counts()
        times = [f"{best(period.run):.2f} ms" for period in periods]
        lines.append(f"| {ratio} | {steps} | {changes} | {' | '.join(times)} |")
    for name, system, value in (("gear pair", rs.gear(), 1.1), ("Duffing", rs.duffing(), 0.7)):
        times = []
        for machine_code in (False, True):
            parameter = system.parameter_names[0]
            problem = Shooting(machine_code=machine_code).discretise(system, parameter)
            u, p = problem.first_state(**{parameter: value})
            times.append(f"{best(lambda: orbit_errors(problem, u, p)):.1f} ms")  # noqa: B023
        lines.append(f"| orbit with error bars, {name} | | | {' | '.join(times)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    print(report())
