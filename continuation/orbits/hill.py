"""Hill's method: Floquet exponents from the harmonics of the variational equation, without integration.

A solution ``exp(s t) sum_k z_k exp(i k omega t)`` of ``z' = A z + B w'(t) C z`` has port arguments
``y_k = R(s + i k omega) (W y)_k`` with the receptance R of the linear part and the Toeplitz operator W of the port
slope in closed form. Its exponents are the eigenvalues of Hill's matrix, each repeated at ``s + i j omega``; two rules
tell which of them to believe. In condensed form each is a root of one small determinant.

Sources: Hill 1886; Lazarus and Thomas, A harmonic-based method for computing the stability of periodic solutions of
dynamical systems, 2010; Guillot, Lazarus, Thomas, Vergez and Cochelin, A purely frequency based Floquet-Hill
formulation, 2020 (the rule of the most symmetric eigenvector).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from continuation.orbits import contact_series as series
from continuation.orbits.harmonic_balance import HarmonicBalanceProblem
from continuation.orbits.monodromy import flow_of
from continuation.orbits.spectrum import unpack

LARGEST = 1200  # rows of Hill's matrix: its eigenvalues then cost about 10 s
_LEAST, _PLENTY = 15, 32  # harmonics of the perturbation per excitation period
_TAIL = 8  # times as many orders are eliminated
_NOTHING = 1e-9  # of the slope: what does not count
_NEAR = 0.01  # of the frequency: a pole that close to a harmonic is kept as an unknown of its own


class CondensedHill:
    """Hill's equations of one orbit, condensed onto the ports; see :meth:`correct`.

    Parameters
    ----------
    problem : HarmonicBalanceProblem
    u, p
        Point of a branch.
    harmonics : int, optional
        Orders -harmonics..harmonics of the perturbation that are solved for; when absent half those of the orbit, a
        quarter of many, or what its slope asks for. Eight times as many or more are eliminated approximately. With
        contacts the error falls with the third power, with smooth laws exponentially.
    patterns : tuple of ContactPattern, optional
        Contact changes of the orbit where they are known to be right; searched when absent.

    Raises
    ------
    ValueError
        If the modes of the linear part are ill-conditioned.
    """

    def __init__(
        self,
        problem: HarmonicBalanceProblem,
        u: np.ndarray,
        p: float,
        harmonics: int | None = None,
        patterns: tuple[series.ContactPattern, ...] | None = None,
    ) -> None:
        self.frequency, self.flow = problem.frequency(p), flow_of(problem, p)
        if not self.flow.modal:
            raise ValueError("Hill's equations condense only where the linear part has well-conditioned modes")
        own, n = len(u) // problem.ports.outputs // 2 + 1, problem.period_multiple
        most = harmonics or max(min(own // 2, _PLENTY * n), own // 4, _LEAST * n)
        reach = max(_TAIL * most, 0 if harmonics else 4 * own)
        self.slope = port_slope(problem, u, p, reach, patterns)  # (2 L + 1, m, k)
        K = harmonics or _enough(self.slope, most)
        self.slope[len(self.slope) // 2] += problem.ports.linear(problem.vector(p)).S
        self.orders = np.arange(-K, K + 1)
        self.W = _toeplitz(self.slope, K)  # (m, k, 2K+1, 2K+1)

    def correct(self, exponent: complex, steps: int = 1) -> complex:
        """Return an exponent after Newton steps on the determinant of the condensed equations.

        One step costs a factorisation of a complex matrix of 2 harmonics + 1 rows per port, 0.1 ms at 31 harmonics, 0.4
        at 63; it squares the error of an exponent that is isolated. More steps bring one from afar.
        """
        s, vectors = complex(exponent), None
        for _ in range(steps):
            if not np.isfinite(s):
                return complex(np.nan, np.nan)
            change, vectors = self._newton(s, vectors)
            s += change
            if abs(change) < 1e-12 * self.frequency:
                break
        return s

    def multiplier(self, mu: complex, steps: int = 1) -> complex:
        """Return a multiplier over the orbit's period after Newton steps of its exponent."""
        turn = 2 * np.pi / self.frequency
        exponent = self.correct(complex(np.log(mu)) / turn, steps) * turn
        if not exponent.real < 700.0:  # Newton's method ran away, or the multiplier is above the range of numbers
            return complex(np.nan, np.nan)
        return complex(np.exp(exponent))

    def _newton(
        self, s: complex, vectors: tuple[np.ndarray, np.ndarray] | None
    ) -> tuple[complex, tuple[np.ndarray, np.ndarray]]:
        """Return the Newton step of ``1 / (c D^-1 b)``, which vanishes where the matrix D(s) is singular.

        Unknowns are the port arguments, and the modes whose pole is near to s + i k omega. The vectors c and b of a
        second step are the null vectors that the first one found: from there on it converges to that exponent.
        """
        k, count = self.W.shape[1], len(self.orders)
        R, dR, gap, rows, modes = self._receptance(s, self.orders)
        size, own = k * count, k * count + np.arange(len(rows))
        D = np.zeros((size + len(rows), size + len(rows)), dtype=complex)
        if R.shape[1:] == (1, 1):
            D[:size, :size] = -R[:, 0] * self.W[0, 0]
        else:
            D[:size, :size] = -np.einsum("iab,bcij->aicj", R, self.W, optimize=True).reshape(size, size)
        D.ravel()[: size * len(D) : len(D) + 1] += 1.0
        if len(rows):
            D[rows[:, None] + count * np.arange(k), own[:, None]] = -self.flow.left[:, modes].T
            D[size:, :size] = -np.einsum("eb,bcej->ecj", self.flow.right[modes], self.W[:, :, rows]).reshape(-1, size)
            D[own, own] = gap[rows, modes]
        b = np.append(np.exp(-0.25 * np.abs(np.tile(self.orders, k))), np.ones(len(rows))).astype(complex)
        c, b = (b, b) if vectors is None or len(vectors[0]) != len(b) else vectors
        factors, pivots, failed = lapack.zgetrf(D.T, overwrite_a=True)
        if failed:  # exactly singular: the exponent is one
            return 0.0, (c, b)
        x, y = lapack.zgetrs(factors, pivots, b, trans=1)[0], lapack.zgetrs(factors, pivots, c, trans=0)[0]
        wave, left = x[:size].reshape(k, count), y[:size].reshape(k, count)
        load = np.sum([self.W[:, c] @ wave[c] for c in range(k)], axis=0)  # (m, 2K+1)
        derivative = x[size:] @ y[size:] - np.einsum("ai,iab,bi->", left, dR, load)  # y dD/ds x
        push = np.einsum("ai,iab->bi", left, R)
        np.add.at(push.T, rows, y[size:, None] * self.flow.right[modes])
        with np.errstate(all="ignore"):
            change = -complex(c @ x - self._tail(s, wave, push)) / complex(derivative)
        return change, (y / np.linalg.norm(y), x / np.linalg.norm(x))

    def _receptance(self, s: complex, orders: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return R (K, k, m) and dR/ds at s + i k omega less near poles, all distances, and the near ones by number."""
        flow = self.flow
        gap = s + 1j * orders[:, None] * self.frequency - flow.poles  # (K, n)
        close = np.abs(gap) < _NEAR * self.frequency
        gain = 1 / np.where(close, np.inf, gap)
        if len(flow.left) == flow.right.shape[1] == 1:
            residue = flow.left[0] * flow.right[:, 0]
            R, dR = (gain @ residue)[:, None, None], -(gain**2 @ residue)[:, None, None]
        else:
            R, dR = (flow.left * gain[:, None, :]) @ flow.right, -(flow.left * gain[:, None, :] ** 2) @ flow.right
        return R, dR, gap, *np.nonzero(close)

    def _tail(self, s: complex, wave: np.ndarray, push: np.ndarray) -> complex:
        """Return what the orders beyond K do to the determinant: they answer to those kept, and act back on them."""
        slope, K = self.slope, len(self.orders) // 2
        L = len(slope) // 2
        orders = np.concatenate([np.arange(K - L, -K), np.arange(K + 1, L - K + 1)])
        at = K + L + orders
        R = self._receptance(s, orders)[0]
        k, m = len(wave), len(push)
        load = np.stack([sum(np.convolve(wave[c], slope[:, b, c])[at] for c in range(k)) for b in range(m)], axis=1)
        answer = (R @ load[..., None])[..., 0]
        own = np.eye(k) - R @ slope[L]
        answer = answer / own[:, 0] if k == 1 else np.linalg.solve(own, answer[..., None])[..., 0]
        back = np.stack([sum(np.convolve(push[b], slope[::-1, b, c])[at] for b in range(m)) for c in range(k)], axis=1)
        return complex(np.sum(back * answer))


def port_slope(
    problem: HarmonicBalanceProblem,
    u: np.ndarray,
    p: float,
    reach: int,
    patterns: tuple[series.ContactPattern, ...] | None = None,
) -> np.ndarray:
    """Return Fourier coefficients (2 reach + 1, m, k) of the port slope along an orbit, orders -reach..reach."""
    ports, vector = problem.ports, problem.vector(p)
    if patterns is None or ports.smooth:
        return problem.forces(unpack(u, ports.outputs), vector, 0, reach).slope
    forcing, part, n = ports.forcing(vector), ports.linear(vector), problem.period_multiple
    slope = np.zeros((2 * reach + 1, ports.inputs, ports.outputs), dtype=complex)
    for contact, pattern, gain, d in zip(problem.system.contacts, patterns, forcing.gain, part.d, strict=True):
        edge = (gain.shape[-1] - 1) * n
        rigid = series.piecewise_spectrum(pattern, np.array(contact.slopes), reach + edge)
        for row in range(ports.inputs):
            slope[:, row] += series.modulate(rigid, gain[row], n)[:, None] * d
    return slope


def _enough(slope: np.ndarray, most: int) -> int:
    """Return how many harmonics of the perturbation a slope (2L+1, m, k) asks for, at most ``most``."""
    size = np.abs(slope[len(slope) // 2 :]).max(axis=(1, 2))
    used = int(np.flatnonzero(size > _NOTHING * size.max(initial=1e-300))[-1]) if size.any() else 0
    return min(max(4 * used, _LEAST), most)


def _toeplitz(slope: np.ndarray, K: int) -> np.ndarray:
    """Return W[b, c, i, j] = slope_(i-j)[b, c] for orders i, j of -K..K."""
    middle, order = len(slope) // 2, np.arange(2 * K + 1)
    return slope[middle + order[:, None] - order[None, :]].transpose(2, 3, 0, 1)


def hill_matrix(problem: HarmonicBalanceProblem, u: np.ndarray, p: float, harmonics: int) -> np.ndarray:
    """Return Hill's matrix in full, complex ((2 harmonics + 1) n, the same); its eigenvalues are Floquet exponents.

    Raises
    ------
    ValueError
        If it has more than 1200 rows.
    """
    n, count = len(problem.system.state_names), 2 * harmonics + 1
    if n * count > LARGEST:
        raise ValueError(f"Hill's matrix: expected at most {LARGEST} rows, got {n * count}; take fewer harmonics")
    vector = problem.vector(p)
    part = problem.ports.linear(vector)
    W = _toeplitz(port_slope(problem, u, p, 2 * harmonics), harmonics)
    matrix = np.einsum("ab,bcij,cd->iajd", part.B, W, part.C, optimize=True).reshape(n * count, n * count)
    orders = np.arange(-harmonics, harmonics + 1)
    matrix += np.kron(np.eye(count), part.A) - 1j * problem.frequency(p) * np.kron(np.diag(orders), np.eye(n))
    return matrix


def hill_exponents(
    problem: HarmonicBalanceProblem, u: np.ndarray, p: float, harmonics: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the exponents (n,) that each of two rules selects among the eigenvalues of Hill's matrix.

    The first rule takes the n in one strip of imaginary parts as wide as the frequency, the nearest to the real axis;
    the second the n whose eigenvectors are centred nearest to harmonic 0. Exponents are those of truncated harmonics:
    :meth:`CondensedHill.correct` improves them. Cost 0.03 s for 150 rows, 0.6 s for 450 (14 states, 15 harmonics).

    Examples
    --------
    >>> import casadi as ca
    >>> from continuation import HarmonicBalance, System
    >>> x, v, theta, omega = (ca.SX.sym(k) for k in ("x", "v", "theta", "omega"))
    >>> linear = System(name="linear", states={"x": x, "v": v}, derivatives={"x": v, "v": ca.cos(theta) - x - 0.2*v},
    ...                 phase=theta, frequency="omega", parameters={"omega": (omega, 3.0)})
    >>> problem = HarmonicBalance().discretise(linear, "omega")
    >>> u = problem.unknown(problem.guess(omega=3.0))
    >>> strip, symmetric = hill_exponents(problem, u, 3.0, harmonics=3)
    >>> [complex(s) for s in strip.round(6)]
    [(-0.1+0.994987j), (-0.1-0.994987j)]
    """
    n, frequency = len(problem.system.state_names), problem.frequency(p)
    values, vectors = np.linalg.eig(hill_matrix(problem, u, p, harmonics))
    weight = (np.abs(vectors.reshape(2 * harmonics + 1, n, -1)) ** 2).sum(axis=1)
    centre = (np.arange(-harmonics, harmonics + 1) @ weight) / weight.sum(axis=0)
    strip = values[_central(values.imag / frequency, n)]
    symmetric = values[_central(centre, n)]
    return _sorted(strip), _sorted(symmetric)


def _central(places: np.ndarray, n: int) -> np.ndarray:
    """Choose n numbers within one window of width 1 about 0, its edge in a wide gap between them modulo 1.

    A window fixed at -1/2..1/2 would cut exponents of negative multipliers, which lie on its edges, at random.
    """
    rest = np.sort(np.mod(places[np.abs(places) < 1.5], 1.0))
    if not rest.size:
        raise ValueError("Hill's matrix has too few harmonics for so low a frequency: none of its exponents is central")
    gaps = np.diff(np.append(rest, rest[0] + 1.0))
    edges = np.mod(rest + gaps / 2, 1.0)[gaps >= gaps.max() / 2]
    edge = float(edges[np.argmin(np.abs(edges - 0.5))])
    return np.argsort(np.abs(places - (edge - 0.5)), kind="stable")[:n]  # the window is edge-1 .. edge


def _sorted(exponents: np.ndarray) -> np.ndarray:
    return exponents[np.lexsort((-exponents.imag, -exponents.real.round(9)))]
