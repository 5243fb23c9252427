"""Fourier coefficients of a dead-zone force: uniform samples, Gauss points between the corners, and the closed form."""

import casadi as ca
import general_contacts as general
import numpy as np
import pytest
import reference_systems as rs
from numpy.polynomial.legendre import leggauss

from continuation import HarmonicBalance, System, trace
from continuation.model.ports import Ports
from continuation.orbits.contact_series import evaluate, find_pattern
from continuation.orbits.port_force import PortForces
from continuation.orbits.quadrature import sample

WAVE = np.array([0.4, 0.75, 0, 0.15 * np.exp(0.4j)])  # 0.4 + 1.5 cos t + 0.3 cos(3 t + 0.4)
LAW = rs.dead_zone(ca.SX.sym("x"))


def gauss(points):
    """Harmonics 0..6 by Gauss quadrature with that many points in each half of the segments between the corners."""
    s, w = leggauss(points)
    corners = find_pattern(WAVE, LAW).phases
    ends = np.append(corners, corners[0] + 2 * np.pi)
    ends = np.sort(np.append(ends, (ends[1:] + ends[:-1]) / 2))
    half = np.diff(ends) / 2
    t = (ends[:-1] + half)[:, None] + half[:, None] * s
    force = LAW.value(evaluate(WAVE, t.ravel())) * (half[:, None] * w).ravel()
    return np.exp(-1j * np.outer(np.arange(7), t)) @ force / (2 * np.pi)


def closed_form():
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    mesh = rs.dead_zone(x)
    system = System(name="mesh", states={"x": x, "v": v}, derivatives={"x": v, "v": mesh.force - x}, phase=theta,
                    frequency="omega", parameters={"omega": (omega, 1.0)}, contacts=[mesh])  # fmt: skip
    return PortForces(Ports(system), 1)(WAVE[:, None], system.parameter_vector(), 6, 0).W[:, 0]


@pytest.mark.parametrize(("count", "error"), [(64, 3.2e-4), (1024, 9.6e-7), (16384, 5.4e-9)])
def test_uniform_samples_err_by_the_square_of_their_distance(count, error):
    t = 2 * np.pi * np.arange(count) / count
    uniform = np.fft.rfft(LAW.value(evaluate(WAVE, t)))[:7] / count
    assert np.abs(uniform - closed_form())[1:].max() == pytest.approx(error, rel=0.05)


@pytest.mark.parametrize(("points", "error"), [(8, 5e-11), (10, 6e-15)])
def test_gauss_points_between_the_corners(points, error):
    assert np.abs(gauss(points) - closed_form())[:6].max() < 1.5 * error


def test_panels_are_exact_to_rounding():
    def force(t, segments, harmonics):
        return LAW.value(evaluate(WAVE, t))[:, None]

    samples, values = sample(find_pattern(WAVE, LAW).phases, 6, force)
    assert np.abs(samples.coefficients(values, 6)[:, 0] - closed_form()).max() < 1e-15
    assert len(samples.phases) < 200


def test_published_folds_with_the_contact_inside_a_product():
    """A gain that could depend on the state takes the quadrature, with the answer of the closed form."""
    problem = HarmonicBalance(harmonics=31).discretise(general.backlash(), "omega")
    assert problem.ports.general == (0,)
    branch = trace(problem, problem.guess(omega=0.65), span=(0.65, 0.85))
    folds = [p.parameter for p in branch.special_points if p.kind == "fold"]
    assert rs.near(folds, (0.70803162, 0.82846398)) < 1e-5
    problem = HarmonicBalance(harmonics=31).discretise(rs.backlash(), "omega")
    branch = trace(problem, problem.guess(omega=0.65), span=(0.65, 0.85))
    assert rs.near(folds, [p.parameter for p in branch.special_points if p.kind == "fold"]) < 1e-9
