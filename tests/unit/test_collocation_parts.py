"""Building blocks of collocation: polynomials, meshes, the sparse equations, their determinant and transitions."""

import casadi as ca
import numpy as np
import pytest
import reference_systems as rs
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st

from continuation import Collocation, NoConvergence, System, UnsupportedModel
from continuation.branches.sparse_bordered import null_direction, solve_bordered
from continuation.orbits.collocation_equations import products
from continuation.orbits.collocation_mesh import Mesh, Meshes, Monitor, table

DEGREES = [1, 2, 3, 4, 7, 11]


def chain(states):
    """x_i' = -x_i + 0.3 x_(i+1)^2 + 0.1 cos(theta + i), any number of states."""
    theta, omega, a = rs.symbols("theta", "omega", "a")
    x = [ca.SX.sym(f"x{i}") for i in range(states)]
    rates = [-a * x[i] + 0.3 * x[(i + 1) % states] ** 2 + 0.1 * ca.cos(theta + i) for i in range(states)]
    names = [f"x{i}" for i in range(states)]
    return System(
        name="chain", states=dict(zip(names, x, strict=True)), derivatives=dict(zip(names, rates, strict=True)),
        phase=theta, frequency="omega", parameters={"omega": (omega, 0.9), "a": (a, 1.0)},
    )  # fmt: skip


def vector_on(problem, count, seed=0):
    """A smooth unknown on a mesh of so many intervals, unequal ones."""
    rng = np.random.default_rng(seed)
    ends = np.linspace(0, 1, count + 1)
    problem._meshes._by_count[count] = Mesh.of(ends + 0.02 * np.sin(2 * np.pi * ends), problem.method.degree)
    mesh, n = problem._meshes._by_count[count], len(problem.system.state_names)
    waves = rng.standard_normal((3, n)) * 0.3
    s = 2 * np.pi * mesh.positions[:, None]
    return mesh.unknown(waves[0] + waves[1] * np.cos(s) + waves[2] * np.sin(s))


# ------------------------------------------------------------------------------------------------ polynomials
@pytest.mark.parametrize("m", DEGREES)
def test_quadrature_and_derivatives_are_exact(m):
    """Lobatto and Gauss weights integrate t^k up to 2m-1; values and derivatives of t^k up to m are those of t^k."""
    t = table(m)
    for k in range(2 * m):
        assert t.weights @ t.nodes**k == pytest.approx(1 / (k + 1), abs=1e-14)
        assert t.gauss_weights @ t.gauss**k == pytest.approx(1 / (k + 1), abs=1e-14)
    for k in range(1, m + 1):
        assert t.value @ t.nodes**k == pytest.approx(t.gauss**k, abs=1e-13)
        assert t.slope @ t.nodes**k == pytest.approx(k * t.gauss ** (k - 1), abs=1e-11)
        assert t.node_slope @ t.nodes**k == pytest.approx(k * t.nodes ** (k - 1), abs=1e-11)


@pytest.mark.parametrize("count", [2, 7, 30])
def test_norm_of_an_unknown_is_its_root_mean_square(count):
    mesh = Mesh.of(np.linspace(0, 1, count + 1) ** 1.3, 9)
    s = 2 * np.pi * mesh.positions
    u = mesh.unknown(np.stack([0.5 + 3 * np.cos(s), 2 * np.sin(s)], axis=1))
    assert np.linalg.norm(u) == pytest.approx(np.sqrt(0.25 + 4.5 + 2.0), rel=1e-4 if count == 2 else 1e-12)


def test_the_unknown_does_not_depend_on_the_mesh_in_norm():
    problem = Collocation().discretise(rs.duffing(), "omega")
    sizes = [np.linalg.norm(vector_on(problem, count)) for count in (9, 20, 51)]
    assert sizes == pytest.approx([sizes[0]] * 3, rel=1e-9)


