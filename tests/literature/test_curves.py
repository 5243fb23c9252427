"""Curves in two parameters: against characteristic values, closed forms, and independently located points."""

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs
from scipy.special import mathieu_a, mathieu_b

from continuation import Collocation, Curve, HarmonicBalance, Shooting, System, UnsupportedModel, trace, track


def follow(system, parameter, span, method=None, **options):
    problem = (method or HarmonicBalance()).discretise(system, parameter)
    return trace(problem, problem.guess(**{parameter: span[0]}), span, **options)


def points(branch, kind):
    return [q for q in branch.special_points if q.kind == kind]


def kinds(curve: Curve):
    return [point.kind for point in curve.points]


def mathieu() -> System:
    """y'' + (a - 2 q cos 2t) y = 0 with theta = 2 t; q is a parameter here."""
    y, v, theta, omega, a, q = rs.symbols("y", "v", "theta", "omega", "a", "q")
    return System(
        name="mathieu",
        states={"y": y, "v": v},
        derivatives={"y": v, "v": -(a - 2 * q * ca.cos(theta)) * y},
        phase=theta,
        frequency="omega",
        parameters={"a": (a, 1.0), "omega": (omega, 2.0), "q": (q, 1.0)},
    )


@pytest.fixture(scope="module")
def duffing():
    return follow(rs.duffing(), "omega", (0.9, 1.4))


@pytest.fixture(scope="module")
def duffing_fold(duffing):
    return track(points(duffing, "fold")[0], parameters=("omega", "g"), span={"g": (0.03, 0.3)})


@pytest.fixture(scope="module")
def absorber():
    return follow(rs.absorber(), "omega", (1.05, 1.3))


def test_doubling_curves_of_mathieu_are_characteristic_values():
    """b1(q) and a1(q) along whole curves, and REFERENCE values at q = 1 and 5."""
    branch = follow(mathieu(), "a", (3.0, -0.3))
    found = sorted(points(branch, "period-doubling"), key=lambda p: p.parameter)
    for point, value, number in zip(found, (mathieu_b, mathieu_a), (1, 2), strict=True):
        curve = track(point, parameters=("a", "q"), span={"q": (0.5, 5.0)}, max_step=0.4)
        a, q = curve.values.T
        assert sorted(q[[0, -1]]) == [0.5, 5.0]
        assert np.abs(a - value(1, q)).max() < 1e-9
        at_five = a[np.argmin(np.abs(q - 5.0))]
        assert at_five == pytest.approx(rs.MATHIEU_EDGES[5.0][number], abs=1.1e-9)
        assert not [p for p in curve.points if p.kind != "extremum"]
        assert any("no damping" in note for note in curve.notes)


def test_cusp_of_duffing(duffing_fold):
    """Both folds end in the cusp: a hair above it a branch has two, a hair below none."""
    cusp = next(p for p in duffing_fold.points if p.kind == "cusp")
    omega, g = cusp.parameters
    assert max(cusp.error) < 1e-9
    for factor, count in ((1.003, 2), (0.997, 0)):
        system = rs.duffing().with_parameters(g=g * factor)
        branch = follow(system, "omega", (omega - 0.03, omega + 0.03), max_step=4e-3)
        folds = points(branch, "fold")
        assert len(folds) == count
        assert all(abs(f.parameter - omega) < 0.02 for f in folds)


def test_both_folds_of_duffing_are_one_curve(duffing, duffing_fold):
    """Through the cusp the curve comes back on the other fold; the direction does not matter."""
    lower = points(duffing, "fold")[1]
    assert duffing_fold.values[0, 1] == duffing_fold.values[-1, 1] == 0.3
    other = track(lower, parameters=("g", "omega"), span={"g": (0.3, 0.03)})
    assert other.parameters == ("omega", "g")
    ends = sorted(duffing_fold.values[[0, -1], 0])
    assert sorted(other.values[[0, -1], 0]) == pytest.approx(ends, abs=1e-9)
    mine, its = (next(p for p in c.points if p.kind == "cusp") for c in (duffing_fold, other))
    assert mine.parameters == pytest.approx(its.parameters, abs=1e-9)


