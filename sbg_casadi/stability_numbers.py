"""The parts of a Floquet report as JSON-ready numbers: multipliers, contact pattern, harmonics, forces, waveform."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from continuation.orbits.orbit import Orbit
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.documents import STATE
from sbg_casadi.outputs import dimensionless_outputs
from sbg_casadi.reading import Reading

FLANKS = ("coast", "free", "drive")
"""Names of the linear pieces of the backlash law (20): lambda - e below -1, between, above 1."""

MOST_HARMONICS = 12
_DRAWN = 4  # of the sampled phases, one in so many goes into the waveform of the document


def multiplier_rows(mu: np.ndarray, bar: np.ndarray, seconds: float | None) -> list[dict[str, Any]]:
    """Return one row for every real multiplier and every complex pair, largest modulus first.

    Parameters
    ----------
    mu : complex array (n,)
        Floquet multipliers over one mesh period.
    bar : array (n,)
        Error bars.
    seconds : float or None
        Mesh period; None for a dimensionless pair.

    Returns
    -------
    list of dict
        ``multiplier`` [re, im >= 0], ``pair``, ``modulus``, ``error``; ``exponent`` [re, im], the logarithm, per mesh
        period, with ``exponent_error`` of its real part (None when the bar reaches zero); ``grows``;
        ``mesh_periods`` in which the mode falls to 1/e, or grows e-fold, with ``mesh_periods_error`` (None when the
        bar reaches the unit circle); ``exponent_per_second`` (None for a dimensionless pair).

    Examples
    --------
    >>> (row,) = multiplier_rows(np.array([0.3 + 0.4j, 0.3 - 0.4j]), np.full(2, 1e-3), None)
    >>> row["pair"], row["modulus"], round(row["mesh_periods"], 4), round(row["mesh_periods_error"], 4)
    (True, 0.5, 1.4427, 0.0042)
    """
    rows = []
    for i in np.flatnonzero(mu.imag >= 0).tolist():
        value, error = complex(mu[i]), float(bar[i])
        pair = value.imag > 0
        if pair:  # both of a pair have one error
            error = max(error, float(bar[np.argmin(np.abs(mu - value.conjugate()))]))
        size = abs(value)
        growth = _log(size)
        rows.append(
            {
                "multiplier": [value.real, value.imag],
                "pair": pair,
                "modulus": size,
                "error": _finite(error),
                "exponent": None if growth is None else [growth, math.atan2(value.imag, value.real)],
                "exponent_error": _exponent_error(size, error),
                "grows": size > 1,
                "mesh_periods": _periods(size),
                "mesh_periods_error": _periods_error(size, error),
                "exponent_per_second": None
                if growth is None or seconds is None
                else [growth / seconds, math.atan2(value.imag, value.real) / seconds],
            }
        )
    return sorted(rows, key=lambda row: -row["modulus"])


def _log(size: float) -> float | None:
    return math.log(size) if size > 0 else None


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _exponent_error(size: float, error: float) -> float | None:
    """Return the largest change of log(size) within the bar."""
    return -math.log1p(-error / size) if error < size else None


def _periods(size: float) -> float | None:
    """Return the mesh periods of an e-fold change; None when there is no change, 0 for a multiplier 0."""
    if size == 0:
        return 0.0
    rate = abs(math.log(size))
    return 1 / rate if rate > 0 else None


def _periods_error(size: float, error: float) -> float | None:
    """Return the largest change of the e-fold time within the bar; None where the bar reaches the unit circle."""
    if not error < abs(size - 1):
        return None
    middle = _periods(size) or 0.0
    ends = [_periods(max(size + change, 0.0)) or 0.0 for change in (-error, error)]
    return max(abs(end - middle) for end in ends)


def unstable_types(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return multiplier and type of instability for every row that is certainly outside the unit circle.

    Examples
    --------
    >>> unstable_types([{"multiplier": [-1.2, 0.0], "modulus": 1.2, "error": 1e-6}])
    [{'type': 'period-doubling', 'multiplier': [-1.2, 0.0], 'through': '-1'}]
    """
    found = []
    for row in rows:
        if row["error"] is not None and row["modulus"] - 1 > row["error"]:
            re, im = row["multiplier"]
            kind, through = ("fold", "+1") if re > 0 else ("period-doubling", "-1")
            if im:
                kind, through = "neimark-sacker", "a complex pair"
            found.append({"type": kind, "multiplier": [re, im], "through": through})
    return found


