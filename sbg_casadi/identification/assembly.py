"""What was checked, followed and judged of a candidate, put together into an :class:`Identification`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sbg_casadi.identification.checking import Checked, residuals_of
from sbg_casadi.identification.determinacy import determinacy, gradient_conflicts, search_conflicts
from sbg_casadi.identification.outcome import Identification
from sbg_casadi.identification.refinement import Model
from sbg_casadi.identification.scoring import Score
from sbg_casadi.identification.search import Archive
from sbg_casadi.identification.targets import Target
from sbg_casadi.identification.unknowns import Unknown
from sbg_casadi.pair import Pair

_AGREE = 0.05  # relative difference of a followed value from the one measured in time, beyond which the latter counts


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """Hold all that is known of the best candidate.

    Attributes
    ----------
    pair : Pair
    unknowns, targets : tuple
    coordinates : ndarray (n,)
    model : Model or None
        Of the targets that could be followed.
    residuals : ndarray (m,)
        Of those, and ``matrix`` (m, n) their derivatives.
    matrix : ndarray (m, n)
    checked : tuple of Checked
        All targets in the time domain.
    cheap : Score
    archive : Archive
    notes : list of str
    complete : bool
    """

    pair: Pair
    unknowns: tuple[Unknown, ...]
    targets: tuple[Target, ...]
    coordinates: np.ndarray
    model: Model | None
    residuals: np.ndarray
    matrix: np.ndarray
    checked: tuple[Checked, ...]
    cheap: Score
    archive: Archive
    notes: list[str]
    complete: bool


def put_together(p: Parts) -> Identification:
    """Return the outcome: a followed target has the value of its orbit where the time domain agrees."""
    model, own, matrix, notes = p.model, p.residuals, p.matrix, list(p.notes)
    labels = [label for target in p.targets for label in target.labels]
    residuals, values, place = [], [], 0
    by_orbit = _by_orbit(model, own)
    followed = {}
    for target, found in zip(p.targets, p.checked, strict=True):
        count = len(target.labels)
        r, v = residuals_of(target, found, p.cheap.residuals[place : place + count].tolist()), found.values
        if target.name in by_orbit:
            kind, exact_r = by_orbit[target.name]
            exact = values_of(target, exact_r)
            if agree(target, exact, v):
                r, v = list(exact_r), exact
                followed[target.name] = kind
            else:
                notes.append(f"{target.name}: the time domain has {_plain(v)}, the orbit {_plain(exact)}")
        residuals += r
        values.append(tuple(v))
        place += count
    r = np.nan_to_num(np.array(residuals), nan=12.0)
    kept = [f for f in (model.followers if model else ()) if f.target.name in followed]
    rows = _rows(model, kept)
    judged = determinacy(matrix[rows]) if rows else None
    names = [labels[f.place + k] for f in kept for k in range(len(f.target.labels))]
    conflicts = gradient_conflicts(own[rows], matrix[rows], names) if rows else []
    conflicts += search_conflicts(r, p.archive, labels)
    reasons = dict(model.reasons) if model else {}
    return Identification(
        p.pair, p.unknowns, p.targets, p.coordinates, tuple(values), tuple(c.words for c in p.checked), r, followed,
        reasons, judged, tuple(conflicts), p.archive, tuple(notes), p.complete,
    )  # fmt: skip


def values_of(target: Target, residuals: np.ndarray) -> tuple[float, ...]:
    """Return the values behind residuals."""
    return tuple(w + tolerance * r for r, (_, w, tolerance) in zip(residuals.tolist(), target.wanted, strict=True))


def unchecked(target: Target, measured: tuple[float, ...]) -> Checked:
    """Return what the search has measured as if it had been checked."""
    if target.kind != "regime":
        return Checked(measured, "")
    period = measured[0]
    return Checked((), f"period-{period:.0f}" if period > 0 else "not recognised")


def agree(target: Target, exact: Sequence[float], measured: Sequence[float]) -> bool:
    """Tell whether orbit and run in time are one response; a fold is where the response jumps in one direction only."""
    return target.kind == "jump" or bool(np.allclose(exact, measured, rtol=_AGREE))


def _by_orbit(model: Model | None, own: np.ndarray) -> dict[str, tuple[str, np.ndarray]]:
    found, place = {}, 0
    for follower in model.followers if model is not None and len(own) else ():
        count = len(follower.target.labels)
        found[follower.target.name] = follower.kind, own[place : place + count]
        place += count
    return found


def _rows(model: Model | None, kept: Sequence[Any]) -> list[int]:
    """Return the rows of the sensitivity matrix that belong to some followers."""
    rows: list[int] = []
    place = 0
    for follower in model.followers if model is not None else ():
        count = len(follower.target.labels)
        rows += [place + k for k in range(count)] if follower in kept else []
        place += count
    return rows


def _plain(values: Sequence[float]) -> str:
    return ", ".join(f"{v:.5g}" for v in values)
