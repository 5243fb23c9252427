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
from continuation.orbits.monodromy import _Flow, flow_of
from continuation.orbits.spectrum import unpack

LARGEST = 1200  # rows of Hill's matrix: its eigenvalues then cost about 10 s
_LEAST, _PLENTY = 15, 32  # harmonics of the perturbation per excitation period
_TAIL = 8  # times as many orders are eliminated
_NOTHING = 1e-9  # of the slope: what does not count
_TOGETHER = 1_000_000  # entries of the matrices that are solved in one call
_ASKED = 128  # multipliers whose port slopes are held at once
_FITS = 50_000  # complex numbers that stay in the processor's memory
_SMALL = 150  # rows of a matrix from which one factorisation less is worth a call each
_NEAR = 0.01  # of the frequency: a pole that close to a harmonic is kept as an unknown of its own


Patterns = tuple[series.ContactPattern, ...]


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
        patterns: Patterns | None = None,
    ) -> None:
        flow = flow_of(problem, p)
        if not flow.modal:
            raise ValueError("Hill's equations condense only where the linear part has well-conditioned modes")
        slope, K = _given(problem, u, p, harmonics, patterns)
        self.frequency = problem.frequency(p)
        self._equations = _Equations(flow, np.array([self.frequency]), slope[None], K)

    def correct(self, exponent: complex, steps: int = 1) -> complex:
        """Return an exponent after Newton steps on the determinant of the condensed equations.

        One step costs a factorisation of a complex matrix of 2 harmonics + 1 rows per port, in all 0.5 ms at 31 and
        1 ms at 63 harmonics; it squares the error of an exponent that is isolated. More steps bring one from afar.
        """
        s, vectors = complex(exponent), None
        for _ in range(steps):
            if not np.isfinite(s):
                return complex(np.nan, np.nan)
            (change,), vectors = self._equations.newton(np.array([s]), vectors)
            s += complex(change)
            if abs(change) < 1e-12 * self.frequency:
                break
        return s

    def multiplier(self, mu: complex, steps: int = 1) -> complex:
        """Return a multiplier over the orbit's period after Newton steps of its exponent."""
        turn = 2 * np.pi / self.frequency
        return complex(_multiplier(np.array([self.correct(complex(np.log(mu)) / turn, steps) * turn]))[0])


def corrected(
    problem: HarmonicBalanceProblem,
    points: list[tuple[np.ndarray, float]],
    patterns: list[Patterns | None],
    asked: list[tuple[int, complex]],
) -> np.ndarray:
    """Return multipliers (A,) after one Newton step each, NaN where modes are ill-conditioned or the step runs away.

    Parameters
    ----------
    points : list of (u, p)
    patterns : list
        Contact changes of every point, or None; see :class:`CondensedHill`.
    asked : list of (int, complex)
        Number of the point, and a multiplier of it; ordered by the number.
    """
    some = [asked[start : start + _ASKED] for start in range(0, len(asked), _ASKED)]
    return np.concatenate([_corrected(problem, points, patterns, a) for a in some] or [np.zeros(0, dtype=complex)])


