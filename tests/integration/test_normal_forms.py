"""Normal forms against the stroboscopic map, whose derivatives come from an integrator that shares no code."""

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs
from scipy.integrate import solve_ivp

from continuation import Branch, Collocation, HarmonicBalance, Shooting, switch, trace
from continuation.branches.criticality import nearest_resonance


def follow(system, parameter, span, method=None, **options):
    problem = (method or HarmonicBalance()).discretise(system, parameter)
    return trace(problem, problem.guess(**{parameter: span[0]}), span, **options)


class StroboscopicMap:
    """Derivatives of the map over one period at a fixed point, by differences of its exact Jacobian."""

    def __init__(self, system, point, step):
        flow = rs.ExactFlow(system, **{point.orbit.parameter: point.parameter})
        self.x = point.orbit.evaluate(0.0)[0]
        self.A = flow(self.x)[1]
        self._jacobian = lambda x: flow(x)[1]
        self._step, self._known = step, {}

    def second(self, a, b):
        """B(a, b) for real a."""
        h = self._step
        key = a.tobytes()
        if key not in self._known:
            M = [self._jacobian(self.x + s * h * a) for s in (1, -1, 2, -2)]
            self._known[key] = (8 * (M[0] - M[1]) - (M[2] - M[3])) / (12 * h)
        return self._known[key] @ b

    def third(self, a, b, c):
        """C(a, b, c) for real a and b."""
        h, total = self._step, 0.0
        for s, t in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            total = total + s * t * self._jacobian(self.x + h * (s * a + t * b)) @ c
        return total / (4 * h * h)

    def complex_second(self, a, b):
        """B(a, b)."""
        return self.second(a.real, b) + 1j * self.second(a.imag, b)

    def complex_third(self, a, b, c):
        """C(a, b, c)."""
        parts = [(a.real, 1), (a.imag, 1j)], [(b.real, 1), (b.imag, 1j)]
        return sum(f * g * self.third(u, v, c) for u, f in parts[0] for v, g in parts[1])

    def left(self, q, mu):
        """Left eigenvector with <p, q> = conj(p) . q = 1."""
        values, vectors = np.linalg.eig(self.A.T)
        p = vectors[:, np.argmin(np.abs(values - mu))].conj()
        return p / (p.conj() @ q).conj()

    def doubling(self, q):
        """Kuznetsov, Elements of Applied Bifurcation Theory, equation (5.45)."""
        p = self.left(q, -1.0).real
        inner = np.linalg.solve(self.A - np.eye(len(q)), self.second(q, q))
        return p @ self.third(q, q, q) / 6 - p @ self.second(q, inner) / 2

    def torus(self, q, mu):
        """The same, equation (5.53)."""
        p, one, other = self.left(q, mu), np.eye(len(q)), q.conj()
        h = np.linalg.solve(one - self.A, self.complex_second(q, other))
        k = np.linalg.solve(mu**2 * one - self.A, self.complex_second(q, q))
        total = self.complex_third(q, q, other) + 2 * self.complex_second(q, h) + self.complex_second(other, k)
        return ((p.conj() @ total) / (2 * mu)).real


def points(branch: Branch, kind):
    return [q for q in branch.special_points if q.kind == kind]


@pytest.fixture(scope="module")
def torus():
    return points(follow(rs.absorber(), "omega", (1.1, 1.2)), "neimark-sacker")


@pytest.fixture(scope="module")
def gear():
    """The two doublings of the gear example at which teeth separate."""
    return points(follow(rs.gear(), "frequency_ratio", (0.62, 0.4)), "period-doubling")


@pytest.mark.parametrize("method", [HarmonicBalance(), Shooting(), Collocation()])
def test_doubling_of_a_smooth_model(method):
    (point,) = points(follow(rs.double_well(), "g", (0.264, 0.267), method), "period-doubling")
    known = StroboscopicMap(rs.double_well(), point, 2e-3)
    q = point.form.null_vector
    assert np.abs(known.A @ q + q).max() < 1e-7
    assert np.linalg.norm(q) == pytest.approx(1.0)
    assert point.form.coefficient == pytest.approx(known.doubling(q), rel=1e-4)
    assert point.criticality == "supercritical"


def test_torus_of_a_smooth_model(torus):
    for point in torus[:1]:
        known = StroboscopicMap(rs.absorber(), point, 2e-3)
        q, nu = point.form.null_vector, point.form.rotation_number
        mu = np.exp(2j * np.pi * nu)
        assert np.abs(known.A @ q - mu * q).max() < 1e-7
        assert point.form.coefficient == pytest.approx(known.torus(q, mu), rel=1e-4)
        assert point.criticality == "supercritical"
        assert point.form.resonance == nearest_resonance(nu) == ("1:1", pytest.approx(nu))


