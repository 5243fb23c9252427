"""Speed of fixed steps of the 14-state gear, as ratios to things run beside it in the same minute.

``pytest tests/benchmarks --benchmark-enable -n 0 -s`` times and prints; in the ordinary test run it runs once, untimed.
The rival is a Runge-Kutta method written by hand for these equations and compiled by numba, which the extra
``benchmark`` installs; without it what needs it is skipped.
"""

from concurrent.futures import ThreadPoolExecutor
from time import perf_counter, thread_time

import numpy as np
import pytest
from gear_by_hand import OMEGA, STATE, compiled_march, numpy_rate
from reference_systems import gear
from scipy.integrate import solve_ivp

from continuation.model import machine_code
from continuation.timedomain.exact import ExactIntegrator
from continuation.timedomain.fixed_step import FixedStep

STEPS = 256


def parameters(system, omega=OMEGA):
    return system.parameter_vector({"frequency_ratio": omega})


def best(benchmark, *jobs, repeat=30, clock=thread_time):
    """Return the least processor time of every job, run in turn so that all see the same machine."""
    repeat = repeat if benchmark.enabled else 1
    times = np.full(len(jobs), np.inf)
    for _ in range(repeat):
        for i, job in enumerate(jobs):
            begin = clock()
            job()
            times[i] = min(times[i], clock() - begin)
    return times


def settled(integrator, system):
    return integrator.run(STATE, parameters(system), 300).end


def needs_compiler():
    if machine_code.find_compiler() is None:
        pytest.skip("no C compiler here")


def test_step_against_numba(benchmark):
    needs_compiler()
    system, march = gear(), compiled_march()
    over, landed = (FixedStep(STEPS, land=land).compile(system) for land in (False, True))
    p, x = parameters(system), settled(landed, system)
    np.testing.assert_allclose(over.run(x, p, 3).end, march(x, 3, STEPS, OMEGA), rtol=0, atol=1e-11)
    assert len(landed.run(x, p, 3, changes=True).changes) == 6
    times = best(benchmark, *(lambda f=f: f.run(x, p, 40) for f in (over, landed)), lambda: march(x, 40, STEPS, OMEGA))
    microseconds = times / 40 / STEPS * 1e6
    print("\nmicroseconds a step: over corners {:.3f}, landing {:.3f}, numba {:.3f}".format(*microseconds))
    print("over numba: {:.2f} and {:.2f}; landing over plain {:.2f}".format(*times[:2] / times[2], times[1] / times[0]))
    benchmark(landed.run, x, p, 40)


def test_two_threads_against_one(benchmark):
    needs_compiler()
    system = gear()
    landed = FixedStep(STEPS).compile(system)
    p, x = parameters(system), settled(landed, system)

    def run(_):
        return landed.run(x, p, 300).end

    with ThreadPoolExecutor(2) as pool:
        one, two = best(
            benchmark, lambda: [run(0), run(1)], lambda: list(pool.map(run, range(2))), repeat=20, clock=perf_counter
        )
        benchmark(lambda: list(pool.map(run, range(2))))
    print(f"\ntwo threads {one / two:.2f} times one")


def test_without_a_compiler(benchmark, monkeypatch):
    """400 periods at one frequency, as in a sweep, what is tabulated for that frequency included."""
    needs_compiler()
    system, march = gear(), compiled_march()
    fast = FixedStep(STEPS).compile(system)
    monkeypatch.setattr(machine_code, "find_compiler", lambda: None)
    slow = FixedStep(STEPS).compile(system)
    p, x = parameters(system), settled(fast, system)
    np.testing.assert_allclose(slow.run(x, p, 3).end, fast.run(x, p, 3).end, rtol=0, atol=1e-12)
    march(x, 1, STEPS, OMEGA)
    periods = 400 if benchmark.enabled else 2
    for name, omega in (("two contact changes a period", OMEGA), ("none", 2.0)):
        q, other = parameters(system, omega), parameters(system, omega + 0.01)
        y = fast.run(x, q, 300).end

        def ours(q=q, other=other, y=y):
            slow.run(y, other, 0)  # what is tabulated belongs to one frequency
            slow.run(y, q, periods)

        theirs, plain = best(benchmark, lambda y=y, w=omega: march(y, periods, STEPS, w), ours, repeat=10)
        each = plain / periods / STEPS * 1e6
        print(f"\n{name}: without a compiler {plain / theirs:.1f} times numba, {each:.2f} us a step")
    benchmark(slow.run, x, p, 4)


def test_against_scipy_at_equal_accuracy(benchmark):
    needs_compiler()
    system = gear()
    p = parameters(system)
    x = settled(FixedStep(STEPS).compile(system), system)
    exact = ExactIntegrator(system, rtol=1e-12, atol=1e-13).integrate(x, p, 4).end
    rate, omega = numpy_rate(), OMEGA

    def scipy():
        return solve_ivp(rate, (0, 8 * np.pi / omega), x, method="DOP853", rtol=1e-8, atol=1e-8).y[:, -1]

    error = abs(scipy() - exact).max()
    integrators = [FixedStep(steps).compile(system) for steps in (64, 96, 128, 192, 256, 384, 512, 1024)]
    ours = next(f for f in integrators if abs(f.run(x, p, 4).end - exact).max() < error)
    mine, theirs = best(benchmark, lambda: ours.run(x, p, 4), scipy, repeat=5)
    steps = ours.settings.steps_per_period
    print(f"\nerror {error:.1e}: {steps} steps; solve_ivp takes {theirs / mine:.0f} times as long")
    benchmark(ours.run, x, p, 4)


def test_a_paper_size_diagram_in_part(benchmark):
    """20 of 1000 frequencies, up and down on two threads, 300 + 100 periods; the whole takes 50 times as long."""
    needs_compiler()
    system = gear()
    integrator = FixedStep(STEPS).compile(system, ["lambda"])
    values = np.linspace(0.4, 2.6, 20 if benchmark.enabled else 2)

    def sweep(omegas, periods=(300, 100)):
        x = STATE
        for omega in omegas:
            p = parameters(system, omega)
            x = integrator.run(x, p, periods[0]).end
            run = integrator.run(x, p, periods[1], statistics=True)
            x = run.end
        return x

    begin = perf_counter()
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(sweep, (values, values[::-1])))
    print(f"\n1000 frequencies up and down: {1000 / len(values) * (perf_counter() - begin):.0f} s")
    benchmark(sweep, values[:1], (3, 1))