def test_a_curve_passes_through_folds_of_other_branches(duffing_fold):
    for i in (3, len(duffing_fold) // 3):
        omega, g = duffing_fold.values[i]
        branch = follow(rs.duffing().with_parameters(g=float(g)), "omega", (0.9, 1.6))
        assert min(abs(f.parameter - omega) for f in points(branch, "fold")) < 1e-9


@pytest.mark.parametrize("method", [Collocation(), Shooting()])
def test_methods_agree_on_a_curve(method):
    """Doublings of the double well by each method against harmonic balance, damping as second parameter."""
    curves = []
    for m in (HarmonicBalance(), method):
        point = points(follow(rs.double_well(), "g", (0.264, 0.267), m), "period-doubling")[0]
        curves.append(track(point, parameters=("g", "omega"), span={"omega": (1.19, 1.21)}, max_step=4e-3))
    reference, other = (c.values[np.argsort(c.values[:, 1])] for c in curves)
    for g, omega in other[[0, -1]]:
        assert g == pytest.approx(reference[np.argmin(np.abs(reference[:, 1] - omega)), 0], abs=2e-8)
    assert np.all(curves[1].error < 1e-7)


def test_backlash_folds_over_a_parameter_pass_through_located_ones():
    """With contact to 1e-8: the curve of the parametric oscillator over its stiffness variation."""
    x, v, theta, omega, kappa = rs.symbols("x", "v", "theta", "omega", "kappa")
    mesh = rs.dead_zone(x)
    system = System(
        name="parametric backlash",
        states={"x": x, "v": v},
        derivatives={"x": v, "v": 0.5 - 0.1 * v - (1 + kappa * ca.cos(theta)) * mesh.force},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 1.5), "kappa": (kappa, 0.3)},
        contacts=[mesh],
    )
    branch = follow(system, "omega", (0.95, 0.69))
    upper = max(points(branch, "fold"), key=lambda f: f.parameter)
    assert upper.parameter == pytest.approx(0.8445641420, abs=1e-8)
    curve = track(upper, parameters=("omega", "kappa"), span={"kappa": (0.275, 0.305)}, max_step=5e-3)
    assert np.all(curve.error < 1e-8)
    omega_at, kappa_at = curve.values[np.argmin(np.abs(curve.values[:, 1] - 0.28))]
    alone = follow(system.with_parameters(kappa=float(kappa_at)), "omega", (0.95, 0.69))
    assert min(abs(f.parameter - omega_at) for f in points(alone, "fold")) < 1e-8


def test_gear_curves_pass_through_located_points():
    """A doubling at which teeth separate, and a torus point, over the mesh damping."""
    for kind, span, low in (("period-doubling", (0.6, 0.58), 0.018), ("neimark-sacker", (2.35, 2.25), 0.018)):
        point = points(follow(rs.gear(), "frequency_ratio", span), kind)[0]
        curve = track(
            point,
            parameters=("frequency_ratio", "mesh_damping_ratio"),
            span={"mesh_damping_ratio": (low, 0.022)},
            max_step=5e-4,
        )
        ratio, damping = curve.values[0]
        assert damping in (low, 0.022)
        alone = follow(rs.gear().with_parameters(mesh_damping_ratio=float(damping)), "frequency_ratio", span)
        assert min(abs(q.parameter - ratio) for q in points(alone, kind)) < 1e-8


def test_a_torus_curve_ends_in_the_resonance_on_the_fold_curve(absorber):
    """1:1: the torus curve and the fold curve meet there, found on each by a test of its own."""
    torus, fold = points(absorber, "neimark-sacker")[0], points(absorber, "fold")[0]
    first = track(torus, parameters=("omega", "g"), span={"g": (0.05, 0.16)}, max_step=6e-3)
    second = track(fold, parameters=("omega", "g"), span={"g": (0.09, 0.16), "omega": (1.0, 1.4)}, max_step=4e-3)
    one, other = (next(p for p in c.points if p.kind == "1:1") for c in (first, second))
    assert one.parameters == pytest.approx(other.parameters, abs=1e-8)
    assert max(*one.error, *other.error) < 1e-8
    assert "1:1" in first.stop
    assert 0 < first.rotation_number.min() < first.rotation_number.max() < 0.1


