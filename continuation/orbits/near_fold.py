"""What an error estimate can say next to a fold, where the change at fixed parameter grows beyond all bounds."""

from __future__ import annotations

import numpy as np

_RATIO = 100.0  # of the change at fixed parameter to the shortest way back to the branch that may tell a fold
_LINEAR = 1e-4  # of the size of an orbit: changes up to here are measured by their linear part


def measures_error(fixed: float, shortest: float, size: float) -> bool:
    """Tell whether the change at fixed parameter measures the error of an orbit of this size.

    Next to a fold it does until the fold is about as near as the error in the parameter; there the linear part says
    nothing, and only the shortest way back to the branch is known.

    >>> measures_error(1e-6, 1e-10, 1.0), measures_error(1e-2, 1e-10, 1.0)
    (True, False)
    """
    return fixed < _RATIO * shortest or fixed < _LINEAR * size


def side_unknown(mu: np.ndarray, bar: np.ndarray, free: bool) -> np.ndarray:
    """Return error bars (n,) of multipliers (n,) of an orbit that lies at a fold to within its error.

    The bar of the multiplier nearest to 1 (with a free period the nearest but that of the flow) reaches to 1: on which
    side of the fold the orbit lies is not known.

    >>> side_unknown(np.array([1.001, 0.5]), np.array([1e-9, 1e-9]), free=False).round(6).tolist()
    [0.001, 0.0]
    """
    away = np.abs(mu - 1)
    if not np.isfinite(away).all() or len(mu) <= free:
        return bar
    out = np.array(bar, dtype=float)
    nearest = np.argsort(away)[int(free)]
    out[nearest] = max(out[nearest], away[nearest])
    return out
