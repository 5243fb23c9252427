"""One row of the scoreboard and its verdict, which is always computed and can't contradict what it rests on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Verdict = Literal["reproduced", "matched after calibration", "contradicted", "not checkable"]
Basis = Literal["printed", "calibrated", "assumed", "none"]
Kind = Literal["figure", "table", "equation", "sentence"]

VERDICTS: tuple[Verdict, ...] = ("reproduced", "matched after calibration", "contradicted", "not checkable")

_ALLOWED: dict[Basis, tuple[Verdict, ...]] = {
    "printed": ("reproduced", "contradicted"),
    "calibrated": ("matched after calibration", "not checkable"),
    "assumed": ("not checkable",),
    "none": ("not checkable",),
}

MEANING: dict[Verdict, str] = {
    "reproduced": "follows from what the paper prints, alone: equations, tables, sentences",
    "matched after calibration": "the model gives it with parameters that were searched for, because the paper does "
    "not print them; it shows that the statement is possible, not that it is right",
    "contradicted": "what the paper prints elsewhere, or plain mechanics of its own equations, says otherwise, "
    "whatever the missing parameters are",
    "not checkable": "rests on data that are not printed; where the model was tried, its value and the difference "
    "stand beside it, and a search that misses refutes nothing",
}


@dataclass(frozen=True, slots=True)
class Row:
    """Hold one statement of the paper, what was found, and the verdict.

    Attributes
    ----------
    key : str
        Name that never changes, such as ``table-7-case1-before``.
    place : str
        Where it stands: figure, table, equation in brackets, or section.
    kind : {"figure", "table", "equation", "sentence"}
    statement : str
        In the words of this project.
    printed, ours : str
        The paper's value and this project's.
    difference : float or None
        Ours minus the paper's, where both are numbers.
    tolerance : float or None
        Largest difference that counts as agreement.
    basis : {"printed", "calibrated", "assumed", "none"}
        What our value rests on.
    verdict : str
        One of :data:`VERDICTS`.
    reason : str
        One sentence.

    Raises
    ------
    ValueError
        If the verdict is not one that the basis allows: nothing calibrated or assumed is ever called reproduced.

    Examples
    --------
    >>> Row("a", "Table 7", "table", "peak", "0.1", "0.1", 0.0, 0.01, "calibrated", "reproduced", "because.")
    Traceback (most recent call last):
        ...
    ValueError: row 'a': verdict 'reproduced' can't rest on calibrated data; expected one of matched after \
calibration, not checkable
    """

    key: str
    place: str
    kind: Kind
    statement: str
    printed: str
    ours: str
    difference: float | None
    tolerance: float | None
    basis: Basis
    verdict: Verdict
    reason: str

    def __post_init__(self) -> None:
        if self.verdict not in _ALLOWED[self.basis]:
            raise ValueError(
                f"row {self.key!r}: verdict {self.verdict!r} can't rest on {self.basis} data; expected one of "
                + ", ".join(_ALLOWED[self.basis])
            )


def number(value: float) -> str:
    """Return a number as text, 5 significant digits.

    >>> number(59.8101), number(1.0), number(-0.00449)
    ('59.81', '1', '-0.00449')
    """
    return f"{value:.5g}"


def compared(
    key: str,
    place: str,
    kind: Kind,
    statement: str,
    printed: str,
    ours: float,
    tolerance: float,
    *,
    agrees: str,
    differs: str,
    unit: str = "",
) -> Row:
    """Return a row that compares a printed number with one computed from printed data.

    Examples
    --------
    >>> row = compared("b", "Table 2", "table", "radius", "119.62", 59.81, 0.01, agrees="x.", differs="a diameter.")
    >>> row.verdict, row.difference, row.reason
    ('contradicted', -59.81, 'a diameter.')
    """
    off = ours - float(printed)
    close = abs(off) <= tolerance * (1 + 1e-9)
    tail = f" {unit}" if unit else ""
    return Row(
        key, place, kind, statement, printed + tail, number(ours) + tail, round(off, 12), tolerance, "printed",
        "reproduced" if close else "contradicted", agrees if close else differs,
    )  # fmt: skip


def stated(
    key: str,
    place: str,
    kind: Kind,
    statement: str,
    printed: str,
    ours: str,
    holds: bool,
    *,
    agrees: str,
    differs: str,
    difference: float | None = None,
    tolerance: float | None = None,
) -> Row:
    """Return a row for a statement that printed data decide, with the outcome of that."""
    verdict: Verdict = "reproduced" if holds else "contradicted"
    reason = agrees if holds else differs
    return Row(key, place, kind, statement, printed, ours, difference, tolerance, "printed", verdict, reason)


def unchecked(key: str, place: str, kind: Kind, statement: str, printed: str, reason: str, ours: str = "-") -> Row:
    """Return a row for what can't be checked at all."""
    return Row(key, place, kind, statement, printed, ours, None, None, "none", "not checkable", reason)


def modelled(
    key: str,
    place: str,
    kind: Kind,
    statement: str,
    printed: str,
    ours: str,
    basis: Basis,
    holds: bool | None,
    *,
    difference: float | None = None,
    tolerance: float | None = None,
    detail: str = "",
    conflict: str = "",
) -> Row:
    """Return a row for a value of the model, whose parameters are calibrated or assumed.

    Parameters
    ----------
    holds : bool or None
        Whether the model agrees within the tolerance; None when it gave no value.
    detail : str
        Clause that is added to the reason.
    conflict : str
        Clause of a calibration about this target, added where it is missed.

    Examples
    --------
    >>> modelled("c", "Table 7", "table", "peak", "0.1", "0.34", "assumed", False).verdict
    'not checkable'
    >>> modelled("c", "Table 7", "table", "peak", "0.1", "0.1", "calibrated", True).verdict
    'matched after calibration'
    """
    missed = holds is False and basis == "calibrated"
    more = "".join(f"; {text}" for text in (detail, conflict if missed else "") if text)
    if holds is None:
        reason = f"the parameters are not printed, and the {basis} ones gave no value{more}."
    elif basis == "assumed":
        with_them = "agree" if holds else "differ"
        reason = f"the parameters are not printed, and with assumed ones the two {with_them} by chance{more}."
    elif holds:
        reason = f"the model gives it with calibrated parameters{more}."
    else:
        reason = f"the parameters are not printed, and the calibration does not reach it, which refutes nothing{more}."
    verdict: Verdict = "matched after calibration" if holds and basis == "calibrated" else "not checkable"
    return Row(key, place, kind, statement, printed, ours, difference, tolerance, basis, verdict, reason)


def counts(rows: Sequence[Row]) -> dict[str, int]:
    """Return how many rows have which verdict, in the order of :data:`VERDICTS`."""
    return {verdict: sum(r.verdict == verdict for r in rows) for verdict in VERDICTS}
