"""The derived quantities that a study prints, and what a reader should know about the rated speed."""

from __future__ import annotations

from typing import Any

from sbg_casadi.pair import Pair
from sbg_casadi.reading import CONSISTENT, Reading, printed_cosines

_FAR = 3.0  # times the rated ratio from which the lowest frequency of a range counts as far above it


def quantities(pair: Pair, state: str, reading: Reading = CONSISTENT) -> list[dict[str, Any]]:
    """Return name, value, unit, text and note of the quantities that lead from a pair to its equations.

    Parameters
    ----------
    pair : Pair
    state : str
        State whose direction cosines are shown for a dimensionless pair; a physical pair has one set.
    reading : frozenset of int
        Rows of the ledger taken as printed; row 1 changes a1 and a2.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> {q["name"]: q["text"] for q in quantities(load_pair("iso-f2"), "before")}["F_n"]
    '14193.3'
    """
    d = pair.dimensionless(state)
    derived = pair.derived
    if derived is None:
        return [
            _row("a3", d.tangential_cosine, "", ".6f", "tangential direction cosine"),
            _row("T/a3", d.mean_force, "", ".6f", "mean mesh force over k_0 times half backlash"),
        ]
    a1, a2, _ = printed_cosines(derived) if 1 in reading else (derived.a1, derived.a2, derived.a3)
    note = "direction cosine" + (", as printed" if 1 in reading else "")
    published = pair.published.get("normal_force")
    against = (
        ""
        if published is None
        else f"published: {published:.1f} N, difference {_deviation(derived.normal_force, published)}"
    )
    rows = [
        _row("m_eq", derived.equivalent_mass, "kg", ".6g", "equivalent mass, equation (18)"),
        _row("omega_n", derived.natural_frequency, "rad/s", ".1f", "sqrt(k_0 / m_eq)"),
        _row("k_0", derived.mesh_stiffness, "N/m", ".4g", "mean mesh stiffness"),
        _row("F_n", derived.normal_force, "N", ".1f", against or "mean normal force"),
        _row("a1", a1, "", ".6f", note),
        _row("a2", a2, "", ".6f", note),
        _row("a3", derived.a3, "", ".6f", "direction cosine, tangential"),
        _row("b", derived.half_backlash, "m", ".4e", "half backlash, normal, at the mean cone distance"),
        _row("T/a3", derived.mean_load, "", ".6f", "mean load F_n / (k_0 b)"),
        _row("speed at ratio 1", derived.unit_ratio_rpm, "rpm", ".0f", "pinion speed at omega_m = omega_n"),
    ]
    if derived.rated_ratio is not None:
        rpm = derived.pinion_rpm(derived.rated_ratio)
        rows.append(
            _row("rated ratio", derived.rated_ratio, "", ".4f", f"the rated speed, {rpm:.0f} rpm of the pinion")
        )
    return rows


def speed_warnings(pair: Pair, span: tuple[float, float]) -> list[str]:
    """Return a sentence when the rated speed lies far below the range of a study.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> len(speed_warnings(load_pair("iso-f2"), (0.3, 2.6))), speed_warnings(load_pair("iso-f2"), (0.02, 0.05))
    (1, [])
    """
    derived, lowest = pair.derived, min(span)
    if derived is None or derived.rated_ratio is None or lowest < _FAR * derived.rated_ratio:
        return []
    low, rated = derived.pinion_rpm(lowest), derived.pinion_rpm(derived.rated_ratio)
    return [
        f"the range begins at {low:.0f} rpm of the pinion, far above the rated {rated:.0f} rpm "
        f"(ratio {derived.rated_ratio:.4f}); added_pinion_inertia and added_gear_inertia lower omega_n."
    ]


def _row(name: str, value: float, unit: str, form: str, note: str) -> dict[str, Any]:
    return {"name": name, "value": value, "unit": unit, "text": format(value, form), "note": note}


def _deviation(value: float, published: float) -> str:
    return f"{100 * (value / published - 1):+.4f} %"