def test_an_extremum_is_where_two_torus_points_meet(absorber):
    """Below it the branch has none, above it two, their distance falling as a square root."""
    torus = points(absorber, "neimark-sacker")[0]
    curve = track(torus, parameters=("omega", "g"), span={"g": (0.05, 0.13)})
    (tip,) = (p for p in curve.points if p.kind == "extremum")
    omega, g = tip.parameters
    distances = []
    for dg in (-1e-4, 1e-4, 4e-4):
        system = rs.absorber().with_parameters(g=g + dg)
        found = points(follow(system, "omega", (omega - 0.03, omega + 0.03)), "neimark-sacker")
        distances.append(abs(found[1].parameter - found[0].parameter) if len(found) == 2 else len(found))
    assert distances[0] == 0
    assert distances[2] / distances[1] == pytest.approx(2.0, rel=0.02)


def test_generalised_doubling_of_the_gear():
    """The direction of the doubling at 0.5226 turns there, and is the one that is said on either side."""
    point = points(
        follow(rs.gear().with_parameters(mesh_damping_ratio=0.0345), "frequency_ratio", (0.54, 0.5)), "period-doubling"
    )[0]
    assert point.criticality == "subcritical"
    names = "frequency_ratio", "mesh_damping_ratio"
    curve = track(point, parameters=names, span={names[1]: (0.034, 0.037)}, step=1e-3, max_step=1e-3)
    (turn,) = (p for p in curve.points if p.kind == "generalised-doubling")
    assert max(turn.error) < 1e-7
    damping = turn.parameters[1]
    for factor, direction in ((0.98, "subcritical"), (1.02, "supercritical")):
        system = rs.gear().with_parameters(mesh_damping_ratio=damping * factor)
        near = points(follow(system, "frequency_ratio", (0.54, 0.5)), "period-doubling")
        assert [q.criticality for q in near] == [direction]


def test_any_two_parameters():
    """The fold is followed in two parameters neither of which it was located in."""
    x, v, theta, omega, g, d = rs.symbols("x", "v", "theta", "omega", "g", "d")
    system = System(name="duffing", states={"x": x, "v": v}, phase=theta, frequency="omega",
                    derivatives={"x": v, "v": -d * v - x - 0.1 * x**3 + g * ca.cos(theta)},
                    parameters={"omega": (omega, 1.0), "g": (g, 0.18), "d": (d, 0.05)})  # fmt: skip
    fold = points(follow(system, "omega", (0.9, 1.4)), "fold")[0]
    curve = track(fold, parameters=("g", "d"), span={"d": (0.045, 0.055)})
    assert curve.parameters == ("g", "d")
    g_at, d_at = curve.values[0]
    alone = follow(system.with_parameters(g=float(g_at), d=float(d_at)), "omega", (0.9, 1.4))
    assert min(abs(f.parameter - fold.parameter) for f in points(alone, "fold")) < 1e-9


def test_a_doubling_of_an_autonomous_system():
    """By harmonic balance, against one located at another value of the second parameter."""
    x, y, z, alpha, b = rs.symbols("x", "y", "z", "alpha", "b")
    system = System(
        name="third-order",
        states={"x": x, "y": y, "z": z},
        derivatives={"x": y, "y": z, "z": -alpha * z - b * y - x + x**2},
        parameters={"alpha": (alpha, 0.9), "b": (b, 1.0)},
    )
    doubling = points(follow(system, "alpha", (0.8, 0.6)), "period-doubling")[0]
    curve = track(doubling, parameters=("alpha", "b"), span={"b": (0.99, 1.01)})
    a_at, b_at = curve.values[-1]
    alone = points(follow(system.with_parameters(b=float(b_at)), "alpha", (0.8, 0.55)), "period-doubling")
    assert min(abs(q.parameter - a_at) for q in alone) < 1e-8


def test_a_fold_of_cycles_by_collocation():
    """Inhibition by the substrate as second parameter; harmonic balance says what to use instead."""
    s, a, rho, k = rs.symbols("S", "A", "rho", "k")
    rate = rho * s * a / (1 + s + k * s**2)
    system = System(name="enzyme", states={"S": s, "A": a}, parameters={"rho": (rho, 4.0), "k": (k, 0.1)},
                    derivatives={"S": 110 - s - rate, "A": 0.2 * (500 - a) - rate})  # fmt: skip
    fold = points(follow(system, "rho", (4.9, 5.01), Collocation()), "fold")[0]
    assert fold.parameter == pytest.approx(5.00784, rel=2e-6)
    curve = track(fold, parameters=("rho", "k"), span={"k": (0.0998, 0.1002)}, max_step=4e-4)
    value, at = curve.values[0]
    alone = points(follow(system.with_parameters(k=float(at)), "rho", (4.9, 5.02), Collocation()), "fold")
    assert min(abs(f.parameter - value) for f in alone) < 1e-7
    problem = HarmonicBalance().discretise(system, "rho")
    U = problem.unknown(fold.orbit)
    with pytest.raises(UnsupportedModel, match="use Collocation or Shooting"):
        problem.critical_operator(U, fold.parameter, 0.0)


