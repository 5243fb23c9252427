"""Test functions of multipliers, and the search on made-up branches whose crossings are written down."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from continuation.branches.newton import Metric, correct
from continuation.branches.screening import screen
from continuation.branches.screening import tests as functions_of
from continuation.errors import IntegrationFailed


@given(st.integers(0, 10**6), st.integers(3, 8))
def test_functions_are_products_over_multipliers(seed, n):
    M = np.random.default_rng(seed).standard_normal((1, n, n))
    fold, doubling, torus = functions_of(M)[0]
    assert fold == pytest.approx(np.linalg.det(np.eye(n) - M[0]), rel=1e-8, abs=1e-10)
    assert doubling == pytest.approx(np.linalg.det(np.eye(n) + M[0]), rel=1e-8, abs=1e-10)
    mu = np.linalg.eigvals(M[0])
    expected = np.prod([1 - mu[i] * mu[j] for i in range(n) for j in range(i)])
    assert torus == pytest.approx(expected.real, rel=1e-6, abs=1e-9)


class Straight:
    """The branch u = sin(3 p), along which the multipliers are given functions of p."""

    parameter = "p"

    def __init__(self, *multipliers):
        self.functions = multipliers

    def linearise(self, u, p):
        return u - np.sin(3 * p), np.eye(1), np.array([-3 * np.cos(3 * p)])

    def adapt(self, u, p):
        return u, 0.0

    def lengthen(self, u, like):
        return u

    def monodromies(self, points):
        return np.array([block_diagonal([f(p) for f in self.functions]) for _, p in points])


def block_diagonal(values):
    """Real matrix with the given multipliers; a complex one stands for the pair."""
    blocks = [
        np.array([[v.real, v.imag], [-v.imag, v.real]]) if np.iscomplexobj(v) else np.array([[v]]) for v in values
    ]
    n = sum(len(b) for b in blocks)
    M, i = np.zeros((n, n)), 0
    for b in blocks:
        M[i : i + len(b), i : i + len(b)] = b
        i += len(b)
    return M


def found(problem, step):
    metric, fixed = Metric(1.0, 1.0), (np.zeros(1), 1.0)
    count = round(1 / step) + 1
    nodes = [correct(problem, (np.sin([3 * p]), p), fixed, metric) for p in np.linspace(0, 1, count)]
    nodes, suspects, notes = screen(problem, nodes, metric)
    assert [n.p for n in nodes] == sorted(n.p for n in nodes)
    return [(s.test, s.segment.a.p, s.segment.b.p) for s in suspects], notes


def pair(centre, gap):
    """-1 is crossed at centre +- gap / 2 and left again."""
    return lambda p: -1 + 4 * (p - centre - gap / 2) * (p - centre + gap / 2)


@pytest.mark.parametrize("step", [0.01, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("gap", [0.3, 0.01, 1e-4])
def test_pair_of_doublings_inside_a_step(step, gap):
    suspects, notes = found(Straight(pair(0.4321, gap), lambda p: 0.3), step)
    assert notes == []
    assert [test for test, _, _ in suspects] == [1, 1]
    for (_, a, b), wanted in zip(suspects, (0.4321 - gap / 2, 0.4321 + gap / 2), strict=True):
        assert a <= wanted <= b


@pytest.mark.parametrize("step", [0.01, 0.1, 0.5, 1.0])
def test_near_contact_is_no_crossing(step):
    suspects, notes = found(Straight(lambda p: -1 + 1e-4 + 4 * (p - 0.4321) ** 2, lambda p: 0.3), step)
    assert (suspects, notes) == ([], [])


@pytest.mark.parametrize("step", [0.02, 0.25, 1.0])
def test_fold_doubling_and_torus_in_one_step(step):
    problem = Straight(
        lambda p: 0.5 + p / 1.3,  # 1 at p = 0.65
        lambda p: -0.7 - p / 2.1,  # -1 at p = 0.63
        lambda p: (0.8 + p / 3.05) * np.exp(1j),  # modulus 1 at p = 0.61
    )
    suspects, notes = found(problem, step)
    assert notes == []
    wanted = {0: 0.65, 1: 0.63, 2: 0.61}
    for kind, root in wanted.items():
        assert sum(a <= root <= b for test, a, b in suspects if test == kind) == 1
    assert (
        sum(test < 2 for test, _, _ in suspects) == 2
    )  # real pairs with product 1 may be seen as well, and dropped later


def test_three_crossings_of_one_kind():
    roots = (0.31, 0.35, 0.9)
    problem = Straight(lambda p: 1 + 10 * np.prod([p - r for r in roots]), lambda p: 0.2)
    suspects, notes = found(problem, 1.0)
    assert notes == []
    assert [s[0] for s in suspects] == [0, 0, 0]
    for (_, a, b), root in zip(suspects, roots, strict=True):
        assert a <= root <= b


def test_functions_of_what_is_not_finite():
    matrices = np.array([0.5 * np.eye(2), [[np.nan, 0.0], [0.0, 1.0]], [[np.inf, 0.0], [0.0, 0.1]], 2.0 * np.eye(2)])
    found = functions_of(matrices)
    assert np.isfinite(found).all(axis=1).tolist() == [True, False, False, True]
    assert found[0] == pytest.approx([0.25, 2.25, 0.75])


def lost(p):
    """A multiplier that is not known for p in (0.2, 0.3)."""
    return np.nan if 0.2 < p < 0.3 else 0.1


@pytest.mark.parametrize("step", [0.05, 0.1])
def test_a_matrix_that_is_not_finite_gives_a_note_and_hides_nothing_else(step):
    suspects, notes = found(Straight(lambda p: 1.8 - p / 0.9, lost), step)  # 1 at p = 0.72
    assert [test for test, _, _ in suspects] == [0]
    assert suspects[0][1] <= 0.72 <= suspects[0][2]
    assert notes
    for note in notes:
        assert note.endswith("the monodromy matrix is not finite, special points may be missing")
        low, high = (float(v) for v in note.split("[")[1].split("]")[0].split(", "))
        assert low < 0.3
        assert high > 0.2


class Fragile(Straight):
    """The same where the integration of one point of a batch fails."""

    def monodromies(self, points):
        if any(0.2 < p < 0.3 for _, p in points):
            raise IntegrationFailed("the state runs away", 0.0, {})
        return super().monodromies(points)


def test_an_integration_that_fails_is_a_point_without_a_matrix():
    suspects, notes = found(Fragile(lambda p: 1.8 - p / 0.9, lambda p: 0.1), 0.1)
    assert [test for test, _, _ in suspects] == [0]
    assert notes
    assert all("is not finite" in note for note in notes)
