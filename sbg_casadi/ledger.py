"""The ledger of misprints and gaps: what is printed, what is used instead, and what each row changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from sbg_casadi.errors import UserError
from sbg_casadi.ledger_rows import MEASURED, ROWS, LedgerRow, Measurement
from sbg_casadi.reading import SWITCHABLE, Reading, as_read

if TYPE_CHECKING:
    from rich.table import Table

CASE, STATE, SPAN = "iso-f2", "before", (0.3, 2.6)
"""What effects are measured on."""

ADDED_ERROR = (0.05, 0.03)
"""Cosine and sine of the first harmonic of e in half backlashes (assumed); rows 2 and 3 change nothing without."""

_NAMES = {"fold": "folds", "period-doubling": "PD", "neimark-sacker": "torus"}


@dataclass(frozen=True, slots=True)
class Effect:
    """Hold what one row taken as printed changes, with and without a transmission error at no load.

    Attributes
    ----------
    row : int
    added_error : bool
        Whether :data:`ADDED_ERROR` excites the pair, too.
    consistent, printed : Measurement
        Before and after the switch.
    """

    row: int
    added_error: bool
    consistent: Measurement
    printed: Measurement

    @property
    def peak_change(self) -> float:
        """Relative change of the peak RMS."""
        return self.printed.peak_rms / self.consistent.peak_rms - 1

    def __str__(self) -> str:
        excited = "with an assumed e" if self.added_error else "as filed"
        if self.printed == self.consistent:
            return f"{excited}: none"
        before, after = self.consistent, self.printed
        rms = f"peak RMS {before.peak_rms:.4f} -> {after.peak_rms:.4f} ({100 * self.peak_change:+.1f} %)"
        return f"{excited}: {rms}; {_points(before)} -> {_points(after)}"


def row(number: int) -> LedgerRow:
    """Return one row; an unknown number raises UserError.

    Examples
    --------
    >>> row(12).place
    '(25)'
    """
    for one in ROWS:
        if one.number == number:
            return one
    raise UserError(f"the ledger has no row {number}; expected a number from 1 to {len(ROWS)}")


def effects(number: int) -> tuple[Effect, ...]:
    """Return the stored effects of a row, none for a row that is not switchable.

    Examples
    --------
    >>> print(effects(2)[0])
    as filed: none
    >>> effects(15)
    ()
    """
    if number not in SWITCHABLE:
        return ()
    return tuple(Effect(number, added, MEASURED[0, added], MEASURED[number, added]) for added in (False, True))


def measure(reading: Reading, *, added_error: bool = False, span: tuple[float, float] = SPAN) -> Measurement:
    """Trace the period-1 response of :data:`CASE` and return its peak RMS and special points; about 2 s.

    Parameters
    ----------
    reading : frozenset of int
        Rows taken as printed.
    added_error : bool
        Excite by :data:`ADDED_ERROR` as well.
    span : (float, float)
        First and last frequency ratio.

    Returns
    -------
    Measurement
        Peak RMS of lambda about its mean among the traced orbits (half backlashes), and (kind, frequency ratio) of
        the located folds, period-doublings and torus points in rising order.
    """
    from sbg_casadi.pair import load_pair
    from sbg_casadi.response import trace_response

    d = as_read(load_pair(CASE), STATE, reading)
    if added_error:
        cosine, sine = ADDED_ERROR
        d = replace(d, error_cosine=(cosine,), error_sine=(sine,))
    _, branch = trace_response(d, span, reading=reading)
    points = [p for p in branch.special_points if p.status == "located" and p.kind in _NAMES]
    located = [(p.kind, round(p.parameter, 7)) for p in points]
    return Measurement(round(float(branch.rms("lambda").max()), 5), tuple(sorted(located, key=lambda p: p[1])))


def ledger_document() -> dict[str, Any]:
    """Return all rows with their measured effects, ready for JSON.

    Examples
    --------
    >>> document = ledger_document()
    >>> len(document["rows"]), [r["number"] for r in document["rows"] if r["switchable"]]
    (20, [1, 2, 3, 12])
    """
    rows = [
        asdict(r)
        | {
            "switchable": r.number in SWITCHABLE,
            "measured": [asdict(e) | {"peak_change": e.peak_change} for e in effects(r.number)],
        }
        for r in ROWS
    ]
    return {
        "schema": 1,
        "measured_on": {"case": CASE, "state": STATE, "range": list(SPAN), "added_error": list(ADDED_ERROR)},
        "rows": rows,
    }


def ledger_table() -> Table:
    """Return the ledger as a table for the screen."""
    from rich.markup import escape
    from rich.table import Table

    caption = (
        f"Effects are measured on {CASE}, state {STATE}, frequency ratio {SPAN[0]:g} to {SPAN[1]:g}, one row switched; "
        f"PD is a period-doubling. The assumed e is {ADDED_ERROR[0]:g} cos(theta) + {ADDED_ERROR[1]:g} sin(theta) half "
        "backlashes. Switch rows with --reading."
    )
    table = Table("row", "place", "printed", "used here", "effect", caption=caption, show_lines=True)
    for column in table.columns:
        column.overflow = "fold"
    for r in ROWS:
        effect = "\n".join([r.effect, *(str(e) for e in effects(r.number))])
        table.add_row(str(r.number), *(escape(text) for text in (r.place, r.printed, r.consistent, effect)))
    return table


def _points(measurement: Measurement) -> str:
    kinds = dict.fromkeys(kind for kind, _ in measurement.points)
    parts = [f"{_NAMES.get(k, k)} {_ratios([v for kind, v in measurement.points if kind == k])}" for k in sorted(kinds)]
    return ", ".join(parts) or "no special point"


def _ratios(values: Sequence[float]) -> str:
    return " ".join(f"{v:.4f}" for v in values)