# ------------------------------------------------------------------------------------------------ meshes
@given(st.integers(2, 40), st.integers(1, 6), st.integers(0, 10**6))
def test_lengthening_and_back_changes_nothing(count, degree, seed):
    """Halved intervals hold every polynomial of the whole ones: there and back is exact, for tangents as well."""
    problem = Collocation(degree=degree, max_intervals=400).discretise(rs.duffing(), "omega")
    u = vector_on(problem, count, seed)
    v = np.random.default_rng(seed).standard_normal(len(u))
    longer = np.zeros(len(problem._meshes.halved(problem.mesh(u)).root) * 2)
    for w in (u, v):
        there = problem.lengthen(w, longer)
        assert len(there) == len(longer)
        assert problem.lengthen(there, w) == pytest.approx(w, abs=1e-12 * np.abs(w).max() * 4**degree)


def test_lengthening_a_smooth_orbit_errs_by_the_design_order():
    problem = Collocation(degree=3).discretise(rs.duffing(), "omega")
    errors = []
    for count in (10, 20, 40):
        u, like = vector_on(problem, count), vector_on(problem, 3 * count + 1)
        errors.append(np.abs(problem.lengthen(u, like) - like).max() / problem.mesh(like).root.max())
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx([4, 4], abs=0.3)


def test_a_length_names_one_mesh():
    meshes = Meshes(4, 2, most=20)
    first = meshes.uniform(10)
    halved = meshes.halved(first)
    assert (halved.count, meshes.halved(first)) == (20, halved)
    assert np.array_equal(halved.ends[::2], first.ends)
    assert meshes.halved(halved) is None
    flat = Monitor.of(np.linspace(0, 1, 6), np.ones(5), 4)
    assert [meshes.equidistributed(flat, 9).count for _ in range(3)] == [9, 11, 12]
    assert meshes.of(np.zeros(12 * 4 * 2)).count == 12
    for wrong in (13 * 4 * 2, 12 * 4 * 2 + 1):
        with pytest.raises(ValueError, match="no mesh of this problem"):
            meshes.of(np.zeros(wrong))


def test_intervals_gather_where_the_function_changes():
    """tanh layer of width 1/200: the equidistributed mesh interpolates it 1000 times better than the uniform one."""

    def layer(s):
        return np.tanh(200 * np.sin(np.pi * (s - 0.3)) * np.cos(np.pi * (s - 0.3)))[:, None]

    monitor = Monitor.of_samples(layer(np.arange(4000) / 4000), 4)
    s = np.linspace(0, 1, 5001)
    errors = []
    for mesh in (Mesh.uniform(100, 4), monitor.mesh(100), monitor.mesh(200)):
        errors.append(np.abs(mesh.evaluate(layer(mesh.positions), s) - layer(s)).max())
    assert errors[1] < errors[0] / 1000
    assert errors[1] / errors[2] == pytest.approx(2**5, rel=0.5)
    assert monitor.worst(monitor.mesh(100)) == pytest.approx(errors[1], rel=2.0)
    assert monitor.worst(monitor.mesh(monitor.count(1e-6))) <= 1.01e-6


# ------------------------------------------------------------------------------------------------ equations
@pytest.mark.parametrize("system", [rs.duffing(), rs.coupled_van_der_pol(), chain(3)], ids=lambda s: s.name)
def test_derivatives_are_those_of_the_residual(system):
    problem = Collocation(degree=3).discretise(system, "omega", period_multiple=2)
    u, p = vector_on(problem, 6), 0.8
    F, J, Fp = problem.linearise(u, p)
    assert problem.residual(u, p) == pytest.approx(F, abs=1e-15)
    rng = np.random.default_rng(1)
    for _ in range(4):
        v = rng.standard_normal(len(u))
        numeric = (problem.residual(u + 1e-6 * v, p) - problem.residual(u - 1e-6 * v, p)) / 2e-6
        assert J @ v == pytest.approx(numeric, abs=1e-7)
    assert Fp == pytest.approx((problem.residual(u, p + 1e-6) - problem.residual(u, p - 1e-6)) / 2e-6, abs=1e-8)
    assert problem.parameter_derivative(u, p, "omega") == pytest.approx(Fp, abs=1e-15)
    other = next(n for n in system.parameter_names if n != "omega")
    exact, value = problem.parameter_derivative(u, p, other), problem.values[other]
    ends = []
    for side in (1, -1):
        problem.set_value(other, value + side * 1e-6)
        ends.append(problem.residual(u, p))
    assert exact == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=1e-8)


