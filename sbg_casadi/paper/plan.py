"""What a run computes: cases, pairs that stand for them, frequencies, and the parts with their keys."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import sbg_casadi
from sbg_casadi.errors import UserError
from sbg_casadi.pair import Pair, case_names, load_pair
from sbg_casadi.paper.printed import CASES, EXPONENTS, REGIMES, State
from sbg_casadi.paper.row import Basis

_TARGETS = Path(sbg_casadi.__file__).parent / "cases" / "targets"

STATES: tuple[State, ...] = ("before", "after")
SPAN = (0.3, 2.6)
POINTS = 116
"""Frequencies of a sweep: every 0.02 of the range; those of the paper come on top."""


@dataclass(frozen=True, slots=True)
class Subject:
    """A case of the paper and the pair that stands for it.

    Attributes
    ----------
    case : str
    file : str
        Name of the built-in case, or of a pair file.
    pair : Pair
    basis : {"calibrated", "assumed"}
        Where the values come from that the paper does not print.
    """

    case: str
    file: str
    pair: Pair
    basis: Basis


@dataclass(frozen=True, slots=True)
class Plan:
    """Settings of a run.

    Attributes
    ----------
    cases : tuple of str
    points : int
        Frequencies of every sweep, without the paper's own.
    span : (float, float)
        First and last frequency ratio.
    """

    cases: tuple[str, ...] = CASES
    points: int = POINTS
    span: tuple[float, float] = SPAN

    def frequencies(self, case: str, state: State) -> np.ndarray:
        """Return the frequency ratios of the sweeps, increasing: equal steps and those at which the paper looks."""
        return np.union1d(np.linspace(*self.span, self.points), paper_frequencies(case, state))


def subject(case: str) -> Subject:
    """Return the calibrated pair of a case where there is one, else the one completed by assumed values.

    Examples
    --------
    >>> subject("case3").pair.states
    ('before', 'after')
    """
    calibrated = f"{case}-calibrated"
    if calibrated in case_names():
        return Subject(case, calibrated, load_pair(calibrated), "calibrated")
    return Subject(case, case, load_pair(case), "assumed")


def conflicts(subject: Subject) -> dict[str, str]:
    """Return what the calibration of a case says about each target that it could not meet with all others.

    Returns
    -------
    dict
        Clause by the name of the target, such as ``before: peak, height``; empty without a calibration.
    """
    path = _TARGETS / f"{subject.case}-found.json"
    if subject.basis != "calibrated" or not path.exists():
        return {}
    stored = json.loads(path.read_text(encoding="utf-8"))
    return {c["target"]: c["text"].removeprefix(f"{c['target']}: ") for c in stored["conflicts"]}


def chosen_cases(number: int | None) -> tuple[str, ...]:
    """Return the cases of an option ``--case``, all of them when it is absent.

    Examples
    --------
    >>> chosen_cases(3), len(chosen_cases(None))
    (('case3',), 4)
    >>> chosen_cases(5)
    Traceback (most recent call last):
        ...
    sbg_casadi.errors.UserError: --case 5; expected a case of the paper, 1 to 4
    """
    if number is None:
        return CASES
    if not 1 <= number <= len(CASES):
        raise UserError(f"--case {number}; expected a case of the paper, 1 to {len(CASES)}")
    return (CASES[number - 1],)


def check_points(points: int) -> None:
    """Raise UserError unless a sweep has a sensible number of frequencies."""
    if not 3 <= points <= 5000:
        raise UserError(f"--points {points}; expected a number of frequencies from 3 to 5000")


def paper_frequencies(case: str, state: State) -> tuple[float, ...]:
    """Return the frequency ratios at which the paper looks at one motion of a case, increasing.

    Examples
    --------
    >>> paper_frequencies("case3", "before"), paper_frequencies("case1", "before")
    ((0.6, 1.11, 1.7, 2.3), ())
    """
    found = {float(r.low) for r in REGIMES if (r.case, r.state) == (case, state) and r.low == r.high}
    if case == "case3":
        found |= {float(ratio) for where, _, ratio, _ in EXPONENTS if where == state}
    return tuple(sorted(found))


def key(subject: Subject, plan: Plan) -> str:
    """Return text that differs when any number of a case could differ."""
    numbers = [sorted(subject.pair.dimensionless(state).to_dict().items()) for state in STATES]
    return hashlib.sha256(repr((numbers, subject.basis, plan.points, plan.span, 1)).encode()).hexdigest()[:16]
