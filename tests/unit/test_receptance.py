"""Receptances against plain matrix inverses: in modal form, with defective modes, sparse, and fitted."""

import numpy as np
import pytest
import scipy.sparse as sp
from chain_systems import matrix

from continuation import SingularLinearPart
from continuation.model.linear_part import LinearPart, conditioning, spectral_radius
from continuation.orbits import receptance_sparse
from continuation.orbits.receptance import receptance
from continuation.orbits.receptance_rational import fit, scale


def part(A, B, C, S):
    return LinearPart(A, B, C, np.zeros((0, len(C))), S)


def random_part(seed, n=6, m=2, k=2):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n)) - 2 * np.eye(n)
    return part(A, rng.standard_normal((n, m)), rng.standard_normal((k, n)), rng.standard_normal((m, k)))


def plain(p, s, factor):
    return s * np.eye(len(p.A)) - p.A + p.B @ (factor * p.S) @ p.C


JORDAN = part(np.array([[-0.5, 1.0], [0.0, -0.5]]), np.eye(2)[:, 1:], np.eye(2)[:1], np.zeros((1, 1)))


@pytest.mark.parametrize("p", [random_part(0), random_part(1, n=5, m=1, k=1), random_part(2, m=3, k=2), JORDAN])
def test_receptance_is_the_inverse(p):
    r, s = receptance(p), 1j * np.array([0.3, 1.0, 7.0])
    k = np.arange(1, 4)
    factors = [f[0, 0] / p.S[0, 0] if p.S[0, 0] else 1.0 for f in r.stiffness(k)]
    for i, (z, f) in enumerate(zip(s, factors, strict=True)):
        inverse = np.linalg.inv(plain(p, z, f))
        assert r.ports(s)[i] == pytest.approx(p.C @ inverse @ p.B, abs=1e-9)
        for power in (1, 2):
            wanted = np.linalg.matrix_power(inverse, power) @ p.B
            assert r.solve(s, p.B, power)[i] == pytest.approx(wanted, abs=1e-9)
    assert r.static == pytest.approx(np.linalg.inv(plain(p, 0.0, 1.0).real), abs=1e-9)


def test_static_stiffness_is_real_and_the_others_have_a_hysteretic_part():
    r = receptance(random_part(3))
    stiffness = r.stiffness(np.arange(3))
    assert np.array_equal(stiffness[0].imag, np.zeros((2, 2)))
    assert np.all(stiffness[1:].imag != 0)
    assert stiffness[1:].real == pytest.approx(np.broadcast_to(r.part.S, (2, 2, 2)))


def test_rigid_body_within_reach_is_held_by_the_reference_stiffness():
    free = part(np.array([[0.0, 1.0], [0.0, -0.1]]), np.array([[0.0], [1.0]]), np.eye(2)[:1], np.ones((1, 1)))
    assert np.isfinite(receptance(free).static).all()


def test_rigid_body_out_of_reach_is_refused():
    A = np.array([[0.0, 1.0, 0, 0], [0, -0.1, 0, 0], [0, 0, 0, 1.0], [0, 0, -1.0, -0.1]])
    p = part(A, np.eye(4)[:, 3:], np.eye(4)[2:3], np.ones((1, 1)))
    with pytest.raises(SingularLinearPart, match="rigid-body mode that no nonlinear port reaches"):
        receptance(p)


# ------------------------------------------------------------------------------------------------ many states
def chain_part(n, damping=0.02, sparse=True):
    """The chain of ``chain_systems`` with a contact at its first coordinate."""
    A, B, C = matrix(n, damping), np.zeros((2 * n, 1)), np.zeros((1, 2 * n))
    B[n, 0], C[0, 0] = -1.0, 1.0
    return LinearPart(A if sparse else A.toarray(), B, C, np.ones((1, 1)), np.ones((1, 1)))


def forcing(n, *places):
    """Mean and two harmonics that act on some velocities in two patterns."""
    u = np.zeros((3, 2 * n), dtype=complex)
    for j, place in enumerate(places):
        u[:, n + place] = 0.3, 0.5 - 0.2j * j, 0.1j + j
    return u


