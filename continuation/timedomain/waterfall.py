"""Spectra along a sweep, tracked by order: amplitudes at multiples of the excitation frequency for every value."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from continuation.errors import ContinuationError
from continuation.model.system import System
from continuation.timedomain.period_map import SAMPLES, Integrator, period_map
from continuation.timedomain.sweep_result import Sweep
from continuation.timedomain.waveform import order_spectrum


@dataclass(frozen=True, slots=True, eq=False)
class Waterfall:
    """Hold the spectra of one quantity.

    Attributes
    ----------
    parameter, quantity : str
    values : ndarray (k,)
    orders : ndarray (m,)
        Multiples of the excitation frequency.
    amplitudes : ndarray (k, m)
        With a Hann window over whole periods; NaN where there is no state to start from, or the integration failed.
    failures : tuple of str, length k
        Reason for a row of NaN, else empty.
    """

    parameter: str
    quantity: str
    values: np.ndarray
    orders: np.ndarray
    amplitudes: np.ndarray
    failures: tuple[str, ...]

    def save(self, path: str | Path) -> None:
        """Write a netCDF file, as a whole or not at all."""
        import xarray as xr  # slow to import, needed here alone

        from continuation.netcdf import write_dataset

        data = {
            "amplitudes": (("value", "order"), self.amplitudes),
            "failures": (("value",), np.array(self.failures, dtype=object)),
        }
        coordinates = {"value": self.values, "order": self.orders}
        attributes = {"format": "waterfall", "schema": 1, "parameter": self.parameter, "quantity": self.quantity}
        write_dataset(xr.Dataset(data, coordinates, attributes), path)


def waterfall(
    system: System,
    sweep: Sweep,
    *,
    quantity: str = "",
    periods: int = 64,
    highest: float = 8.0,
    integrator: Integrator | None = None,
) -> Waterfall:
    """Compute the spectrum at every value of a sweep, from the states where it ended there.

    Parameters
    ----------
    system : System
        The one that was swept.
    quantity : str
        State or output; that of the sweep when empty.
    periods : int
        Excitation periods per value; the resolution is their inverse.
    highest : float
        Largest order.

    Raises
    ------
    ValueError
        If names do not fit or fewer than 4 periods are wanted.

    Examples
    --------
    >>> import casadi as ca
    >>> from continuation.timedomain.sweep import sweep as swept
    >>> x, v, theta, omega = (ca.SX.sym(k) for k in ("x", "v", "theta", "omega"))
    >>> linear = System(name="linear", states={"x": x, "v": v}, derivatives={"x": v, "v": ca.cos(theta) - x - 0.2*v},
    ...                 phase=theta, frequency="omega", parameters={"omega": (omega, 2.0)})
    >>> w = waterfall(linear, swept(linear, "omega", [0.5, 2.0], quantity="x"), periods=8, highest=2)
    >>> w.orders[w.amplitudes.argmax(axis=1)].tolist(), w.amplitudes.max(axis=1).round(6).tolist()
    ([1.0, 1.0], [1.321637, 0.330409])
    """
    if periods < 4 or highest <= 0:
        raise ValueError(f"waterfall: expected 4 or more periods and a positive order, got {periods} and {highest}")
    march = period_map(system, integrator, (quantity or sweep.quantity,))
    p, index = system.parameter_vector(sweep.fixed), system.parameter_names.index(sweep.parameter)
    orders = np.arange(int(highest * periods) + 1) / periods
    orders, rows, failures = orders[(orders <= highest) & (orders <= SAMPLES / 2)], [], []
    for value, x in zip(sweep.values, sweep.states, strict=True):
        p[index] = value
        row, failure = np.full(len(orders), np.nan), ""
        if np.all(np.isfinite(x)):
            try:
                march.set(p)
                row = order_spectrum(march.quantity(march.ahead(x, periods)), periods, highest)[1]
            except ContinuationError as error:
                failure = str(error)
        else:
            failure = "no state to start from"
        rows.append(row)
        failures.append(failure)
    return Waterfall(sweep.parameter, quantity or sweep.quantity, sweep.values, orders, np.array(rows), tuple(failures))
