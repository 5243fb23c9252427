"""Receptance of a linear part with many states: sparse factorisations, and a rational function in their place.

What the ports see of ten thousand coordinates is one smooth function of frequency. It is fitted once from exact
solutions (module ``receptance_rational``), which makes a Newton step cost what it costs without the coordinates; states
are always recovered from exact solutions.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
import scipy.sparse.linalg as sla

from continuation.errors import SingularLinearPart
from continuation.model.linear_part import LinearPart, conditioning
from continuation.model.recent import Recent
from continuation.orbits.receptance_rational import Rational, fit, scale

# Harmonics k >= 1 carry the reference stiffness S (1 + 0.5 i): with this hysteretic part, which the ports take off
# again, no undamped resonance of a mode that the ports reach can meet a harmonic.
HYSTERESIS = 0.5
RIGID = 1e-13  # conditioning below which there is a rigid-body mode
RIGID_BODY = (
    "the linear part has a rigid-body mode that no nonlinear port reaches, so no unique periodic orbit exists; "
    "use a relative coordinate or ground the mode with a stiffness"
)
_GOAL = 1e-11  # relative misfit that is fitted to; the stated error is ten times what was reached
_ACCEPTED = 1e-8  # stated error up to which the rational function is used
_MOST_NODES = 600
_MOST_ENTRIES = 64  # functions fitted together
_BELOW, _ABOVE = 4.0, 32.0  # the fitted range reaches further than asked by these factors
_LARGEST = 1e13  # solution over load, in units that make the largest entries of rows and columns 1
_SPANNED = 1e-12  # relative rest of a load outside the fitted directions that counts as none


class SparseReceptance:
    """Receptance of a sparse linear part; answers as :class:`continuation.orbits.receptance.Receptance`.

    Cost: an exact solution takes one sparse factorisation per frequency (20 ms for a chain of 10000 coordinates); a fit
    takes 300 to 3000 of them once, an evaluation of it microseconds. Where the fit does not reach a stated error of
    1e-8 with 600 nodes (a thousand modes that are all sharp), exact solutions are used throughout.
    """

    def __init__(self, part: LinearPart, forcing: np.ndarray | None, reduce: bool) -> None:
        self.part = part
        at_rest = -part.shifted()
        if not conditioning(at_rest) > RIGID:
            raise SingularLinearPart(RIGID_BODY)
        self._rest = sla.splu(sp.csc_array(at_rest))
        n = len(part.B)
        self.rest_outputs = np.ascontiguousarray(self._rest.solve(np.ascontiguousarray(part.C.T), "T").T)
        self.rest_ports = self.rest_outputs @ part.B
        matrix = sp.csc_array(-part.shifted(1.0 + 1j * HYSTERESIS) + 1e-300 * sp.eye_array(n))  # with every diagonal
        self._matrix = matrix.astype(complex)
        self._diagonal = np.flatnonzero(matrix.indices == np.repeat(np.arange(n), np.diff(matrix.indptr)))
        self._rows, self._columns = _units(matrix)
        directions = _directions(forcing, n)
        self._inputs = np.hstack([part.B.astype(complex), directions])
        self._driven = np.flatnonzero(directions.any(axis=1))  # the states that the directions act on
        self._directions = directions[self._driven]
        self._reduce = reduce and self._inputs.shape[1] * len(part.C) <= _MOST_ENTRIES
        self._fit: Rational | None = None
        self._terms: Recent[tuple[np.ndarray, ...]] = Recent(2)

    @property
    def error(self) -> float:
        """Stated error of the fit in use relative to its values; 0 for exact solutions."""
        return self._fit.error if self._reduce and self._fit is not None else 0.0

    @property
    def nodes(self) -> int:
        """Number of frequencies that the fit in use interpolates; 0 for exact solutions."""
        return len(self._fit.nodes) if self._reduce and self._fit is not None else 0

    def stiffness(self, k: np.ndarray) -> np.ndarray:
        """Return S_k, shape (K, m, k), for harmonic orders k >= 0."""
        factor = np.where(k == 0, 1.0, 1.0 + 1j * HYSTERESIS)
        return factor[:, None, None] * self.part.S

    def ports(self, s: np.ndarray, power: int = 1) -> np.ndarray:
        """Return ``C M(s)^-power B`` for s (K,) on the positive imaginary axis; shape (K, k, m)."""
        if not self._ready(s):
            return self.part.C @ self.solve(s, self.part.B, power)
        return self._evaluate(s, power)[..., : self.part.B.shape[1]]

    def seen(self, s: np.ndarray, load: np.ndarray, power: int = 1) -> np.ndarray:
        """Return ``C M(s)^-power load`` for s (K,) on the positive imaginary axis and load (K, n); shape (K, k)."""
        out = np.zeros((len(s), len(self.part.C)), dtype=complex)
        some = load[:, self._driven]
        used, elsewhere = load.any(axis=1), np.count_nonzero(load, axis=1) > np.count_nonzero(some, axis=1)
        share = some @ self._directions.conj()
        rest = np.linalg.norm(some - share @ self._directions.T, axis=1)
        fitted = used & ~elsewhere & (rest <= _SPANNED * np.linalg.norm(some, axis=1))
        if fitted.any() and self._ready(s[fitted]):
            response = self._evaluate(s[fitted], power)[..., self.part.B.shape[1] :]
            out[fitted] = (response @ share[fitted][..., None])[..., 0]
            used &= ~fitted
        out[used] = self.solve(s[used], load[used][..., None], power)[..., 0] @ self.part.C.T
        return out

    def solve(self, s: np.ndarray, b: np.ndarray, power: int = 1) -> np.ndarray:
        """Return ``M(s)^-power b`` for s (K,), all nonzero, and b (K, n, c) or (n, c); shape (K, n, c). Exact."""
        out = np.empty((len(s), *b.shape[-2:]), dtype=complex)
        for i, z in enumerate(s):
            out[i] = self._solved(z, np.asarray(b[i] if b.ndim == 3 else b, dtype=complex), power)
        return out

    def at_rest(self, b: np.ndarray, power: int = 1) -> np.ndarray:
        """Return ``M_0^-power b`` for b (n,)."""
        x = np.ascontiguousarray(np.stack([b.real, b.imag], axis=1))
        for _ in range(power):
            x = self._rest.solve(x)
        return np.asarray(x[:, 0] + 1j * x[:, 1])

    def doubt(self, s: np.ndarray, port_load: np.ndarray, load: np.ndarray) -> np.ndarray:
        """Return the stated error (K, k) of ``C M(s)^-1 (B port_load + load)``, loads (K, m) and (K, n)."""
        if not self._ready(s):
            return np.zeros((len(s), len(self.part.C)))
        values = self._evaluate(s, 1)
        size = scale(values.reshape(len(s), -1)).reshape(values.shape)
        share = np.abs(np.hstack([port_load, load[:, self._driven] @ self._directions.conj()]))
        return np.asarray(self.error * (size @ share[..., None])[..., 0])

    # ---------------------------------------------------------------- what is behind it
    def _solved(self, s: complex, b: np.ndarray, power: int = 1) -> np.ndarray:
        """Return ``M(s)^-power b`` (n, c), refused where it is rounding: units do not count in that."""
        matrix = self._matrix.copy()
        matrix.data[self._diagonal] += s
        try:
            factors = sla.splu(matrix)
            for _ in range(power):
                x = factors.solve(b)
                most = _LARGEST * np.abs(b * self._rows[:, None]).max(initial=0.0)
                if not np.abs(x * self._columns[:, None]).max(initial=0.0) <= most:
                    raise RuntimeError("singular to rounding")
                b = x
        except RuntimeError as reason:
            raise SingularLinearPart(
                f"an undamped mode that no nonlinear port reaches resonates at {abs(s):.6g} rad per unit time or a "
                "harmonic of it, so no periodic orbit exists; add damping or move the frequency"
            ) from reason
        return b

    def _exact(self, x: np.ndarray) -> np.ndarray:
        """Return ``C M(i x)^-1 [B, directions]``, each flattened, for x (K,); shape (K, e)."""
        return np.array([(self.part.C @ self._solved(1j * a, self._inputs)).ravel() for a in x])

    def _evaluate(self, s: np.ndarray, power: int) -> np.ndarray:
        assert self._fit is not None
        fit, x = self._fit, s.imag
        terms = self._terms.get((id(fit), x.tobytes()), lambda: fit.terms(x))  # power 2 is asked for after power 1
        values = terms[0] if power == 1 else 1j * fit.derivative(x, terms)
        return values.reshape(len(s), len(self.part.C), -1)

    def _ready(self, s: np.ndarray) -> bool:
        """Fit where nothing is fitted yet or the range has moved; tell whether the fit may be used."""
        if not self._reduce:
            return False
        low, high = float(s.imag.min()), float(s.imag.max())
        old = self._fit
        if old is None or low < old.low or high > old.high:
            first = low / _BELOW if old is None else min(old.low, low / _BELOW)
            last = high * _ABOVE if old is None else max(old.high, high * _ABOVE)
            self._fit = fit(self._exact, first, last, _GOAL, _MOST_NODES)
            self._terms.clear()
            self._reduce = self._fit.error <= _ACCEPTED
        return self._reduce


def _units(matrix: sp.csc_array) -> tuple[np.ndarray, np.ndarray]:
    """Return what loads (n,) and solutions (n,) are multiplied by so that ``largest entry = 1`` in rows and columns."""
    size = abs(matrix)
    rows = 1.0 / np.maximum(size.max(axis=1).toarray().ravel(), 1e-290)
    columns = (sp.diags_array(rows) @ size).max(axis=0).toarray().ravel()
    return rows, columns


def _directions(forcing: np.ndarray | None, n: int) -> np.ndarray:
    """Return an orthonormal basis (n, f) of the forcing (J+1, n) of all harmonics but the mean."""
    none = np.zeros((n, 0), dtype=complex)
    if forcing is None:
        return none
    size = np.linalg.norm(forcing[1:], axis=1)
    used = np.flatnonzero(size)
    if not used.size:
        return none
    columns = (forcing[1:][used] / size[used, None]).T
    q, r, _ = sl.qr(columns, mode="economic", pivoting=True)
    return np.ascontiguousarray(q[:, np.abs(np.diag(r)) > _SPANNED])
