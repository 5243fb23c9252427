"""Readings of the source's equations: which rows of the ledger of misprints are taken as printed."""

from __future__ import annotations

import math
from dataclasses import replace

from continuation.errors import nearest
from sbg_casadi.derived import Derived, direction_cosines
from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.errors import UserError
from sbg_casadi.pair import Pair

Reading = frozenset[int]

SWITCHABLE = (1, 2, 3, 12)
"""Rows of the ledger that change the equations: direction cosines, mesh damping, error harmonics, factor 2 of (25)."""

CONSISTENT: Reading = frozenset()
PRESETS: dict[str, Reading] = {"consistent": CONSISTENT, "printed": frozenset(SWITCHABLE)}


def parse_reading(text: str) -> Reading:
    """Return the rows taken as printed from a preset or a list of row numbers.

    Parameters
    ----------
    text : str
        ``consistent`` (no row), ``printed`` (rows 1, 2, 3, 12) or some of these numbers, as in ``1,12``.

    Raises
    ------
    UserError
        For an unknown name, and for a row that changes no equation.

    Examples
    --------
    >>> sorted(parse_reading("printed")), sorted(parse_reading("12, 1"))
    ([1, 2, 3, 12], [1, 12])
    >>> parse_reading("pritned")
    Traceback (most recent call last):
        ...
    sbg_casadi.errors.UserError: reading 'pritned': did you mean 'printed'? Expected consistent, printed, or some of \
the rows 1, 2, 3, 12 as in 1,12
    """
    word = text.strip().lower()
    if word in PRESETS:
        return PRESETS[word]
    parts = [part.strip() for part in word.split(",")]
    expected = f"xpected consistent, printed, or some of the rows {_numbers(SWITCHABLE)} as in 1,12"
    if not all(part.isdecimal() and part.isascii() for part in parts):
        close = nearest(word, PRESETS)
        raise UserError(f"reading {text!r}: {close + ' E' if close.startswith('did') else 'e'}{expected}")
    rows = frozenset(int(part) for part in parts if len(part) < 5)
    odd = [part for part in parts if len(part) >= 5 or int(part) not in SWITCHABLE]
    if odd:
        raise UserError(
            f"reading {text!r}: row {odd[0]} of the ledger is no row that changes the equations; e{expected}"
        )
    return rows


def reading_name(reading: Reading) -> str:
    """Return the text that :func:`parse_reading` turns into this reading.

    Examples
    --------
    >>> reading_name(frozenset()), reading_name(frozenset({12, 1}))
    ('consistent', '1,12')
    """
    for name, rows in PRESETS.items():
        if reading == rows:
            return name
    return ",".join(str(row) for row in sorted(reading))


def check_rows(reading: Reading) -> None:
    """Raise UserError unless every row of a reading changes the equations."""
    odd = sorted(set(reading) - set(SWITCHABLE))
    if odd:
        raise UserError(f"reading has row {odd[0]}; expected some of the rows {_numbers(SWITCHABLE)}")


def printed_cosines(derived: Derived) -> tuple[float, float, float]:
    """Return a1, a2, a3 as (9)-(11) are printed, for the angles that the consistent ones of a pair belong to.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> [round(a, 4) for a in printed_cosines(load_pair("iso-f2").derived)]
    [0.3002, 0.504, 0.7698]
    """
    sd, cd = math.sin(derived.pitch_angle), math.cos(derived.pitch_angle)
    sine = derived.a1 * sd + derived.a2 * cd  # sin(alpha)
    lead = abs(derived.a1 * cd - derived.a2 * sd)  # cos(alpha) sin(beta)
    alpha, beta = math.atan2(sine, math.hypot(lead, derived.a3)), math.atan2(lead, derived.a3)
    return direction_cosines(alpha, beta, derived.pitch_angle, 1, printed=True)


def as_read(pair: Pair, state: str | None, reading: Reading) -> Dimensionless:
    """Return the numbers of a pair in one state with the direction cosines of a reading, row 1 of the ledger.

    The other rows act in the equations: pass the same reading to :func:`~sbg_casadi.model.gear_system`.

    Raises
    ------
    UserError
        If row 1 is wanted of a dimensionless pair, whose file gives the direction cosines as plain numbers.

    Examples
    --------
    >>> from sbg_casadi import load_pair
    >>> pair = load_pair("iso-f2")
    >>> as_read(pair, "after", frozenset()) == pair.dimensionless("after")
    True
    >>> [round(s, 3) for s in as_read(pair, "after", frozenset({1})).directions]
    [-0.3, 0.504, 0.77, 0.3, -0.504, -0.77]
    """
    check_rows(reading)
    d = pair.dimensionless(state)
    if 1 not in reading:
        return d
    if pair.derived is None:
        rest = reading_name(reading - {1})
        raise UserError(
            f"reading {reading_name(reading)!r}: row 1 is about direction cosines, which pair {pair.name!r} gives as "
            f"plain numbers; expected a reading without row 1, such as {rest}"
        )
    a1, a2, a3 = printed_cosines(pair.derived)
    return replace(d, directions=(-a1, a2, a3, a1, -a2, -a3))


def _numbers(rows: tuple[int, ...]) -> str:
    return ", ".join(str(row) for row in rows)
