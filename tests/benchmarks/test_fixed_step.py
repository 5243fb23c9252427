"""Speed of fixed steps of the 14-state gear, as ratios to things run beside it in the same minute.

``pytest tests/benchmarks --benchmark-enable -n 0 -s`` times and prints; in the ordinary test run it runs once, untimed.
The rival is a Runge-Kutta method written by hand for these equations and compiled by numba (needed here alone).
"""

from concurrent.futures import ThreadPoolExecutor
from time import perf_counter, thread_time

import numpy as np
import pytest
from reference_systems import GEAR, gear
from scipy.integrate import solve_ivp

from continuation.model import machine_code
from continuation.timedomain.exact import ExactIntegrator
from continuation.timedomain.fixed_step import FixedStep

STEPS = 256
STATE = np.array([1.3, *(-0.04 * s for s in GEAR.directions), *[0.0] * 7])
OMEGA = 0.62  # loses contact once in every period


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


def by_hand():
    """Return ``march(x, periods, steps, omega)``: the equations of the gear as one would write them, over corners."""
    numba = pytest.importorskip("numba")
    s, m = np.array(GEAR.directions), np.array(GEAR.mass_ratios)
    k, c = np.array(GEAR.bearing_stiffness), np.array(GEAR.bearing_damping)
    a3, xi, torque = GEAR.tangential_cosine, GEAR.mesh_damping_ratio, GEAR.torque
    (c1, c2), load = GEAR.stiffness_cosine, GEAR.tangential_cosine * GEAR.torque
    assert gear().defaults["torque"] == torque

    @numba.njit
    def rate(theta, z, out):
        lam = z[0]
        f = lam - 1.0 if lam > 1.0 else (lam + 1.0 if lam < -1.0 else 0.0)
        force = (1 + c1 * np.cos(theta) + c2 * np.cos(2 * theta)) * f + 2 * xi * z[7]
        total = load - a3 * a3 * force
        for i in range(6):
            acceleration = -m[i] * s[i] * force - 2 * c[i] * z[8 + i] - k[i] * z[1 + i]
            total += s[i] * acceleration
            out[1 + i] = z[8 + i]
            out[8 + i] = acceleration
        out[0] = z[7]
        out[7] = total

    @numba.njit
    def march(x, periods, steps, omega):
        z = x.copy()
        k1, k2, k3, k4 = np.empty(14), np.empty(14), np.empty(14), np.empty(14)
        y = np.empty(14)
        h, d = 2 * np.pi / omega / steps, 2 * np.pi / steps
        for _ in range(periods):
            for j in range(steps):
                theta = j * d
                rate(theta, z, k1)
                for i in range(14):
                    y[i] = z[i] + h / 2 * k1[i]
                rate(theta + d / 2, y, k2)
                for i in range(14):
                    y[i] = z[i] + h / 2 * k2[i]
                rate(theta + d / 2, y, k3)
                for i in range(14):
                    y[i] = z[i] + h * k3[i]
                rate(theta + d, y, k4)
                for i in range(14):
                    z[i] += h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i])
        return z

    return march


def settled(integrator, system):
    return integrator.run(STATE, parameters(system), 300).end


def needs_compiler():
    if machine_code.find_compiler() is None:
        pytest.skip("no C compiler here")


def test_step_against_numba(benchmark):
    needs_compiler()
    system, march = gear(), by_hand()
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
    needs_compiler()
    system = gear()
    fast = FixedStep(STEPS).compile(system)
    monkeypatch.setattr(machine_code, "find_compiler", lambda: None)
    slow = FixedStep(STEPS).compile(system)
    p, x = parameters(system), settled(fast, system)
    np.testing.assert_allclose(slow.run(x, p, 3).end, fast.run(x, p, 3).end, rtol=0, atol=1e-12)
    for name, q in (("two contact changes a period", p), ("none", parameters(system, 2.0))):
        y = fast.run(x, q, 300).end
        quick, plain = best(benchmark, *(lambda f=f, y=y, q=q: f.run(y, q, 40) for f in (fast, slow)), repeat=10)
        print(
            f"\n{name}: without a compiler {plain / quick:.1f} times as long, {plain / 40 / STEPS * 1e6:.2f} us a step"
        )
    benchmark(slow.run, x, p, 4)


def test_against_scipy_at_equal_accuracy(benchmark):
    needs_compiler()
    system = gear()
    p = parameters(system)
    x = settled(FixedStep(STEPS).compile(system), system)
    exact = ExactIntegrator(system, rtol=1e-12, atol=1e-13).integrate(x, p, 4).end
    rate, omega = by_hand_rate(), OMEGA

    def scipy():
        return solve_ivp(rate, (0, 8 * np.pi / omega), x, method="DOP853", rtol=1e-8, atol=1e-8).y[:, -1]

    error = abs(scipy() - exact).max()
    integrators = [FixedStep(steps).compile(system) for steps in (64, 96, 128, 192, 256, 384, 512, 1024)]
    ours = next(f for f in integrators if abs(f.run(x, p, 4).end - exact).max() < error)
    mine, theirs = best(benchmark, lambda: ours.run(x, p, 4), scipy, repeat=5)
    steps = ours.settings.steps_per_period
    print(f"\nerror {error:.1e}: {steps} steps; solve_ivp takes {theirs / mine:.0f} times as long")
    benchmark(ours.run, x, p, 4)


def by_hand_rate():
    """Return the right-hand side in NumPy, as one would write it for ``solve_ivp``."""
    s, m = np.array(GEAR.directions), np.array(GEAR.mass_ratios)
    k, c, a3 = np.array(GEAR.bearing_stiffness), np.array(GEAR.bearing_damping), GEAR.tangential_cosine

    def rate(t, z):
        theta, lam = OMEGA * t, z[0]
        f = lam - 1 if lam > 1 else (lam + 1 if lam < -1 else 0.0)
        force = (1 + 0.3 * np.cos(theta) + 0.1 * np.cos(2 * theta)) * f + 2 * GEAR.mesh_damping_ratio * z[7]
        acceleration = -m * s * force - 2 * c * z[8:] - k * z[1:7]
        total = a3 * GEAR.torque - a3 * a3 * force + s @ acceleration
        return np.concatenate([z[7:8], z[8:], [total], acceleration])

    return rate


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
