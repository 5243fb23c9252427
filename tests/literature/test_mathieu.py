"""Stability edges of Mathieu's and Meissner's equations from the multipliers of the trivial orbit."""

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs
from scipy.optimize import brentq

from continuation import HarmonicBalance, System, trace

REST = np.zeros(1)


@pytest.mark.parametrize("q", rs.MATHIEU_EDGES)
def test_edges_from_the_trace_of_the_monodromy(q):
    """Over the period pi the trace is +2 at a0, b2, a2 and -2 at b1, a1."""
    problem = HarmonicBalance().discretise(rs.mathieu(q), "a")

    def trace_of(a):
        return np.trace(problem.monodromies([(REST, a)])[0])

    for edge, level in zip(rs.MATHIEU_EDGES[q], (2, -2, -2, 2, 2), strict=True):
        found = brentq(lambda a, level=level: trace_of(a) - level, edge - 3e-3, edge + 3e-3, xtol=1e-13)
        assert found == pytest.approx(edge, abs=1.1e-9)


@pytest.mark.parametrize(("q", "start", "span"), [(1.0, 3.0, (-1.0, 5.0)), (5.0, 1.0, (-6.5, 8.0))])
def test_edges_are_special_points_of_the_trivial_branch(q, start, span):
    problem = HarmonicBalance().discretise(rs.mathieu(q), "a")
    branch = trace(problem, problem.guess(a=start), span)
    points = sorted(branch.special_points, key=lambda p: p.parameter)
    assert [p.parameter for p in points] == pytest.approx(rs.MATHIEU_EDGES[q], abs=1.1e-9)
    kinds = ["branch-point", "period-doubling", "period-doubling", "branch-point", "branch-point"]
    assert [p.kind for p in points] == kinds
    assert "stable" not in branch.stability  # undamped: on the unit circle, or outside it


def test_no_damping_keeps_the_area():
    problem = HarmonicBalance().discretise(rs.mathieu(5.0), "a")
    for M in problem.monodromies([(REST, a) for a in np.linspace(-5, 20, 11)]):
        assert np.linalg.det(M) == pytest.approx(1.0, abs=1e-8 * max(1.0, np.abs(M).max()))


def test_meissner_edges():
    """Stiffness 1 +- 0.1, half and half: the trace of two half-periods in closed form, and in the engine.

    The engine wants a smooth phase function; a contact held shut carries the square wave as its Fourier series here.
    """

    def closed_form(omega):
        half, matrix = np.pi / omega, np.eye(2)
        for k in (1.1, 0.9):
            r = np.sqrt(k)
            turn = np.array([[np.cos(r * half), np.sin(r * half) / r], [-r * np.sin(r * half), np.cos(r * half)]])
            matrix = turn @ matrix
        return np.trace(matrix)

    edges = (
        (0.659016748, -2),
        (0.672795343, -2),
        (0.996247030, 2),
        (1.001245220, 2),
        (1.935894014, -2),
        (2.063165923, -2),
    )
    for edge, level in edges:
        assert brentq(lambda w, v=level: closed_form(w) - v, edge - 2e-3, edge + 2e-3, xtol=1e-13) == pytest.approx(
            edge, abs=1e-9
        )
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    orders = range(1, 120, 2)
    wave = sum(4 / (np.pi * j) * ca.sin(j * theta) for j in orders)
    system = System(name="meissner", states={"x": x, "v": v}, derivatives={"x": v, "v": -(1 + 0.1 * wave) * x},
                    phase=theta, frequency="omega", parameters={"omega": (omega, 1.0)})  # fmt: skip
    problem = HarmonicBalance().discretise(system, "omega")

    def engine(w):
        return np.trace(problem.monodromies([(REST, w)])[0])

    for edge, level in edges[4:]:  # series of 60 terms: the edge is off by about its square remainder
        found = brentq(lambda w, v=level: engine(w) - v, edge - 2e-3, edge + 2e-3, xtol=1e-10)
        assert found == pytest.approx(edge, abs=1e-5)