def combination() -> System:
    """Two linear oscillators coupled by cos(theta): multipliers meet on the unit circle near omega = 1 + k."""
    x, v, y, w, theta, omega, k = rs.symbols("x", "v", "y", "w", "theta", "omega", "k")
    pull = 0.6 * ca.cos(theta)
    return System(
        name="combination",
        states={"x": x, "v": v, "y": y, "w": w},
        derivatives={"x": v, "v": -0.05 * v - x - pull * y, "y": w, "w": -0.05 * w - k**2 * y - pull * x},
        phase=theta,
        frequency="omega",
        parameters={"omega": (omega, 3.0), "k": (k, 2.2)},
    )


def test_strong_resonances_of_a_torus_curve():
    """The rotation number is about 1/(1 + k): 1:3 near k = 2 and 1:4 near k = 3, where M has the multipliers said."""
    branch = follow(combination(), "omega", (4.0, 2.6))
    torus = points(branch, "neimark-sacker")[0]
    curve = track(torus, parameters=("omega", "k"), span={"k": (1.8, 3.3)})
    found = {p.kind: p for p in curve.points}
    assert {"1:3", "1:4"} <= set(found)
    for name, n in (("1:3", 3), ("1:4", 4)):
        omega, k = found[name].parameters
        assert k == pytest.approx(n - 1, abs=0.2)  # of first order in the gain
        M = rs.ExactFlow(combination(), omega=omega, k=k)(np.zeros(4))[1]
        assert np.abs(np.linalg.eigvals(M) - np.exp(2j * np.pi / n)).min() < 1e-8


def test_a_torus_curve_ends_in_the_1_2_resonance():
    """Towards k = 1 the rotation number 1/(1 + k) tends to 1/2; at the end two multipliers are -1."""
    branch = follow(combination().with_parameters(k=1.25), "omega", (2.7, 1.9))
    torus = points(branch, "neimark-sacker")[0]
    curve = track(torus, parameters=("omega", "k"), span={"k": (0.9, 1.3)})
    (end,) = (p for p in curve.points if p.kind == "1:2")
    assert "1:2" in curve.stop
    omega, k = end.parameters
    mu = np.linalg.eigvals(rs.ExactFlow(combination(), omega=omega, k=k)(np.zeros(4))[1])
    assert np.sort(np.abs(mu + 1))[1] < 1e-3  # a double one: the root of the error of a parameter


def test_fold_flip_where_a_second_oscillator_loses_its_stiffness():
    """A Mathieu doubling beside an oscillator of stiffness 2 - q: multipliers -1 and 1 at q = 2."""
    y, v, z, w, theta, omega, a, q = rs.symbols("y", "v", "z", "w", "theta", "omega", "a", "q")
    system = System(
        name="mathieu and another",
        states={"y": y, "v": v, "z": z, "w": w},
        derivatives={
            "y": v,
            "v": -(a - 2 * q * ca.cos(theta)) * y - 0.1 * v,
            "z": w,
            "w": (q - 2) * z - z**3 - 0.3 * w,
        },
        phase=theta,
        frequency="omega",
        parameters={"a": (a, 1.0), "omega": (omega, 2.0), "q": (q, 1.5)},
    )
    point = points(follow(system, "a", (2.6, 2.0)), "period-doubling")[0]
    curve = track(point, parameters=("a", "q"), span={"q": (1.5, 2.5)}, max_step=0.1)
    (found,) = (p for p in curve.points if p.kind == "fold-flip")
    assert found.parameters[1] == pytest.approx(2.0, abs=1e-9)
    mu = np.linalg.eigvals(rs.ExactFlow(system, a=found.parameters[0], q=found.parameters[1])(np.zeros(4))[1])
    assert max(np.abs(mu - 1).min(), np.abs(mu + 1).min()) < 1e-8