def contact_rows(phases: np.ndarray, modes: np.ndarray) -> list[dict[str, Any]]:
    """Return flank, phases in degrees and share of the mesh cycle for every contact interval.

    Parameters
    ----------
    phases : array (r,)
        Mesh phases in rad at which the contact changes, increasing, in one mesh cycle.
    modes : int array (r + 1,)
        Index of the linear piece before the first change and after each.

    Returns
    -------
    list of dict
        In order; the interval over the end of the cycle is one, its ``to_deg`` is 360 or more. One interval from 0 to
        360 when the contact never changes.

    Examples
    --------
    >>> for row in contact_rows(np.array([np.pi / 2, np.pi]), np.array([2, 1, 2])):
    ...     print(row)
    {'flank': 'free', 'from_deg': 90.0, 'to_deg': 180.0, 'share': 0.25}
    {'flank': 'drive', 'from_deg': 180.0, 'to_deg': 450.0, 'share': 0.75}
    """
    if not len(phases):
        return [{"flank": FLANKS[int(modes[0])], "from_deg": 0.0, "to_deg": 360.0, "share": 1.0}]
    starts = np.degrees(phases)
    ends = np.append(starts[1:], starts[0] + 360.0)
    return [
        {"flank": FLANKS[int(mode)], "from_deg": start, "to_deg": end, "share": (end - start) / 360.0}
        for mode, start, end in zip(modes[1:], starts.tolist(), ends.tolist(), strict=True)
    ]


def contact_shares(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Return the share of the mesh cycle on each flank: drive, free, coast."""
    return {name: math.fsum(r["share"] for r in rows if r["flank"] == name) for name in reversed(FLANKS)}


def harmonic_rows(orbit: Orbit) -> list[dict[str, Any]]:
    """Return order, amplitude and phase in degrees, ``amplitude * cos(order * theta + phase)``, of lambda.

    Up to 12, those above 1e-9 of the largest; orders count mesh frequencies.
    """
    c = orbit.harmonics(STATE)
    amplitude, phase = 2 * np.abs(c), np.degrees(np.angle(c))
    floor = 1e-9 * amplitude[1:].max(initial=0.0)
    return [
        {"order": k, "amplitude": float(amplitude[k]), "phase_deg": float(phase[k])}
        for k in range(1, min(MOST_HARMONICS + 1, len(c)))
        if amplitude[k] > floor
    ]


def force_numbers(outputs: Any, newton: float | None) -> dict[str, Any]:
    """Return the mesh force of an orbit over k_0 times half the backlash, in newtons for a physical pair."""
    force = outputs.mesh_force.values
    values = {"mean": float(outputs.mean_mesh_force), "largest": float(force.max()), "least": float(force.min())}
    return {
        "dynamic_factor": float(outputs.dynamic_factor),
        "mesh_force": values,
        "mesh_force_newton": None if newton is None else {k: v * newton for k, v in values.items()},
    }


def waveform(outputs: Any, orbit: Orbit) -> dict[str, Any]:
    """Return what is drawn: lambda, deflection lambda - e and the rate of the latter over one mesh cycle with its end.

    The rate is that in time tau = omega_n t, half backlashes per unit.
    """
    lam, deflection = outputs["lambda"].values, outputs.deflection.values
    error = np.fft.rfft(lam - deflection)  # a trigonometric polynomial of few terms: differentiated exactly
    slope = np.fft.irfft(1j * np.arange(len(error)) * error, len(lam))
    rate = orbit.evaluate(outputs.phase.values)[:, orbit.index(f"d{STATE}")] - orbit.value * slope
    columns = {"phase_deg": np.degrees(outputs.phase.values), STATE: lam, "deflection": deflection, "rate": rate}
    drawn = {name: column[::_DRAWN].tolist() for name, column in columns.items()}
    return {name: [*values, 360.0 if name == "phase_deg" else values[0]] for name, values in drawn.items()}


def orbit_numbers(
    orbit: Orbit, dimensionless: Dimensionless, reading: Reading, half_backlash: float | None, newton: float | None
) -> dict[str, Any]:
    """Return everything about one orbit but its stability; ``micrometres`` repeat lengths of a physical pair."""
    outputs = dimensionless_outputs(orbit, dimensionless, reading)
    low, high = orbit.extremes(STATE)
    lengths = {"rms": orbit.rms(STATE), "mean": orbit.mean(STATE), "least": low, "largest": high}
    (pattern,) = orbit.contacts.values()
    contact = contact_rows(*pattern)
    deflection = outputs.deflection.values
    return {
        STATE: lengths | {"peak_to_peak": high - low},
        "micrometres": None
        if half_backlash is None
        else {k: 1e6 * half_backlash * v for k, v in (lengths | {"peak_to_peak": high - low}).items()},
        "deflection": {"least": float(deflection.min()), "largest": float(deflection.max())},
        "harmonics_kept": orbit.harmonic_count,
        "contact": contact,
        "contact_shares": contact_shares(contact),
        "harmonics": harmonic_rows(orbit),
        **force_numbers(outputs, newton),
        "waveform": waveform(outputs, orbit),
    }
