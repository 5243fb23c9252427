"""Largest Lyapunov exponent as a measurement would give it: from lambda alone, once per mesh period."""

from __future__ import annotations

from typing import Any

import numpy as np

from continuation import Kantz, Rosenstein, System, series_exponent
from continuation.timedomain.fixed_step import FixedStep
from sbg_casadi.documents import STATE

PERIODS = 6000
_METHODS: dict[str, Rosenstein | Kantz] = {"Rosenstein": Rosenstein(), "Kantz": Kantz(radius=0.05)}
_DIMENSION, _DELAY, _WINDOW, _HORIZON = 5, 1, 4, 40  # in mesh periods


def series_document(
    system: System, x: np.ndarray, fixed: FixedStep, parameters: dict[str, float], seconds: float | None
) -> dict[str, Any]:
    """Return the exponents of the series of lambda at phase 0 that follows a state, by both methods.

    Parameters
    ----------
    x : ndarray (n,)
        State at phase 0, on the attractor.
    parameters : dict of str to float
        Must have the frequency.
    seconds : float or None
        Length of a mesh period, where it is known.

    Returns
    -------
    dict
        ``rows`` with value and error per unit of time of the System, per mesh period and per second; ``note`` says why
        a method gave none.
    """
    p = system.parameter_vector(parameters)
    turn = 2 * np.pi / float(p[system.parameter_names.index(str(system.frequency))])
    series = fixed.compile(system).run(x, p, PERIODS).strobe[:, system.state_names.index(STATE)]
    rows, notes = [], []
    for name, method in _METHODS.items():
        try:
            found = series_exponent(
                series, 1.0, dimension=_DIMENSION, delay=_DELAY, window=_WINDOW, horizon=_HORIZON, method=method
            )
        except ValueError as error:
            notes.append(f"{name}: {error}")
            continue
        rows.append(
            {
                "method": name,
                "per_tau": found.value / turn,
                "error": found.error / turn,
                "per_mesh_period": found.value,
                "per_mesh_period_error": found.error,
                "per_second": None if seconds is None else found.value / seconds,
                "fit_mesh_periods": list(found.fit),
            }
        )
    return {"rows": rows, "note": "; ".join(notes), "mesh_periods": PERIODS, "dimension": _DIMENSION, "delay": _DELAY}


def no_series(reason: str) -> dict[str, Any]:
    """Return the document of a response whose series can give no exponent."""
    return {"rows": [], "note": reason, "mesh_periods": 0, "dimension": _DIMENSION, "delay": _DELAY}
