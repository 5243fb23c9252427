"""Pairs of points of codimension two inside one step of a curve: found where they are, none where they have merged."""

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs

from continuation import HarmonicBalance, System, trace, track


def point_of(system, parameter, span, kind, **options):
    problem = HarmonicBalance().discretise(system, parameter)
    branch = trace(problem, problem.guess(**{parameter: span[0]}), span, **options)
    return next(q for q in branch.special_points if q.kind == kind)


def pick(curve, kind):
    return [q for q in curve.points if q.kind == kind]


def step_over(curve, column, low, high):
    """Tell whether two neighbouring points of the curve have all of an interval of one parameter between them."""
    values = curve.values[:, column]
    below, above = np.minimum(values[1:], values[:-1]), np.maximum(values[1:], values[:-1])
    return bool(np.any((below < low) & (above > high)))


def swallowtail(r: float) -> System:
    """x' = x^4 + r x^2 + q x + p: folds at q = -4 x^3 - 2 r x, p = 3 x^4 + r x^2; for r < 0 two cusps."""
    x, theta, omega, p, q = rs.symbols("x", "theta", "omega", "p", "q")
    return System(
        name="swallowtail",
        states={"x": x},
        derivatives={"x": x**4 + r * x**2 + q * x + p},
        phase=theta,
        frequency="omega",
        parameters={"p": (p, 0.0), "q": (q, 0.0), "omega": (omega, 1.0)},
    )


def test_two_cusps_of_a_swallowtail():
    """At x = -+ s with s^2 = -r / 6, where q = +- 8 s^3 and p = -3 s^4."""
    s = 5e-4
    curve = fold_curve(swallowtail(-6 * s**2))
    cusps = pick(curve, "cusp")
    assert sorted(c.parameters[1] for c in cusps) == pytest.approx([-8 * s**3, 8 * s**3], abs=1e-11)
    assert [c.parameters[0] for c in cusps] == pytest.approx([-3 * s**4] * 2, abs=1e-11)
    assert cusps[0].index == cusps[1].index  # within one step
    assert max(*cusps[0].error, *cusps[1].error) < 1e-10
    assert pick(curve, "extremum") == []  # q turns at the cusps, and nowhere else


def test_no_cusp_where_they_have_merged():
    curve = fold_curve(swallowtail(6 * 5e-4**2))
    assert curve.points == curve.notes == ()


def fold_curve(system):
    fold = point_of(system.with_parameters(q=-0.05), "p", (0.002, 0.01), "fold")
    return track(fold, parameters=("p", "q"), span={"q": (-0.05, 0.05)}, step=0.05, max_step=0.05)


def oscillators(gap: float) -> System:
    """Mathieu's equation, whose doubling stays where it is, with a cubic term, beside an oscillator.

    Cubic term and second stiffness are ``(q - 2)^2 - gap``: they vanish at two values of q, or at none.
    """
    y, v, z, w, theta, omega, a, q = rs.symbols("y", "v", "z", "w", "theta", "omega", "a", "q")
    level = (q - 2) ** 2 - gap
    return System(
        name="two oscillators",
        states={"y": y, "v": v, "z": z, "w": w},
        derivatives={
            "y": v,
            "v": -(a - 3 * ca.cos(theta)) * y - 0.1 * v - level * y**3,
            "z": w,
            "w": -level * z - z**3 - 0.3 * w,
        },
        phase=theta,
        frequency="omega",
        parameters={"a": (a, 1.0), "omega": (omega, 2.0), "q": (q, 1.5)},
    )


def doubling_curve(system):
    """Points lie at q = 1.5, 1.6, 1.8, 2.0 + ..., one step over the pair."""
    point = point_of(system, "a", (2.6, 2.0), "period-doubling", max_step=0.1)
    return track(point, parameters=("a", "q"), span={"q": (1.5, 2.47)}, step=0.14, max_step=0.14)


def test_pairs_on_a_doubling_curve():
    """Two generalised doublings and two fold-flips, all at q = 2 -+ d."""
    d = 1e-4
    curve = doubling_curve(oscillators(d**2))
    assert step_over(curve, 1, 2 - d, 2 + d)
    for kind in ("generalised-doubling", "fold-flip"):
        found = pick(curve, kind)
        assert [p.parameters[1] for p in found] == pytest.approx([2 - d, 2 + d], abs=1e-9)
        assert [p.parameters[0] for p in found] == pytest.approx([curve.values[0, 0]] * 2, abs=1e-9)
        assert max(e for p in found for e in p.error) < 1e-9
    assert len(curve.points) == 4


def test_none_on_a_doubling_curve_where_they_have_merged():
    curve = doubling_curve(oscillators(-1e-8))
    assert curve.points == curve.notes == ()


def wavy(e: float) -> System:
    """x' = -x^2 - q + p^3 - 3 e p: its fold q(p) has extrema at p = -+ sqrt(e), one maximum and one minimum."""
    x, theta, omega, p, q = rs.symbols("x", "theta", "omega", "p", "q")
    return System(
        name="wavy",
        states={"x": x},
        derivatives={"x": -(x**2) - q + p**3 - 3 * e * p},
        phase=theta,
        frequency="omega",
        parameters={"p": (p, 0.0), "q": (q, 0.0), "omega": (omega, 1.0)},
    )


def test_two_extrema_inside_a_step():
    e = 1e-4
    fold = point_of(wavy(e).with_parameters(q=-2.0), "p", (-1.0, -1.4), "fold", max_step=0.1)
    curve = track(fold, parameters=("p", "q"), span={"q": (-2.0, 2.0)}, step=0.4, max_step=0.4)
    found = [p.parameters for p in pick(curve, "extremum")]
    root = np.sqrt(e)
    assert step_over(curve, 0, -root, root)
    assert found == [pytest.approx((s * root, -2 * s * root**3), abs=1e-9) for s in (-1, 1)]


def combination(offset: float) -> System:
    """Two linear oscillators coupled by cos(theta), the second one of frequency 2.05 + (q - 1)^2 + offset."""
    x, v, y, w, theta, omega, q = rs.symbols("x", "v", "y", "w", "theta", "omega", "q")
    pull, k = 0.6 * ca.cos(theta), 2.05 + (q - 1) ** 2 + offset
    return System(
        name="combination",
        states={"x": x, "v": v, "y": y, "w": w},
        derivatives={"x": v, "v": -0.05 * v - x - pull * y, "y": w, "w": -0.05 * w - k**2 * y - pull * x},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 3.0), "q": (q, 0.7)},
    )


def torus_curve(offset, span):
    torus = point_of(combination(offset), "omega", (4.0, 2.6), "neimark-sacker", max_step=0.2)
    return track(torus, parameters=("omega", "q"), span={"q": span}, step=0.2, max_step=0.2)


def test_two_resonances_on_a_torus_curve():
    """1:3 at one frequency of the second oscillator, which the first curve tells: it has it twice, or not at all."""
    (there,) = pick(torus_curve(-0.3, (0.3, 0.72)), "1:3")
    wanted = (there.parameters[1] - 1) ** 2 - 0.3
    d = 1e-3
    found = pick(torus_curve(wanted - d**2, (0.7, 1.3)), "1:3")
    assert [p.parameters[1] for p in found] == pytest.approx([1 - d, 1 + d], abs=1e-7)
    assert [p.parameters[0] for p in found] == pytest.approx([there.parameters[0]] * 2, abs=1e-8)
    assert pick(torus_curve(wanted + d**2, (0.7, 1.3)), "1:3") == []
