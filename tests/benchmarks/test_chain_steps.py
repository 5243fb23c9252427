"""Cost of a Newton step of harmonic balance with a chain of 1, 10, 100, 1000 and 10000 coordinates.

``pytest tests/benchmarks --benchmark-enable -n 0`` times, ``python tests/benchmarks/test_chain_steps.py``
prints the table.
Steps of all sizes are timed in turn, so that a machine whose speed varies does not favour one. In the ordinary test run
the small sizes run once, untimed.
"""

from __future__ import annotations

import resource
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg as sl

sys.path.insert(0, str(Path(__file__).parents[1]))

from chain_systems import chain, defect

from continuation import HarmonicBalance
from continuation.orbits.harmonic_balance import HarmonicBalanceProblem

DAMPING = 0.03  # modal damping ratios of 1 to 3 %
SIZES = (1, 10, 100, 1000, 10000)  # coordinates, the contact's own included


class Steps:
    """Newton steps next to an orbit, each at a frequency a little further on, as along a branch."""

    def __init__(self, n: int, harmonics: int = 31) -> None:
        began = time.perf_counter()
        system = chain(n, DAMPING)
        self.building = time.perf_counter() - began
        began = time.perf_counter()
        self.problem: HarmonicBalanceProblem = HarmonicBalance(harmonics=harmonics).discretise(system, "omega")
        self.u, self.p = np.zeros(2 * harmonics + 1), 0.7
        self.u[0], self.u[1], self.u[harmonics + 1] = 1.1, 0.2, 0.1
        self.step()  # makes the receptance
        self.setup = time.perf_counter() - began

    def step(self) -> np.ndarray:
        """One Newton step: linearise, factorise the bordered matrix, solve for step and tangent."""
        self.p += 1e-7
        F, J, Fp = self.problem.linearise(self.u, self.p)
        n = len(F)
        matrix, right = np.zeros((n + 1, n + 1), order="F"), np.zeros((n + 1, 2), order="F")
        matrix[:n, :n], matrix[:n, n], matrix[n, n] = J, Fp, 1.0
        right[:n, 0], right[n, 1] = -F, 1.0
        return np.asarray(sl.lu_solve(sl.lu_factor(matrix, overwrite_a=True), right, overwrite_b=True))


def rounds(steps: list[Steps], count: int = 40, repeats: int = 15) -> np.ndarray:
    """Return the least seconds per step of every size, timed in turn."""
    best = np.full(len(steps), np.inf)
    for _ in range(repeats):
        for i, size in enumerate(steps):
            began = time.perf_counter()
            for _ in range(count):
                size.step()
            best[i] = min(best[i], (time.perf_counter() - began) / count)
    return best


def report(harmonics: int) -> str:
    """Return the table of one number of harmonics as Markdown."""
    steps = [Steps(n, harmonics) for n in SIZES]
    seconds = rounds(steps)
    lines = [
        f"| coordinates, H = {harmonics} | building the System | set-up | nodes, stated error | Newton step | ratio |"
    ]
    lines.append("|---|---|---|---|---|---|")
    for n, size, spent in zip(SIZES, steps, seconds, strict=True):
        r = size.problem.receptance(size.p)
        fit = f"{r.nodes}, {r.error:.0e}" if r.error else "modal, exact"
        once = f"{size.building:.2f} s | {size.setup:.2f} s"
        lines.append(f"| {n} | {once} | {fit} | {1e3 * spent:.2f} ms | {spent / seconds[0]:.1f} |")
    return "\n".join(lines)


def whole() -> str:
    """Return what a first orbit of 10000 coordinates costs from nothing, and its defect in the full equations."""
    began = time.perf_counter()
    system = chain(SIZES[-1], DAMPING)
    orbit = HarmonicBalance().discretise(system, "omega").guess(omega=0.7)
    seconds = time.perf_counter() - began
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return (
        f"first orbit of {SIZES[-1]} coordinates from nothing, {orbit.harmonic_count} harmonics: {seconds:.0f} s, "
        f"defect {defect(orbit, DAMPING):.0e}; peak memory of the process {memory:.0f} MB"
    )


@pytest.mark.parametrize("n", SIZES[:4])
def test_newton_step(benchmark, n):
    if n > 100 and not benchmark.enabled:
        pytest.skip("set-up takes seconds; timed with --benchmark-enable")
    steps = Steps(n)
    benchmark.extra_info.update({"setup": steps.setup, "building": steps.building})
    benchmark(steps.step)


if __name__ == "__main__":
    print(report(31), report(63), whole(), sep="\n\n")
