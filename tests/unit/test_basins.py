"""Basins of attraction against known shares, and what they must not depend on."""

import json
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np
import pytest
import xarray as xr

from continuation import FixedStep, Grid, Random, System, basins, simulate
from continuation.plotting_timedomain import plot_basins
from continuation.timedomain.recognition import CHAOTIC

SQUARE = {"x": (-2.2, 2.2), "v": (-2.2, 2.2)}


def oscillator(acceleration, **parameters):
    x, v, theta = (ca.SX.sym(k) for k in ("x", "v", "theta"))
    symbols = {k: ca.SX.sym(k) for k in parameters}
    return System(
        name="oscillator", states={"x": x, "v": v}, derivatives={"x": v, "v": acceleration(x, v, theta, **symbols)},
        phase=theta, frequency="omega", parameters={k: (symbols[k], value) for k, value in parameters.items()},
    )  # fmt: skip


def wells(force=0.2, damping=0.15):
    return oscillator(lambda x, v, t, omega, g: x - x**3 - damping * v + g * ca.cos(t), omega=1.0, g=force)


def test_two_wells_share_the_square():
    """x'' + .15x' - x + x^3 = .2cos t: half of [-2.2, 2.2]^2 goes to each of two period-1 responses."""
    found = basins(wells(), SQUARE, Grid((60, 60)))
    assert [a.verdict for a in found.attractors] == ["period-1", "period-1"]
    assert sorted(round(float(a.points[0, 0]), 3) for a in found.attractors) == [-0.779, 1.21]
    assert abs(found.fractions - 0.5).max() < 0.01
    assert abs(found.fractions - 0.5).max() < 3 * found.fraction_errors[0] < 0.03
    assert found.fractions.sum() == 1.0
    shades = plot_basins(found).get_images()[0].get_array()
    assert np.array_equal(np.asarray(shades).T.ravel() - 1, found.labels)


def test_labels_depend_on_the_state_alone():
    settings = (wells(), SQUARE, Random(150, seed=3))
    one, two = basins(*settings, workers=1), basins(*settings, workers=2)
    with ThreadPoolExecutor(3) as pool:
        three = basins(*settings, executor=pool)
    assert np.array_equal(one.points, three.points)
    for other in (two, three):
        assert np.array_equal(one.labels, other.labels)
        assert one.to_dict() == other.to_dict()
    assert not np.array_equal(one.points, basins(wells(), SQUARE, Random(150, seed=4)).points)
    assert np.all(abs(one.fractions - 0.5) < 4 * one.fraction_errors)


def test_every_label_is_where_a_long_integration_ends():
    found = basins(wells(), SQUARE, Random(30, seed=1))
    for x, label in zip(found.points, found.labels, strict=True):
        end = simulate(wells(), x, 200, integrator=FixedStep(256), phases=[0.0]).end
        assert abs(found.attractors[label].points[0] - end).max() < 1e-6


def test_states_that_leave_are_counted_apart():
    """Free oscillator with x'' = -x - x^2: what starts beyond the saddle at x = -1 escapes."""
    well = oscillator(lambda x, v, t, omega: -x - x**2 - 0.2 * v, omega=1.0)
    found = basins(well, {"x": (-3.0, 0.5)}, Grid((14,)))
    assert found.labels.tolist() == [-2] * 8 + [0] * 6
    assert found.share(-2) == pytest.approx(8 / 14)
    assert found.fraction_errors.tolist() == [pytest.approx(np.sqrt(2) / 2 / 14)]
    assert found.image().tolist() == found.labels.tolist()
    assert "lost 0.5714" in str(found)


def test_a_chaotic_attractor_is_one_attractor():
    found = basins(wells(0.3, 0.25), SQUARE, Random(52), limit=200)
    assert [a.verdict for a in found.attractors] == [CHAOTIC]
    assert found.fractions.tolist() == [1.0]
    assert found.fraction_errors[0] > 0


def test_saved_basins_can_be_read(tmp_path):
    found = basins(wells(), SQUARE, Grid((6, 5)))
    found.save(tmp_path / "basins.nc")
    with xr.open_dataset(tmp_path / "basins.nc", engine="h5netcdf") as data:
        assert np.array_equal(data.labels, found.labels)
        assert data.fraction.values.tolist() == found.fractions.tolist()
        assert json.loads(data.attrs["grid"]) == [6, 5]
    json.dumps(found.to_dict(), allow_nan=False)


@pytest.mark.parametrize(
    ("axes", "states", "message"),
    [
        ({"y": (0.0, 1.0)}, Grid((3,)), "unknown state 'y'"),
        ({"x": (1.0, 0.0)}, Grid((3,)), "must be finite and increase"),
        ({}, Grid(()), "at least one coordinate"),
        ({"x": (0.0, 1.0)}, Grid((3, 3)), "expected 1 positive counts"),
        ({"x": (0.0, 1.0)}, Random(0), "count must be positive"),
    ],
)
def test_misuse_is_refused(axes, states, message):
    with pytest.raises(ValueError, match=message):
        basins(wells(), axes, states)
