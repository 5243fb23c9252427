"""CVODES through CasADi and event-exact integration against scikit-sundae's CVODE, for one trajectory and one error.

``pytest tests/benchmarks --benchmark-enable -n 0 -s`` times and prints. The rival calls a right-hand side written by
hand and compiled by numba; the extra ``benchmark`` installs both.
"""

from time import thread_time

import numpy as np
import pytest
from gear_by_hand import OMEGA, STATE, compiled_in_time
from reference_systems import gear

from continuation import CVODES, FixedStep
from continuation.timedomain.exact import ExactIntegrator

PERIODS = 4  # of a response that loses contact once in each
TOLERANCES = (1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12)
ERRORS = (1e-6, 1e-8)


def timed(benchmark, job):
    """Return the least processor time, and the result."""
    times = []
    for _ in range(10 if benchmark.enabled else 1):
        begin = thread_time()
        result = job()
        times.append(thread_time() - begin)
    return min(times), result


def cheapest(benchmark, jobs, exact):
    """Return for every wanted error the least time of a tolerance that reaches it; infinite where none does."""
    runs = [timed(benchmark, job) for job in jobs]
    return [min((t for t, end in runs if abs(end - exact).max() < e), default=np.inf) for e in ERRORS]


def by_cvodes(system, x, p, tolerance):
    integrator = CVODES(rtol=tolerance, atol=tolerance).compile(system)

    def run():
        y = x
        for _ in range(PERIODS):
            y = integrator.period(y, p)[-1]
        return y

    return run


def by_events(system, x, p, tolerance):
    integrator = ExactIntegrator(system, rtol=tolerance, atol=tolerance)
    return lambda: integrator.integrate(x, p, PERIODS).end


def by_sundae(rate, x, tolerance, method):
    cvode = pytest.importorskip("sksundae", reason="not installed: pip install '.[benchmark]'").cvode
    solver = cvode.CVODE(rate, method=method, rtol=tolerance, atol=tolerance)
    return lambda: solver.solve(np.array([0.0, 2 * np.pi * PERIODS / OMEGA]), x).y[-1]


def test_against_scikit_sundae(benchmark):
    rate, system = compiled_in_time(), gear()
    p = system.parameter_vector({"frequency_ratio": OMEGA})
    x = FixedStep(256).compile(system).run(STATE, p, 300).end
    exact = ExactIntegrator(system, rtol=1e-13, atol=1e-14).integrate(x, p, PERIODS).end
    tolerances = TOLERANCES if benchmark.enabled else TOLERANCES[-1:]
    rivals = [by_sundae(rate, x, t, method) for t in tolerances for method in ("Adams", "BDF")]
    theirs = cheapest(benchmark, rivals, exact)
    for name, build in (("CVODES", by_cvodes), ("event-exact", by_events)):
        ours = cheapest(benchmark, [build(system, x, p, t) for t in tolerances], exact)
        for error, mine, other in zip(ERRORS, ours, theirs, strict=True):
            print(
                f"\nerror {error:g}: {name} {mine / PERIODS * 1e3:.2f} ms a period, {mine / other:.2f} of scikit-sundae"
            )
    benchmark(by_events(system, x, p, 1e-10))
