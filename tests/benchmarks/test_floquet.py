"""Cost of multipliers on the 14-state gear pair: the matrix along a known orbit, the certified set, a full certificate.

``pytest tests/benchmarks --benchmark-enable -n 0`` times; ``python tests/benchmarks/test_floquet.py`` prints a table of
processor times. In the ordinary test run everything here runs once, untimed.
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

from continuation import HarmonicBalance, certify
from continuation.orbits.hill import CondensedHill
from continuation.orbits.monodromy import monodromy, transition_matrices
from continuation.orbits.products import product_eigenvalues

RATIO = 0.55  # unstable, with contact loss


def orbit_of(harmonics: int) -> tuple:
    """A problem of fixed harmonics, the unknown of its orbit at RATIO and the orbit."""
    problem = HarmonicBalance(harmonics=harmonics).discretise(rs.gear(), "frequency_ratio")
    orbit = problem.guess(frequency_ratio=RATIO)
    return problem, problem.unknown(orbit), orbit


@pytest.mark.parametrize("harmonics", [31, 63])
def test_matrix_along_a_known_orbit(benchmark, harmonics):
    problem, u, _ = orbit_of(harmonics)
    assert abs(benchmark(monodromy, problem, [(u, RATIO)]).liouville[0]) < 1e-10


@pytest.mark.parametrize("harmonics", [31, 63])
def test_certified_multiplier_set(benchmark, harmonics):
    """States, contact pattern, multipliers with error bars, contact residual and Hill's opinion of the leading one."""
    problem, u, orbit = orbit_of(harmonics)
    (found,) = benchmark(problem.orbits, [(u, RATIO, orbit.error)])
    assert found.stability == "unstable"
    assert np.isfinite(found.second_opinion[0])


def test_forty_certified_sets_at_once(benchmark):
    problem, u, orbit = orbit_of(31)
    assert len(benchmark(problem.orbits, [(u, RATIO, orbit.error)] * 40)) == 40


def test_full_certificate(benchmark):
    problem, _, orbit = orbit_of(31)
    found = benchmark.pedantic(certify, (problem, orbit), rounds=1)
    assert len(found.methods) == 4


def processor_milliseconds(call: Callable, count: int = 30) -> float:
    """The least of five means: what the call costs where nothing else runs."""
    call()
    means = []
    for _ in range(5):
        began = time.process_time()
        for _ in range(count):
            call()
        means.append((time.process_time() - began) / count)
    return 1e3 * min(means)


def report() -> str:
    """Return a Markdown table of processor times."""
    rows = []
    for harmonics in (31, 63):
        problem, u, orbit = orbit_of(harmonics)
        point = (u, RATIO, orbit.error)
        pieces = transition_matrices(problem, u, RATIO)
        hill = CondensedHill(problem, u, RATIO)
        calls: dict[str, tuple[Callable, int]] = {
            "matrix along a known orbit": (lambda p=problem, u=u: monodromy(p, [(u, RATIO)]), 30),
            "certified multiplier set": (lambda p=problem, q=point: p.orbits([q]), 30),
            "the same, 40 orbits at once, each": (lambda p=problem, q=point: p.orbits([q] * 40), 1),
            "Hill's opinion of one multiplier": (lambda h=hill, o=orbit: h.multiplier(o.multipliers[0]), 30),
            "eigenvalues from the pieces": (lambda f=pieces: product_eigenvalues(f), 5),
            "full certificate": (lambda p=problem, o=orbit: certify(p, o), 1),
        }
        for name, (call, count) in calls.items():
            share = 40 if "40" in name else 1
            rows.append(f"| {name}, H = {harmonics} | {processor_milliseconds(call, count) / share:.2f} ms |")
    return "\n".join(["| multipliers of the 14-state gear pair | processor time |", "|---|---|", *rows])


if __name__ == "__main__":
    print(report())