def test_phase_direction_and_flow_are_the_derivative_along_the_orbit():
    problem = Collocation(degree=6).discretise(rs.coupled_van_der_pol(), "omega", period_multiple=2)
    u = vector_on(problem, 40)
    mesh = problem.mesh(u)
    f = problem.system.rhs(mesh.values(u)[0], 0.0, omega=1.1) / 1.1
    assert problem.flow(u, 1.1) == pytest.approx(f, abs=1e-14)
    shifted = mesh.unknown(mesh.evaluate(mesh.values(u), np.mod(mesh.positions + 1e-5, 1.0)))
    back = mesh.unknown(mesh.evaluate(mesh.values(u), np.mod(mesh.positions - 1e-5, 1.0)))
    numeric = (shifted - back) / (2e-5 * 4 * np.pi)
    assert problem.phase_direction(u, 1.1) == pytest.approx(numeric, abs=1e-6)


@pytest.mark.parametrize("states", [1, 2, 3])
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_sign_of_the_determinant_does_not_depend_on_the_mesh(states, degree):
    """It is that of det(I - M), for decay and for growth, odd and even numbers of intervals."""
    for a in (1.0, -1.0):
        problem = Collocation(degree=degree).discretise(chain(states), "omega", a=a)
        for count in (11, 12):
            u = 0.01 * vector_on(problem, count)
            wanted = np.sign(np.linalg.det(np.eye(states) - problem.monodromies([(u, 0.9)])[0]))
            assert np.linalg.slogdet(problem.linearise(u, 0.9)[1].toarray())[0] == wanted


def test_transitions_are_the_derivative_of_the_flow():
    """Along the exact orbit their product is the monodromy matrix of an independent integrator, its determinant too."""
    system = rs.coupled_van_der_pol()
    problem = Collocation(intervals=60, degree=6).discretise(system, "omega")
    orbit = problem.guess()
    u = problem.unknown(orbit)
    _, M = rs.ExactFlow(system, **orbit.parameters)(orbit.evaluate(0.0)[0])
    found = problem.monodromies([(u, orbit.value)] * 40)  # several batches
    assert found == pytest.approx(np.broadcast_to(M, found.shape), abs=1e-8)
    assert abs(problem.liouville_defect(u, orbit.value)) < 1e-8
    assert problem.flip(u, orbit.value) == pytest.approx(np.linalg.det(np.eye(4) + M), abs=1e-7)


def test_products_from_start_and_middle():
    blocks = np.random.default_rng(0).standard_normal((3, 7, 2, 2))
    whole, turned = products(blocks)
    direct = [np.linalg.multi_dot(list(b[::-1])) for b in blocks]
    assert whole == pytest.approx(np.array(direct), abs=1e-12)
    assert np.trace(turned, axis1=1, axis2=2) == pytest.approx(np.trace(whole, axis1=1, axis2=2), abs=1e-12)


# ------------------------------------------------------------------------------------------------ bordered systems
@given(st.integers(1, 30), st.integers(0, 10**6))
def test_bordered_solution_and_sign_are_those_of_the_dense_matrix(n, seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n + 1, n + 1)) * (rng.random((n + 1, n + 1)) < 0.6) + np.diag(rng.standard_normal(n + 1))
    right = rng.standard_normal((n + 1, 2))
    z, sign = solve_bordered(sp.csc_array(A[:n, :n]), A[:n, n], A[n], right)
    assert A @ z == pytest.approx(right, abs=1e-8 * max(1.0, np.abs(z).max()))
    assert sign == np.linalg.slogdet(A)[0]
    v = null_direction(sp.csc_array(A[:n, :n]), A[:n, n])
    assert A[:n] @ v == pytest.approx(np.zeros(n), abs=1e-8)


def test_singular_bordered_system():
    J = sp.csc_array(np.zeros((2, 2)))
    assert solve_bordered(J, np.ones(2), np.ones(3), np.ones((3, 1))) is None
    with pytest.raises(NoConvergence, match="singular"):
        null_direction(J, np.ones(2))


# ------------------------------------------------------------------------------------------------ misuse
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"intervals": 1}, "intervals"),
        ({"intervals": 2.5}, "intervals"),
        ({"degree": 0}, "degree"),
        ({"degree": 2.5}, "degree"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"max_intervals": 1}, "max_intervals"),
    ],
)
def test_settings_out_of_range(settings, message):
    with pytest.raises(ValueError, match=f"^{message}: expected"):
        Collocation(**settings)


