"""Cost of a Newton step (residual and Jacobian) by closed form and by Gauss quadrature, on the same contact.

``pytest tests/benchmarks --benchmark-enable -n 0`` times; ``python tests/benchmarks/test_quadrature_cost.py`` prints
the ratio. In the ordinary test run everything here runs once, untimed.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

import general_contacts as general
import reference_systems as rs

from continuation import HarmonicBalance


def step_of(system, harmonics, value):
    """A call that linearises at an orbit of fixed harmonics."""
    problem = HarmonicBalance(harmonics=harmonics).discretise(system, system.frequency)
    u = problem.unknown(problem.guess(**{system.frequency: value}))
    return lambda: problem.linearise(u, value)


@pytest.mark.parametrize("harmonics", [31, 63])
def test_newton_step_of_the_gear_pair(benchmark, harmonics):
    F, J, _ = benchmark(step_of(rs.gear(), harmonics, 0.55))
    assert J.shape == (F.size, F.size) == (2 * harmonics + 1,) * 2


@pytest.mark.parametrize("path", ["closed form", "quadrature"])
@pytest.mark.parametrize("harmonics", [31, 127])
def test_newton_step_on_the_same_contact(benchmark, path, harmonics):
    assert benchmark(step_of(general.backlash(path == "quadrature"), harmonics, 0.9))[1].shape[0] == 2 * harmonics + 1


def _seconds(call, rounds=9, repeats=40):
    best = float("inf")
    for _ in range(rounds):
        start = time.process_time()
        for _ in range(repeats):
            call()
        best = min(best, (time.process_time() - start) / repeats)
    return best


if __name__ == "__main__":
    print(f"gear pair, H = 31: {1e3 * _seconds(step_of(rs.gear(), 31, 0.55)):.2f} ms")
    for H in (15, 31, 63, 127):
        one, other = (_seconds(step_of(general.backlash(inside), H, 0.9)) for inside in (False, True))
        print(f"H = {H}: closed form {1e3 * one:.2f} ms, quadrature {1e3 * other:.2f} ms, ratio {other / one:.1f}")
