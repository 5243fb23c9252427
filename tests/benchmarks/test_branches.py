"""Cost of a branch with all its points, of doubled branches and of a cascade.

``python tests/benchmarks/test_branches.py`` prints a table; under pytest-benchmark the same runs are timed.
"""

from __future__ import annotations

import cProfile
import pstats
import sys
import time
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

import reference_systems as rs

from continuation import HarmonicBalance, Shooting, cascade, switch, trace

SPAN = (2.6, 0.4)
PARTS = {
    "steps along the branch": ("arclength.py", "walk"),
    "search of critical multipliers": ("screening.py", "screen"),
    "search of grazing": ("grazing.py", "search"),
    "location": ("locate.py", "locate"),
    "location of grazing": ("grazing_system.py", "locate_touch"),
    "multipliers with error bars": ("harmonic_balance.py", "orbits"),
    "normal forms": ("normal_form.py", "describe"),
}


@pytest.fixture(scope="module")
def doublings():
    return gear_doublings()


def gear_branch():
    """Return the branch of period 1 of the gear pair."""
    problem = HarmonicBalance().discretise(rs.gear(), "frequency_ratio")
    return trace(problem, problem.guess(frequency_ratio=SPAN[0]), SPAN)


def test_branch_with_all_points_of_all_kinds(benchmark):
    branch = benchmark.pedantic(gear_branch, rounds=2, iterations=1)
    assert len(branch.special_points) == 16
    benchmark.extra_info["milliseconds per orbit"] = 1e3 * branch.work["seconds"] / len(branch)


def gear_doublings():
    """Return the four period-doublings of the gear pair."""
    branch = gear_branch()
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
    """Print seconds of wall and processor time, and where those of the branch go."""
    gear_branch()
    worked = time.process_time()
    branch = gear_branch()
    work = time.process_time() - worked
    print(f"branch of period 1: {len(branch)} orbits, {len(branch.special_points)} points, {work:.2f} s processor,")
    print(f"  {1e3 * work / len(branch):.1f} ms per orbit")
    profile = cProfile.Profile()
    profile.runcall(gear_branch)
    stats: Any = pstats.Stats(profile)
    for part, (file, function) in PARTS.items():
        share = sum(v[3] for k, v in stats.stats.items() if k[0].endswith(f"/{file}") and k[2] == function)
        print(f"  {part}: {100 * share / stats.total_tt:.0f} %")
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
