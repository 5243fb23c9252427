"""Cost of doubled branches and of a cascade.

``python tests/benchmarks/test_branches.py`` prints a table; under pytest-benchmark the same runs are timed.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

import reference_systems as rs

from continuation import HarmonicBalance, Shooting, cascade, switch, trace

SPAN = (2.6, 0.4)


@pytest.fixture(scope="module")
def doublings():
    return gear_doublings()


def gear_doublings():
    """Return the four period-doublings of the gear pair."""
    problem = HarmonicBalance().discretise(rs.gear(), "frequency_ratio")
    branch = trace(problem, problem.guess(frequency_ratio=SPAN[0]), SPAN)
    return [q for q in branch.special_points if q.kind == "period-doubling"]


@pytest.mark.parametrize("number", range(4))
def test_doubled_branch_of_the_gear_pair(benchmark, doublings, number):
    branch = benchmark.pedantic(switch, args=(doublings[number], SPAN), rounds=2, iterations=1)
    assert "met the branch of period 1" in branch.stop
    benchmark.extra_info["orbits"] = len(branch)
    benchmark.extra_info["milliseconds per orbit"] = 1e3 * branch.work["seconds"] / len(branch)


def double_well(method):
    problem = method.discretise(rs.double_well(), "g")
    point = trace(problem, problem.guess(g=0.264), (0.264, 0.267)).special_points[0]
    return cascade(point, (0.26, 0.3), max_period=8)


@pytest.mark.parametrize("method", [HarmonicBalance(), Shooting()], ids=["harmonic balance", "shooting"])
def test_cascade_to_period_16(benchmark, method):
    found = benchmark.pedantic(double_well, args=(method,), rounds=1, iterations=1)
    assert found.periods == (1, 2, 4, 8)


def main() -> None:
    """Print seconds of wall and processor time."""
    for point in gear_doublings():
        began, worked = time.perf_counter(), time.process_time()
        branch = switch(point, SPAN)
        wall, work = time.perf_counter() - began, time.process_time() - worked
        count = max(o.harmonic_count for o in branch.orbits)
        print(
            f"doubling at {point.parameter:.6f}: {len(branch)} orbits, {wall:.2f} s ({work:.2f} s), {count} harmonics"
        )
    for method in (HarmonicBalance(), Shooting()):
        began = time.perf_counter()
        found = double_well(method)
        print(f"cascade to period 16, {type(method).__name__}: {time.perf_counter() - began:.2f} s")
        print(found)


if __name__ == "__main__":
    main()
