"""What the data determine: singular values of the scaled sensitivity matrix, errors of the values, conflicts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sbg_casadi.identification.search import Archive

RANGE_ERROR = 1 / math.sqrt(12)
"""Standard deviation of a value that is only known to lie in its range, over the range."""

_DETERMINED = 0.5  # of that deviation, at most, is left of a determined value
_OPPOSED = 0.5  # cosine from which two targets pull in opposite directions
_ENOUGH = 20  # candidates from which what none of them meets is worth telling
_MENTIONED = 0.3  # entry of a direction that is worth a name


@dataclass(frozen=True, slots=True, eq=False)
class Determinacy:
    """Hold what targets say about unknowns; all over the ranges of the unknowns and the tolerances of the targets.

    Attributes
    ----------
    singular_values : ndarray (min(m, n),)
        Of the sensitivity matrix (m, n): tolerances by which a target moves along a direction as long as the ranges.
    directions : ndarray (min(m, n), n)
        Unit directions in the unknowns, one row for each singular value.
    errors : ndarray (n,)
        Standard errors over the ranges, from the tolerances as standard errors of the targets and the range as all
        that is known else; 0.289 is no more than the range.
    determined : ndarray of bool (n,)
        Whether the error is less than half of that.
    """

    singular_values: np.ndarray
    directions: np.ndarray
    errors: np.ndarray
    determined: np.ndarray


def determinacy(sensitivity: np.ndarray) -> Determinacy:
    """Judge a sensitivity matrix (m, n), residuals in tolerances over unknowns in ranges.

    Examples
    --------
    >>> found = determinacy(np.array([[100.0, 0.0, 0.0], [0.0, 50.0, 50.0]]))
    >>> found.determined.tolist(), found.singular_values.round(3).tolist()
    ([True, False, False], [100.0, 70.711])
    """
    _, values, directions = np.linalg.svd(sensitivity, full_matrices=False)
    inverse = np.linalg.inv(sensitivity.T @ sensitivity + np.eye(sensitivity.shape[1]) / RANGE_ERROR**2)
    errors = np.sqrt(np.diag(inverse))
    return Determinacy(values, directions, errors, errors < _DETERMINED * RANGE_ERROR)


def direction_words(direction: np.ndarray, names: Sequence[str]) -> str:
    """Return a direction in the unknowns as text, its largest entries first.

    >>> direction_words(np.array([0.8, -0.6, 0.1]), ["damping", "a_1", "a_2"])
    '+0.80 damping, -0.60 a_1'
    """
    order = np.argsort(-np.abs(direction), kind="stable")
    kept = [i for i in order if abs(direction[i]) >= _MENTIONED] or [int(order[0])]
    return ", ".join(f"{direction[i]:+.2f} {names[i]}" for i in kept)


@dataclass(frozen=True, slots=True)
class Conflict:
    """Say that two targets are not met together.

    Attributes
    ----------
    target : str
        A target that is missed.
    others : tuple of str
        Targets that stand against it.
    evidence : {"gradient", "search"}
    text : str
        A sentence.
    """

    target: str
    others: tuple[str, ...]
    evidence: str
    text: str


def gradient_conflicts(residuals: np.ndarray, gradients: np.ndarray, labels: Sequence[str]) -> list[Conflict]:
    """Return the pairs of missed targets of which each gets worse where the other gets better.

    Parameters
    ----------
    residuals : ndarray (m,)
        In tolerances.
    gradients : ndarray (m, n)
    labels : sequence of str

    Examples
    --------
    >>> found = gradient_conflicts(np.array([2.0, -3.0]), np.array([[1.0, 0.0], [1.0, 0.1]]), ["a", "b"])
    >>> found[0].text
    'a (+2.0 tolerances) and b (-3.0) pull in opposite directions, cosine -1.00'
    """
    found = []
    for i in range(len(labels)):
        for j in range(i + 1, len(labels)):
            size = float(np.linalg.norm(gradients[i]) * np.linalg.norm(gradients[j]))
            least, largest = sorted((abs(residuals[i]), abs(residuals[j])))
            if least < 0.5 or largest < 1 or not size:
                continue
            cosine = float(np.sign(residuals[i] * residuals[j]) * (gradients[i] @ gradients[j]) / size)
            if cosine < -_OPPOSED:
                text = f"{labels[i]} ({residuals[i]:+.1f} tolerances) and {labels[j]} ({residuals[j]:+.1f}) pull in "
                text += f"opposite directions, cosine {cosine:.2f}"
                found.append(Conflict(labels[i], (labels[j],), "gradient", text))
    return found


def search_conflicts(residuals: np.ndarray, archive: Archive, labels: Sequence[str]) -> list[Conflict]:
    """Return for every missed target what the search has seen: who meets it, and what such candidates miss.

    Parameters
    ----------
    residuals : ndarray (m,)
        Of the values found, in tolerances.
    archive : Archive
        Candidates of the search; only the completely scored ones are looked at.
    labels : sequence of str
    """
    known = [s.residuals for s in archive.scores if s.complete]
    found: list[Conflict] = []
    if len(known) < _ENOUGH:
        return found
    met = np.abs(np.array(known)) <= 1 + 1e-9
    met &= np.array(known) < 1  # a regime that is missed has 1 or more
    own = (np.abs(residuals) <= 1 + 1e-9) & (residuals < 1)
    for i in np.flatnonzero(~own).tolist():
        with_it = met[met[:, i]]
        if not len(with_it):
            text = f"{labels[i]}: met by none of {len(met)} candidates that were scored in full"
            found.append(Conflict(labels[i], (), "search", text))
            continue
        most = with_it[int(np.argmax((with_it & own).sum(axis=1)))]
        broken = tuple(labels[j] for j in np.flatnonzero(own & ~most).tolist())
        if broken:
            text = (
                f"{labels[i]}: met by {len(with_it)} of {len(met)} candidates that were scored in full; the one that "
            )
            text += f"meets most of the others misses {', '.join(broken)}"
            found.append(Conflict(labels[i], broken, "search", text))
    return found