@pytest.mark.parametrize("power", [1, 2])
@pytest.mark.parametrize("reduce", [False, True])
def test_sparse_and_modal_receptances_are_the_same(reduce, power):
    n, u = 40, forcing(40, 0, 7)
    modal, sparse = receptance(chain_part(n, sparse=False), u), receptance(chain_part(n), u, reduce)
    s = 1j * np.array([0.3, 0.7, 1.4, 2.1, 14.0])
    other = np.zeros(2 * n, dtype=complex)
    other[3 * n // 2] = 1.0  # a direction that was not announced
    load = np.array([u[1], u[2], u[1], other, u[2]])
    tolerance = 1e-12 if not reduce else 1e-9 if power == 1 else 1e-7
    assert sparse.ports(s, power) == pytest.approx(modal.ports(s, power), rel=tolerance, abs=1e-14)
    assert sparse.seen(s, load, power) == pytest.approx(modal.seen(s, load, power), rel=tolerance, abs=1e-12)
    assert sparse.solve(s, load[..., None], power) == pytest.approx(modal.solve(s, load[..., None], power), abs=1e-10)
    assert sparse.at_rest(u[0], power) == pytest.approx(modal.at_rest(u[0], power), rel=1e-10, abs=1e-12)
    assert sparse.rest_ports == pytest.approx(modal.rest_ports, rel=1e-12)
    assert sparse.rest_outputs == pytest.approx(modal.rest_outputs, rel=1e-10, abs=1e-12)
    assert np.array_equal(sparse.stiffness(np.arange(3)), modal.stiffness(np.arange(3)))
    assert (sparse.error > 0) == (sparse.nodes > 0) == reduce
    assert modal.error == 0


@pytest.mark.parametrize(("n", "damping"), [(150, 0.02), (400, 0.05)])
def test_stated_error_of_the_fit_holds_at_a_thousand_frequencies(n, damping):
    u = forcing(n, 0, 3)
    fitted, exact = receptance(chain_part(n, damping), u), receptance(chain_part(n, damping), u, reduce=False)
    x = np.exp(np.random.default_rng(0).uniform(np.log(0.2), np.log(30.0), 1000))
    load, port = np.repeat(u[2:], len(x), axis=0), np.full((len(x), 1), 2.0 - 1j)
    miss = np.abs(fitted.ports(1j * x) - exact.ports(1j * x))[..., 0] * np.abs(port)
    miss += np.abs(fitted.seen(1j * x, load) - exact.seen(1j * x, load))
    assert 0 < fitted.error < 1e-9
    assert np.all(miss <= fitted.doubt(1j * x, port, load))
    assert not exact.doubt(1j * x, port, load).any()


def test_fit_reaches_further_when_asked():
    r = receptance(chain_part(60, 0.1), forcing(60, 0))
    r.ports(1j * np.array([0.7, 1.4]))
    few, far = r.nodes, 1j * np.array([0.01, 200.0])
    exact = receptance(chain_part(60, 0.1), forcing(60, 0), reduce=False).ports(far)
    assert r.ports(far) == pytest.approx(exact, rel=1e-9)
    assert r.nodes > few


def test_modes_too_sharp_for_a_fit_are_solved_exactly(monkeypatch):
    monkeypatch.setattr(receptance_sparse, "_MOST_NODES", 60)
    u, s = forcing(200, 0), 1j * np.array([0.41, 0.82, 1.23])
    r = receptance(chain_part(200, 1e-4), u)
    modal = receptance(chain_part(200, 1e-4, sparse=False), u)
    assert r.ports(s) == pytest.approx(modal.ports(s), rel=1e-9)
    assert r.seen(s, u[[1, 1, 2]]) == pytest.approx(modal.seen(s, u[[1, 1, 2]]), rel=1e-9)
    assert (r.error, r.nodes) == (0.0, 0)


def test_sparse_rigid_body_and_resonance_out_of_reach_are_refused():
    p = chain_part(30)
    free = sp.block_diag([p.A, np.array([[0.0, 1.0], [0.0, -0.1]])], format="csc")
    ringing = sp.block_diag([p.A, np.array([[0.0, 1.0], [-1.0, 0.0]])], format="csc")
    B, C = np.vstack([p.B, np.zeros((2, 1))]), np.hstack([p.C, np.zeros((1, 2))])
    with pytest.raises(SingularLinearPart, match="rigid-body mode that no nonlinear port reaches"):
        receptance(LinearPart(sp.csc_array(free), B, C, p.d, p.S))
    r = receptance(LinearPart(sp.csc_array(ringing), B, C, p.d, p.S), reduce=False)
    load = np.zeros((1, len(B), 1))
    load[0, -1] = 1.0
    assert np.isfinite(r.ports(np.array([1j]))).all()
    with pytest.raises(SingularLinearPart, match=r"undamped mode.*resonates at 1 rad"):
        r.solve(np.array([1j]), load)


def test_rational_fit_converges_on_a_branch_point_and_differentiates():
    """Semi-infinite chains have a branch cut beside the axis: no finite number of modes, but few nodes."""

    def exact(x):
        return np.stack([1 / np.sqrt(x**2 - 1 - 0.05j * x), 1 / (x + 0.1j) ** 3], axis=1)

    r = fit(exact, 0.1, 20.0, 1e-12, 200)
    x = np.geomspace(0.1, 20.0, 777)
    assert len(r.nodes) < 60
    assert np.all(np.abs(r(x) - exact(x)) <= r.error * scale(exact(x)))
    assert np.array_equal(r(r.nodes), exact(r.nodes))
    h = 1e-5
    slope = (exact(x - 2 * h) - 8 * exact(x - h) + 8 * exact(x + h) - exact(x + 2 * h)) / (12 * h)
    assert np.abs(r.derivative(x) - slope).max() < 1e-6 * np.abs(slope).max()
    at = r.nodes[1:-1]
    near = (exact(at - 2 * h) - 8 * exact(at - h) + 8 * exact(at + h) - exact(at + 2 * h)) / (12 * h)
    assert np.abs(r.derivative(at) - near).max() < 1e-5 * np.abs(near).max()


@pytest.mark.parametrize("n", [3, 40])
def test_sparse_measures_of_a_matrix(n):
    """Reciprocal condition in the 1-norm within a factor of the one in the 2-norm; spectral radius from above."""
    A = matrix(n, 0.02)
    dense, radius = A.toarray(), np.abs(np.linalg.eigvals(A.toarray())).max()
    assert conditioning(dense) / (2 * n) < conditioning(A) < conditioning(dense) * 2 * n
    assert radius <= spectral_radius(A) * (1 + 1e-12)
    assert spectral_radius(A) < 1.3 * radius
    units = np.geomspace(1e-6, 1e6, 2 * n)
    scaled = sp.csc_array(sp.diags_array(units) @ A @ sp.diags_array(1 / units))
    assert conditioning(scaled) > 1e-3 * conditioning(A)
