"""Cost of special points and of curves of them in two parameters, on the dimensionless gear pair.

``pytest tests/benchmarks --benchmark-enable -n 0`` times; ``python tests/benchmarks/test_tracking.py`` prints where the
time goes. In the ordinary test run everything here runs once, untimed.
"""

from __future__ import annotations

import cProfile
import pstats
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import reference_systems as rs

from continuation import Branch, Curve, HarmonicBalance, SpecialPoint, trace, track

SECOND = "mesh_damping_ratio"
PARTS = {
    "orbits and multipliers": ("harmonic_balance.py", "orbits"),
    "steps along the curve": ("arclength.py", "walk"),
    "points at rising resolution": ("tracking.py", "_sharpened"),
    "codimension two": ("codimension_two.py", "find_points"),
}


def doubling(span: tuple[float, float]) -> SpecialPoint:
    """Return the first period-doubling of a piece of the branch."""
    problem = HarmonicBalance().discretise(rs.gear(), "frequency_ratio")
    branch: Branch = trace(problem, problem.guess(frequency_ratio=span[0]), span)
    return next(q for q in branch.special_points if q.kind == "period-doubling")


def curve(point: SpecialPoint, low: float, high: float, step: float) -> Curve:
    """Follow a point over the mesh damping."""
    return track(point, parameters=("frequency_ratio", SECOND), span={SECOND: (low, high)}, step=step, max_step=step)


def test_period_doubling_curve(benchmark: Any) -> None:
    """A hundred points of the doubling at 1.416."""
    point = doubling((1.45, 1.38))
    found = benchmark.pedantic(curve, args=(point, 0.015, 0.025, 1e-4), rounds=1)
    assert 50 < len(found) < 220
    assert found.error.max() < 1e-8


def test_period_doubling_curve_with_contact(benchmark: Any) -> None:
    """The doubling at 0.59, where teeth separate: 127 harmonics and twice as many for the error."""
    point = doubling((0.62, 0.56))
    found = benchmark.pedantic(curve, args=(point, 0.019, 0.021, 2e-4), rounds=1)
    assert found.error.max() < 1e-8


def test_location(benchmark: Any) -> None:
    """The doublings of a piece of the branch, each on the extended system."""
    point = doubling((1.45, 1.25))
    problem = point.problem
    branch = trace(problem, problem.solve(point.orbit, 1.42), (1.42, 1.25))
    assert branch.special_points
    benchmark.pedantic(lambda: trace(problem, branch.orbits[0], (1.42, 1.38)), rounds=1)


def report() -> str:
    """Return milliseconds per point and the shares of the parts; run it alone on an idle machine."""
    lines = []
    for name, span, values in (
        ("doubling at 1.416", (1.45, 1.38), (0.015, 0.025, 1e-4)),
        ("doubling at 0.590", (0.62, 0.56), (0.019, 0.021, 2e-5)),
    ):
        point = doubling(span)
        began = time.process_time()
        found = curve(point, *values)
        seconds = time.process_time() - began
        profile = cProfile.Profile()
        profile.runcall(curve, point, *values)
        stats: Any = pstats.Stats(profile)
        total = stats.total_tt
        lines.append(f"{name}: {len(found)} points in {seconds:.2f} s, {1e3 * seconds / len(found):.0f} ms each")
        for part, (file, function) in PARTS.items():
            share = sum(v[3] for k, v in stats.stats.items() if k[0].endswith(file) and k[2] == function) / total
            lines.append(f"  {part}: {100 * share:.0f} %")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write(report() + "\n")
