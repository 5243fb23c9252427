"""Cost of the response of the dimensionless gear pair from 2.6 to 0.4, and of the same by shooting with SciPy.

``pytest tests/benchmarks --benchmark-enable -n 0`` times; ``python tests/benchmarks/test_response.py`` prints the
table of the README. In the ordinary test run everything here runs once, untimed.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import casadi as ca
import reference_systems as rs
from scipy.integrate import solve_ivp

from continuation import Branch, HarmonicBalance, trace

SPAN = (2.6, 0.4)
SHARE = (2.4, 1.9, 1.4, 1.1, 0.9, 0.7, 0.5)  # frequency ratios that stand for the branch


def whole_branch() -> Branch:
    """Start without a guess, trace, multipliers at every point, every special point located."""
    problem = HarmonicBalance().discretise(rs.gear(), "frequency_ratio")
    return trace(problem, problem.guess(frequency_ratio=SPAN[0]), SPAN)


def response_with_verdicts() -> Branch:
    """Do the same without special points."""
    problem = HarmonicBalance().discretise(rs.gear(), "frequency_ratio")
    return trace(problem, problem.guess(frequency_ratio=SPAN[0]), SPAN, special_points=False)


class ScipyShooting:
    """One step of a continuation by shooting: states and variational equations in one solve_ivp, then Newton.

    The right-hand side is compiled by CasADi's virtual machine as the engine's own is; corners are left to the step
    control, which is what a user of solve_ivp does first.
    """

    def __init__(self) -> None:
        system = rs.gear()
        n = self.n = len(system.state_names)
        matrix = ca.SX.sym("Z", n, n)
        f = system.closed()
        along = ca.jacobian(f, system.x) @ matrix
        ratio = system.p[system.parameter_names.index(system.frequency)]
        z = ca.vertcat(system.x, ca.vec(matrix))
        rate = ca.vertcat(f, ca.vec(along)) / ratio
        self._rate = ca.Function("rate", [system.theta, z, system.p], [rate])
        self._defaults = system.parameter_vector()
        self.solves = 0

    def period(self, x: np.ndarray, ratio: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the state after one mesh period and the monodromy matrix, to rtol 1e-8."""
        p = self._defaults.copy()
        p[0] = ratio
        self.solves += 1
        start = np.concatenate([x, np.eye(self.n).ravel()])
        sol = solve_ivp(lambda t, z: self._rate(t, z, p).full().ravel(), (0, 2 * np.pi), start, "DOP853",
                        rtol=1e-8, atol=1e-10)  # fmt: skip
        return sol.y[: self.n, -1], sol.y[self.n :, -1].reshape(self.n, self.n).T

    def correct(self, x: np.ndarray, ratio: float) -> tuple[np.ndarray, np.ndarray]:
        """Newton from a neighbouring orbit to a step below 1e-7; the monodromy matrix comes with the last one."""
        for _ in range(10):
            end, M = self.period(x, ratio)
            step = np.linalg.solve(np.eye(self.n) - M, end - x)
            x = x + step
            if np.abs(step).max() < 1e-7:
                return x, M
        raise AssertionError(f"shooting with SciPy did not converge at {ratio}")


@dataclass(frozen=True)
class Shot:
    """Seconds per point of shooting with SciPy, integrations per point, largest difference of multipliers."""

    seconds: float
    solves: float
    difference: float


def shoot_beside(branch: Branch) -> Shot:
    """Correct a few orbits from their neighbours on the branch, as a continuation step would; scaled per orbit.

    Choosing steps, rejected steps and locating special points are not counted against SciPy.
    """
    shooting, seconds, off = ScipyShooting(), 0.0, 0.0
    stable = [o for o in branch.orbits if o.stability == "stable"]
    for ratio in SHARE:
        i = int(np.argmin([abs(o.value - ratio) for o in stable]))
        orbit, neighbour = stable[i], stable[i + 1]
        began = time.perf_counter()
        _, M = shooting.correct(neighbour.evaluate(0.0)[0], orbit.value)
        seconds += time.perf_counter() - began
        off = max(off, rs.multiplier_distance(np.linalg.eigvals(M), orbit.multipliers))
    return Shot(seconds / len(SHARE), shooting.solves / len(SHARE), off)


