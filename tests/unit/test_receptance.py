"""Receptances against plain matrix inverses, in modal form and where modes are defective."""

import numpy as np
import pytest

from continuation import SingularLinearPart
from continuation.model.ports import LinearPart
from continuation.orbits.receptance import receptance


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