def test_misuse_is_answered():
    with pytest.raises(ValueError, match="did you mean 'omega'"):
        Collocation().discretise(rs.duffing(), "omgea")
    with pytest.raises(ValueError, match="no parameter 'gg'"):
        Collocation().discretise(rs.duffing(), "omega", gg=1.0)
    with pytest.raises(ValueError, match="period_multiple"):
        Collocation().discretise(rs.duffing(), "omega", period_multiple=0)
    problem = Collocation().discretise(rs.duffing(), "omega")
    with pytest.raises(ValueError, match="give it to discretise"):
        problem.guess(g=0.3)
    with pytest.raises(ValueError, match="known"):
        problem.guess(zeta=0.3)
    with pytest.raises(ValueError, match="expected a positive number"):
        problem.guess(omega=-1.0)
    with pytest.raises(ValueError, match="has no parameter"):
        problem.set_value("gg", 1.0)
    with pytest.raises(ValueError, match="has no parameter"):
        problem.parameter_derivative(vector_on(problem, 9), 1.0, "gg")
    with pytest.raises(ValueError, match="no mesh of this problem"):
        problem.residual(np.zeros(8), 1.0)


def test_orbits_of_another_system_or_period_are_refused():
    orbit = Collocation(tolerance=1e-4).discretise(rs.duffing(), "omega", period_multiple=2).guess(omega=0.5)
    with pytest.raises(ValueError, match="of system 'duffing'"):
        Collocation().discretise(rs.absorber(), "omega").unknown(orbit)
    with pytest.raises(ValueError, match="has no period 1"):
        Collocation().discretise(rs.duffing(), "omega").unknown(orbit)


def test_contacts_jumps_and_corners_are_refused_with_a_way_out():
    with pytest.raises(UnsupportedModel, match=r"HarmonicBalance or Shooting.*system\.smoothed\(width\)"):
        Collocation().discretise(rs.backlash(), "omega")
    assert Collocation().discretise(rs.backlash().smoothed(0.1), "omega").system.contacts == ()
    x, v, theta, omega = rs.symbols("x", "v", "theta", "omega")
    corners = {
        "sign": ca.sign(v),
        "if_else|<": ca.if_else(x > 0, 1.0, 0.0),
        "fabs": v * ca.fabs(v),
        "fmax": ca.fmax(x, 0),
    }
    for name, jump in corners.items():
        system = System(name="jump", states={"x": x, "v": v}, derivatives={"x": v, "v": ca.cos(theta) - x - jump},
                        phase=theta, frequency="omega", parameters={"omega": (omega, 1.0)})  # fmt: skip
        with pytest.raises(UnsupportedModel, match=f"treats smooth models, but the right-hand side uses '({name})'"):
            Collocation().discretise(system, "omega")


def test_a_right_hand_side_that_is_not_finite_is_named():
    """sqrt of a state that Newton's method drives below 0, and a pole: no warning, no NaN, no bare exception."""
    x, theta, omega = rs.symbols("x", "theta", "omega")
    for law in (-ca.sqrt(x) + 2 * ca.cos(theta), ca.cos(theta) - ca.log(x)):
        system = System(name="root", states={"x": x}, derivatives={"x": law}, phase=theta, frequency="omega",
                        parameters={"omega": (omega, 1.0)})  # fmt: skip
        problem = Collocation(intervals=10).discretise(system, "omega")
        with pytest.raises(NoConvergence, match=r"not finite near parameter value 1|not converge") as caught:
            problem.solve(rs_orbit(system), 1.0)
        assert caught.value.parameter == 1.0
        with pytest.raises(NoConvergence, match="no periodic orbit"):
            problem.guess()


def rs_orbit(system):
    from continuation import Orbit

    return Orbit(
        system=system.name, state_names=system.state_names, parameter="omega", parameters={"omega": 1.0},
        period=2 * np.pi, period_multiple=1, coefficients=np.array([[0.0 + 0j], [0.5 + 0j]]),
        multipliers=np.zeros(1, dtype=complex), multiplier_error=np.zeros(1), stability="stable", error=0.0,
    )  # fmt: skip
