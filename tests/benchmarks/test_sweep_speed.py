"""Speed of sweeps of the 14-state gear; ``pytest tests/benchmarks --benchmark-enable -n 0 -s`` times and prints.

A whole diagram is extrapolated from a sample of its frequencies, spread over the range: the time per frequency does not
depend on their number, but that of the first ones contains building the model, which is measured apart.
"""

from time import perf_counter, process_time

import numpy as np
import pytest
from reference_systems import GEAR, gear

from continuation import CVODES, up_and_down
from continuation.model import machine_code

START = np.array([1.2, *(-0.04 * s for s in GEAR.directions), *[0.0] * 7])
SPAN = (0.4, 2.6)


def timed(values, **more):
    settings = {"quantity": "lambda", "load": "mesh_force", "start": START} | more
    begin, processor = perf_counter(), process_time()
    found = up_and_down(gear(), "frequency_ratio", values, **settings)
    return np.array([perf_counter() - begin, process_time() - processor]), found


@pytest.mark.parametrize(
    ("name", "periods"),
    [
        ("300 + 100 periods each", {"transient": 300, "limit": 400, "recorded": 100}),
        ("as many periods as needed, 400 at most", {"transient": 32, "limit": 400, "recorded": 100}),
    ],
)
def test_a_paper_size_diagram(benchmark, name, periods):
    """1000 frequencies up and down, evidence on everything that does not repeat included; 40 of them are run."""
    if machine_code.find_compiler() is None:
        pytest.skip("no C compiler here")
    count = 40 if benchmark.enabled else 2
    build, _ = timed(np.array([2.5]), **periods)
    whole, found = timed(np.linspace(*SPAN, count), **periods)
    each = (whole - build) / (count - 1)
    verdicts = sorted({v for s in found for v in s.verdicts})
    wall, processor = build + 999 * each
    print(f"\n{name}: {wall:.0f} s for 1000 frequencies up and down, {processor:.0f} s of processor time")
    print(", ".join(verdicts))
    benchmark.pedantic(timed, args=(np.array([2.5]),), kwargs=periods, rounds=1)


def test_two_cores_against_one(benchmark):
    """Meaningful on an idle machine alone."""
    values = np.linspace(0.7, 1.2, 30 if benchmark.enabled else 2)
    periods = {"transient": 300, "limit": 400, "recorded": 100}
    one = min(timed(values, workers=1, **periods)[0][0] for _ in range(3 if benchmark.enabled else 1))
    two = min(timed(values, workers=2, **periods)[0][0] for _ in range(3 if benchmark.enabled else 1))
    print(f"\ntwo threads {one / two:.2f} times one, building the model twice included")
    benchmark.pedantic(timed, args=(values[:1],), kwargs=periods, rounds=1)


def test_against_cvodes(benchmark):
    values = np.linspace(0.7, 1.2, 10 if benchmark.enabled else 1)
    ours, fixed = timed(values, workers=1)
    theirs, exact = timed(values, workers=1, integrator=CVODES())
    assert abs(fixed[0].rms - exact[0].rms).max() < 1e-6
    print(f"\nsweep with CVODES takes {theirs[1] / ours[1]:.1f} times as long as with fixed steps")
    benchmark.pedantic(timed, args=(values[:1],), rounds=1)
