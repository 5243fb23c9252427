"""Cost of collocation beside harmonic balance, on Duffing's oscillator and on a smooth gear pair of 14 states.

``pytest tests/benchmarks --benchmark-enable -n 0`` times; ``python tests/benchmarks/test_collocation_cost.py`` prints a
table with ratios. In the ordinary test run everything here runs once, untimed.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

import reference_systems as rs

from continuation import Collocation, HarmonicBalance, trace
from continuation.branches.newton import Metric, correct, size_of

METHODS = {"collocation": Collocation(tolerance=1e-7), "harmonic balance": HarmonicBalance(tolerance=1e-7)}
MODELS = {
    "duffing": (rs.duffing, "omega", 0.9, (0.85, 1.2)),
    "smooth gear": (lambda: rs.gear().smoothed(0.05), "frequency_ratio", 1.22, (1.2, 1.3)),
}


@dataclass(frozen=True)
class Case:
    """A problem with a corrected point (u, p) and a span to trace."""

    problem: Any
    u: np.ndarray
    p: float
    span: tuple[float, float]

    @classmethod
    def of(cls, method: str, model: str) -> Case:
        build, parameter, p, span = MODELS[model]
        problem = METHODS[method].discretise(build(), parameter)
        orbit = problem.guess(**{parameter: p})
        u = problem.unknown(orbit)
        for _ in range(5):
            u = correct(problem, (u, p), (np.zeros_like(u), 1.0), Metric(size_of(u), 1.0)).u
            u = problem.adapt(u, p)[0]
        return cls(problem, u, p, span)

    def newton_steps(self) -> int:
        """Correct the point from a neighbour 1e-3 away; return the number of Newton steps."""
        metric = Metric(size_of(self.u), 1.0)
        return correct(self.problem, (1.001 * self.u, self.p), (np.zeros_like(self.u), 1.0), metric).iterations

    def orbit(self) -> Any:
        """Correct a neighbouring orbit, with error, multipliers and their bars."""
        node = correct(
            self.problem, (1.001 * self.u, self.p), (np.zeros_like(self.u), 1.0), Metric(size_of(self.u), 1.0)
        )
        return self.problem.orbits([(node.u, node.p, self.problem.adapt(node.u, node.p)[1])])[0]

    def branch(self) -> Any:
        return trace(self.problem, self.problem.guess(**{self.problem.parameter: self.span[0]}), self.span)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("method", METHODS)
def test_newton_steps(benchmark, method, model):
    case = Case.of(method, model)
    steps = benchmark(case.newton_steps)
    benchmark.extra_info.update(unknowns=len(case.u), steps=steps)
    assert steps <= 5


@pytest.mark.parametrize("model", MODELS)
def test_orbit_with_multipliers(benchmark, model):
    """The same verdict and multipliers as harmonic balance."""
    case, other = (Case.of(method, model) for method in METHODS)
    orbit = benchmark(case.orbit)
    assert orbit.stability == other.orbit().stability
    assert rs.multiplier_distance(orbit.multipliers, other.orbit().multipliers) < 1e-5


def _best(run: Callable[[], Any], rounds: int = 5) -> float:
    run()
    times = []
    for _ in range(rounds):
        began = time.perf_counter()
        run()
        times.append(time.perf_counter() - began)
    return 1e3 * min(times)


def report() -> str:
    """Return a Markdown table of milliseconds and ratios; run it alone on an idle machine."""
    rows = ["| model | | collocation | harmonic balance | ratio |", "|---|---|---|---|---|"]
    for model in MODELS:
        cases = [Case.of(method, model) for method in METHODS]
        steps = [_best(c.newton_steps) / c.newton_steps() for c in cases]
        orbits = [_best(c.orbit) for c in cases]
        branches = []
        for c in cases:
            began = time.perf_counter()
            branches.append((c.branch(), 1e3 * (time.perf_counter() - began)))
        along = [ms / len(branch) for branch, ms in branches]
        rows.append(f"| {model} | unknowns | {len(cases[0].u)} | {len(cases[1].u)} | |")
        for name, (a, b) in {"ms per Newton step": steps, "ms per orbit": orbits, "ms per orbit traced": along}.items():
            rows.append(f"| | {name} | {a:.2f} | {b:.2f} | {a / b:.1f} |")
    return "\n".join(rows)


if __name__ == "__main__":
    print(report())