def _corrected(
    problem: HarmonicBalanceProblem,
    points: list[tuple[np.ndarray, float]],
    patterns: list[Patterns | None],
    asked: list[tuple[int, complex]],
) -> np.ndarray:
    """Do the same with the port slopes of all points asked for in memory."""
    out = np.full(len(asked), np.nan, dtype=complex)
    groups: dict[tuple[int, int, int], list[int]] = {}
    given: dict[int, tuple[_Flow, np.ndarray, int]] = {}
    for a, (i, _) in enumerate(asked):
        u, p = points[i]
        if i not in given:
            flow = flow_of(problem, p)
            given[i] = (flow, *_given(problem, u, p, None, patterns[i])) if flow.modal else (flow, np.zeros(0), 0)
        flow, slope, K = given[i]
        if flow.modal:
            groups.setdefault((id(flow), len(slope), K), []).append(a)
    for (_, _, K), members in groups.items():
        together = max(1, _TOGETHER // (problem.ports.outputs * (2 * K + 1)) ** 2)
        for some in (members[start : start + together] for start in range(0, len(members), together)):
            who = [asked[a][0] for a in some]
            frequency = np.array([problem.frequency(points[i][1]) for i in who])
            equations = _Equations(given[who[0]][0], frequency, np.array([given[i][1] for i in who]), K)
            s = np.log(np.array([asked[a][1] for a in some], dtype=complex)) * frequency / (2 * np.pi)
            out[some] = _multiplier((s + equations.newton(s)[0]) * 2 * np.pi / frequency)
    return out


def _multiplier(exponent: np.ndarray) -> np.ndarray:
    """Return exp of exponents times the period; NaN above the range of numbers, where Newton's method ran away."""
    fine = exponent.real < 700.0
    return np.where(fine, np.exp(np.where(fine, exponent, 0.0)), complex(np.nan, np.nan))


def _given(
    problem: HarmonicBalanceProblem, u: np.ndarray, p: float, harmonics: int | None, patterns: Patterns | None
) -> tuple[np.ndarray, int]:
    """Return the slope (2 L + 1, m, k), the reference slope in it, and the harmonics K of the perturbation."""
    own, n = len(u) // problem.ports.outputs // 2 + 1, problem.period_multiple
    most = harmonics or max(min(own // 2, _PLENTY * n), own // 4, _LEAST * n)
    reach = max(_TAIL * most, 0 if harmonics else 4 * own)
    slope = port_slope(problem, u, p, reach, patterns)
    K = harmonics or _enough(slope, most)
    slope[len(slope) // 2] += problem.ports.linear(problem.vector(p)).S
    return slope, K


class _Equations:
    """Condensed equations of N orbits of one linear part, each with one exponent.

    Parameters
    ----------
    flow : _Flow
    frequency : array (N,)
    slope : complex array (N, 2 L + 1, m, k)
    K : int
        Orders -K..K of the perturbation are kept.
    """

    def __init__(self, flow: _Flow, frequency: np.ndarray, slope: np.ndarray, K: int) -> None:
        self.flow, self.frequency, self.slope = flow, frequency, slope
        self.orders = np.arange(-K, K + 1)
        middle, order = slope.shape[1] // 2, np.arange(2 * K + 1)
        self.W = slope[:, middle + order[:, None] - order[None, :]].transpose(0, 3, 4, 1, 2)  # (N, m, k, J, J)

    def newton(
        self, s: np.ndarray, vectors: tuple[np.ndarray, np.ndarray] | None = None
    ) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Return the Newton step (N,) of ``1 / (c D^-1 b)``, which vanishes where the matrix D(s) is singular.

        Unknowns are the port arguments, and the modes whose pole is near to s + i k omega. The vectors c and b of a
        second step are the null vectors that the first one found: from there on it converges to that exponent.
        """
        N, k, count = len(s), self.W.shape[2], len(self.orders)
        R, dR, gap, close = self._receptance(s, self.orders)
        rows, modes, there = _padded(close)
        size, E = k * count, rows.shape[1]
        each, own = np.arange(N)[:, None], size + np.arange(E)
        D = np.zeros((N, size + E, size + E), dtype=complex)
        if R.shape[2:] == (1, 1):
            D[:, :size, :size] = -R[:, :, 0] * self.W[:, 0, 0]
        else:
            D[:, :size, :size] = -np.einsum("niab,nbcij->naicj", R, self.W, optimize=True).reshape(N, size, size)
        D[:, np.arange(size), np.arange(size)] += 1.0
        if E:
            left, right = self.flow.left.T[modes] * there[..., None], self.flow.right[modes] * there[..., None]
            for port in range(k):
                D[each, rows + count * port, own] = -left[..., port]
            picked = self.W[each, :, :, rows]  # (N, E, m, k, J)
            D[:, size:, :size] = -np.einsum("neb,nebcj->necj", right, picked).reshape(N, E, size)
            D[:, own, own] = np.where(there, gap[each, rows, modes], 1.0)
        b = np.tile(np.append(np.exp(-0.25 * np.abs(np.tile(self.orders, k))), np.zeros(E)).astype(complex), (N, 1))
        b[:, size:] = there
        c, b = (b, b) if vectors is None or vectors[0].shape != b.shape else vectors
        x, y, singular = _both(D, b, c)
        wave, push = x[:, :size].reshape(N, k, count), y[:, :size].reshape(N, k, count)
        load = np.einsum("nbcij,ncj->nbi", self.W, wave)  # (N, m, J)
        derivative = (x[:, size:] * y[:, size:]).sum(axis=1) - np.einsum("nai,niab,nbi->n", push, dR, load)
        push = np.einsum("nai,niab->nbi", push, R)
        for e in range(E):
            push[np.arange(N), :, rows[:, e]] += y[:, size + e, None] * right[:, e]
        with np.errstate(all="ignore"):
            change = -((c * x).sum(axis=1) - self._tail(s, wave, push)) / derivative
        change[singular] = 0.0  # the exponent is one
        return change, (_unit(y), _unit(x))

    def _receptance(self, s: np.ndarray, orders: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return R (N, K, k, m) and dR/ds at s + i k omega less near poles, all distances (N, K, n), and the near."""
        flow = self.flow
        at = s[:, None] + 1j * orders * self.frequency[:, None]
        gap = at[..., None] - flow.poles
        close = np.abs(gap) < (_NEAR * self.frequency)[:, None, None]
        gain = 1 / np.where(close, np.inf, gap)
        if len(flow.left) == flow.right.shape[1] == 1:
            residue = flow.left[0] * flow.right[:, 0]
            return (gain @ residue)[..., None, None], -(gain**2 @ residue)[..., None, None], gap, close
        R = (flow.left * gain[..., None, :]) @ flow.right
        return R, -(flow.left * gain[..., None, :] ** 2) @ flow.right, gap, close

    def _far(self, s: np.ndarray, orders: np.ndarray) -> np.ndarray:
        """Return R (N, K, k, m) at many orders: mode by mode, so that little memory is passed through."""
        flow, near = self.flow, _NEAR * self.frequency[:, None]
        at = s[:, None] + 1j * orders * self.frequency[:, None]
        if at.size * len(flow.poles) < _FITS:
            return self._receptance(s, orders)[0]
        R = np.zeros((*at.shape, len(flow.left), flow.right.shape[1]), dtype=complex)
        for pole, left, right in zip(flow.poles, flow.left.T, flow.right, strict=True):
            gap = at - pole
            gap[np.abs(gap) < near] = np.inf
            R += (1 / gap)[..., None, None] * np.outer(left, right)
        return R

    def _tail(self, s: np.ndarray, wave: np.ndarray, push: np.ndarray) -> np.ndarray:
        """Return what the orders beyond K do to the determinant: they answer to those kept, and act back on them."""
        slope, K = self.slope, len(self.orders) // 2
        L, k = slope.shape[1] // 2, wave.shape[1]
        orders = np.concatenate([np.arange(K - L, -K), np.arange(K + 1, L - K + 1)])
        at = K + L + orders
        R = self._far(s, orders)
        load = _convolved(slope, wave, "nfbc,nfc->nfb")[:, at]
        answer = (R @ load[..., None])[..., 0]
        own = np.eye(k) - R @ slope[:, L, None]
        answer = answer / own[..., 0] if k == 1 else np.linalg.solve(own, answer[..., None])[..., 0]
        back = _convolved(slope[:, ::-1], push, "nfbc,nfb->nfc")[:, at]
        return np.asarray((back * answer).sum(axis=(1, 2)))


def _convolved(slope: np.ndarray, wave: np.ndarray, product: str) -> np.ndarray:
    """Return the full convolution of slopes (N, 2 L + 1, m, k) with waves (N, c, J), orders -(L + K)..(L + K)."""
    length = slope.shape[1] + wave.shape[2] - 1
    count = 1 << (length - 1).bit_length()
    spectra = np.fft.fft(slope, count, axis=1), np.fft.fft(wave, count, axis=2).transpose(0, 2, 1)
    return np.fft.ifft(np.einsum(product, *spectra), axis=1)[:, :length]


def _padded(close: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return orders (N, E) and modes (N, E) by number where (N, J, n) is true, and which (N, E) of them are none."""
    owner, rows, modes = np.nonzero(close)
    counts = np.bincount(owner, minlength=len(close))
    there = np.arange(counts.max(initial=0)) < counts[:, None]
    out = np.zeros((2, *there.shape), dtype=int)
    out[:, there] = rows, modes
    return out[0], out[1], there


def _both(D: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the solutions of ``D x = b`` and ``D' y = c`` for matrices (N, q, q), and which are exactly singular."""
    singular = np.zeros(len(D), dtype=bool)
    if len(D) > 1 and D.shape[1] <= _SMALL:  # two factorisations each, in one call
        try:
            return (
                np.linalg.solve(D, b[..., None])[..., 0],
                np.linalg.solve(D.transpose(0, 2, 1), c[..., None])[..., 0],
                singular,
            )
        except np.linalg.LinAlgError:
            pass  # one of them is singular: told one by one
    x, y = np.zeros_like(b), np.zeros_like(c)
    for i, matrix in enumerate(D):
        factors, pivots, failed = lapack.zgetrf(matrix.T, overwrite_a=True)
        singular[i] = failed != 0
        if not failed:
            x[i] = lapack.zgetrs(factors, pivots, b[i], trans=1)[0]
            y[i] = lapack.zgetrs(factors, pivots, c[i], trans=0)[0]
    return x, y, singular


def _unit(v: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(v, axis=1, keepdims=True)
    return v / np.where(size > 0, size, 1.0)


def port_slope(
    problem: HarmonicBalanceProblem,
    u: np.ndarray,
    p: float,
    reach: int,
    patterns: Patterns | None = None,
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
