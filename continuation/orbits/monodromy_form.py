"""Critical operators of methods that have the monodromy matrix M: ``M - exp(2 pi i nu) I`` and its derivatives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from continuation.orbits.shifted import CriticalForm

RealForm = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def critical_multiplier(nu: float) -> complex:
    """Return exp(2 pi i nu), exactly 1 and -1 for nu = 0 and 1/2."""
    return {0.0: 1.0 + 0j, 0.5: -1.0 + 0j}.get(nu, complex(np.exp(2j * np.pi * nu)))


def critical_matrix(M: np.ndarray, nu: float) -> np.ndarray:
    """Return ``M - exp(2 pi i nu) I``, real for nu = 0 and 1/2.

    >>> critical_matrix(np.array([[-1.0]]), 0.5).tolist()
    [[0.0]]
    """
    mu = critical_multiplier(nu)
    return M - (mu if mu.imag else mu.real) * np.eye(len(M))


def critical_form(form: RealForm, names: tuple[str, ...], nu: float, v: np.ndarray, w: np.ndarray) -> CriticalForm:
    """Return the derivatives of ``conj(w) . (M - mu I) v`` from real forms ``a . M b`` in orbit and parameters.

    Parameters
    ----------
    form : callable
        ``form(b, a)`` returns the gradient of ``a . M b`` in the unknown (N,) and by all parameters (q,).
    """
    state, by_parameters = _sesquilinear(form, v, w)
    shift = -2j * np.pi * critical_multiplier(nu) * complex(w.conj() @ v)
    return CriticalForm(state, shift, lambda name: by_parameters[names.index(name)].item())


def _sesquilinear(form: RealForm, v: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if not (np.iscomplexobj(v) or np.iscomplexobj(w)):
        return form(v, w)
    parts: list[Any] = [0.0, 0.0]
    for right, along in ((v.real, 1.0), (v.imag, 1j)):
        for left, factor in ((w.real, 1.0), (w.imag, -1j)):
            for i, found in enumerate(form(right, left)):
                parts[i] = parts[i] + along * factor * found
    return parts[0], parts[1]