def least_seconds(run: Callable[[], Branch]) -> tuple[float, Branch]:
    """Return the least time of five runs, and what the last one gave."""
    times = []
    for _ in range(5):
        began = time.perf_counter()
        branch = run()
        times.append(time.perf_counter() - began)
    return min(times), branch


def report() -> str:
    """Return the table of the README as Markdown; run it alone on an idle machine."""
    whole_branch()  # imports and caches
    seconds, branch = least_seconds(whole_branch)
    bare, _ = least_seconds(response_with_verdicts)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    shot, n, work = shoot_beside(branch), len(branch), branch.work
    rows = [
        ("orbits, with multipliers", f"{n}"),
        ("special points, located to 1e-8", f"{len(branch.special_points)}"),
        ("response with certified verdicts alone, start included", f"{bare:.2f} s"),
        ("whole branch with all its points, start included", f"{seconds:.2f} s"),
        ("per orbit", f"{1e3 * seconds / n:.1f} ms"),
        ("Newton steps per orbit", f"{work['newton_steps'] / n:.1f}"),
        ("factorisations per orbit", f"{work['factorisations'] / n:.1f}"),
        ("peak memory of the process", f"{memory:.0f} MB"),
        (f"shooting with SciPy's `solve_ivp`, per orbit ({len(SHARE)} orbits)", f"{1e3 * shot.seconds:.0f} ms"),
        ("its integrations per orbit", f"{shot.solves:.1f}"),
        ("ratio", f"{shot.seconds / (seconds / n):.0f}"),
    ]
    return "\n".join(["| response from 2.6 to 0.4 | |", "|---|---|", *(f"| {a} | {b} |" for a, b in rows)])


def test_whole_branch(benchmark):
    branch = benchmark.pedantic(whole_branch, rounds=3, warmup_rounds=1) if benchmark.enabled else whole_branch()
    assert sum(p.kind != "grazing" for p in branch.special_points) == 12
    benchmark.extra_info.update({k: float(v) for k, v in branch.work.items()})


def test_response_with_verdicts(benchmark):
    rounds = {"rounds": 3, "warmup_rounds": 1}
    branch = benchmark.pedantic(response_with_verdicts, **rounds) if benchmark.enabled else response_with_verdicts()
    assert all(orbit.stability != "undecided" for orbit in branch.orbits)
    benchmark.extra_info.update({k: float(v) for k, v in branch.work.items()})


def test_one_orbit_by_scipy(benchmark):
    """The same orbit and multipliers, from a neighbour 1 % away."""
    problem = HarmonicBalance().discretise(rs.gear(), "frequency_ratio")
    orbit = problem.guess(frequency_ratio=1.1)
    neighbour = problem.solve(orbit, 1.111)
    shooting = ScipyShooting()
    x, M = benchmark(shooting.correct, neighbour.evaluate(0.0)[0], 1.1)
    assert np.abs(orbit.evaluate(0.0)[0] - x).max() < 1e-5
    assert rs.multiplier_distance(np.linalg.eigvals(M), orbit.multipliers) < 1e-3


def test_one_orbit_by_harmonic_balance(benchmark):
    """Newton from the same neighbour, with certified multipliers."""
    problem = HarmonicBalance().discretise(rs.gear(), "frequency_ratio")
    neighbour = problem.guess(frequency_ratio=1.111)
    orbit = benchmark(problem.solve, neighbour, 1.1)
    assert orbit.stability == "stable"


def test_work_per_orbit():
    """Counts, not clocks: a few Newton steps a point, and no more factorisations than twice that."""
    problem = HarmonicBalance().discretise(rs.gear(), "frequency_ratio")
    branch = trace(problem, problem.guess(frequency_ratio=1.3), (1.3, 0.9))
    n = branch.work["points"]
    assert branch.work["newton_steps"] / n < 6
    assert branch.work["factorisations"] / n < 10


if __name__ == "__main__":
    print(report())