def test_a_supercritical_torus_surrounds_the_unstable_orbit(torus):
    """Started inside or outside of the predicted torus, the Poincare points move towards it."""
    point = torus[0]
    omega = point.parameter + 5e-4
    problem = point.problem
    orbit = problem.solve(point.orbit, omega)
    growth = np.abs(orbit.multipliers[0]) - 1
    assert growth > 0
    size = np.sqrt(-growth / point.form.coefficient)
    flow = rs.ExactFlow(rs.absorber(), omega=omega)
    x, M = flow.orbit(orbit.evaluate(0.0)[0])
    system = rs.absorber()
    rate = ca.Function("rate", [system.theta, system.x, system.p], [system.closed() / omega])
    p = system.parameter_vector({"omega": omega})
    values, vectors = np.linalg.eig(M)
    i = int(np.argmax(np.abs(values) + (values.imag > 0)))
    q = vectors[:, i] / np.linalg.norm(vectors[:, i])
    left = np.linalg.inv(vectors)[i] * np.linalg.norm(vectors[:, i])
    turns = 2 * round(1 / point.form.rotation_number)
    for factor in (0.6, 1.6):
        start = x + 2 * (factor * size * q).real
        ends = 2 * np.pi * np.arange(1, turns + 1)
        found = solve_ivp(lambda t, y: rate(t, y, p).full().ravel(), (0, ends[-1]), start, "DOP853", ends,
                          rtol=1e-10, atol=1e-12)  # fmt: skip
        radius = np.abs(left @ (found.y - x[:, None]))
        half = turns // 2
        change = np.mean(radius[half:]) / np.mean(radius[:half]) - 1
        assert np.sign(change) == np.sign(1 - factor)
        assert change == pytest.approx(half * growth * (1 - factor**2), rel=0.3)


def test_doublings_with_contact(gear):
    """Supercritical at 0.59, subcritical at 0.52; third derivatives of the map jump through the contact changes."""
    upper, lower = gear
    assert (upper.criticality, lower.criticality) == ("supercritical", "subcritical")
    problem = Shooting(segments=1, rtol=1e-12, atol=1e-14).discretise(rs.gear(), "frequency_ratio")
    for point, step in ((upper, 1e-3), (lower, 1e-4)):
        known = StroboscopicMap.__new__(StroboscopicMap)
        p, x = point.parameter, problem.unknown(point.orbit)
        for _ in range(4):
            F, J, _ = problem.linearise(x, p)
            x = x - np.linalg.solve(J, F)
        known.x, known.A, known._step, known._known = x, problem.monodromy(x, p), step, {}
        known._jacobian = lambda y, p=p: problem.monodromy(y, p)
        assert point.form.coefficient == pytest.approx(known.doubling(point.form.null_vector), rel=5e-3)


def test_the_doubled_branch_goes_where_the_coefficient_says(gear):
    """The square of its amplitude is proportional to the distance from the point, at the rate of the normal form."""
    for point in gear:
        branch = switch(point, (point.parameter - 5e-3, point.parameter + 5e-3), max_points=6)
        near = branch.orbits[1]
        problem = point.problem
        parent = problem.solve(point.orbit, near.value)
        critical = parent.multipliers[np.argmin(np.abs(parent.multipliers + 1))]
        beyond = abs(critical) - 1
        half = (near.evaluate(0.0)[0] - near.evaluate(2 * np.pi)[0]) / 2
        amplitude = abs(half @ point.form.null_vector)
        assert np.sign(beyond) == np.sign(point.form.coefficient)
        assert beyond / amplitude**2 == pytest.approx(point.form.coefficient, rel=0.2)


def test_a_model_that_is_linear_along_the_orbit_has_no_direction():
    branch = follow(rs.gear(), "frequency_ratio", (1.45, 1.25))
    doublings = points(branch, "period-doubling")
    assert [q.criticality for q in doublings] == ["undetermined"] * 2
    assert all("linear" in q.form.reason and q.form.coefficient == 0 for q in doublings)
    assert "undetermined (the model is linear along the orbit)" in str(doublings[0])


def test_folds_have_a_quadratic_coefficient():
    branch = follow(rs.duffing(), "omega", (0.9, 1.4))
    for fold in points(branch, "fold"):
        known = StroboscopicMap(rs.duffing(), fold, 2e-3)
        q = fold.form.null_vector
        p = known.left(q, 1.0).real
        assert fold.form.coefficient == pytest.approx(p @ known.second(q, q) / 2, rel=1e-5)


@pytest.mark.parametrize(("nu", "name"), [(0.02, "1:1"), (0.24, "1:4"), (0.3, "1:3"), (0.48, "1:2")])
def test_nearest_resonance(nu, name):
    assert nearest_resonance(nu)[0] == name


def test_left_vectors_and_those_of_a_branch_point(torus):
    """Against the Jacobian of the stroboscopic map by an integrator of its own."""
    symmetric = follow(rs.cubic(), "g", (2.5, 2.7))
    (pitchfork,) = points(symmetric, "branch-point")
    for system, point in ((rs.absorber(), torus[0]), (rs.cubic(), pitchfork)):
        M = rs.ExactFlow(system, **{point.orbit.parameter: point.parameter})(point.orbit.evaluate(0.0)[0])[1]
        nu = point.form.rotation_number
        mu = np.exp(2j * np.pi * nu) if np.isfinite(nu) else 1.0
        v, w = point.form.null_vector, point.form.left_vector
        assert np.abs(M @ v - mu * v).max() < 1e-6
        assert np.abs(w.conj() @ M - mu * w.conj()).max() < 1e-6
        assert (np.linalg.norm(v), np.linalg.norm(w)) == pytest.approx((1.0, 1.0))
        assert np.vdot(w, v).real == pytest.approx(abs(np.vdot(w, v)))
    assert pitchfork.criticality == ""
