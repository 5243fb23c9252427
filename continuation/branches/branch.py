"""Results of a continuation: special points and the branch they lie on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from continuation.branches.criticality import Criticality, NormalForm
from continuation.orbits.orbit import Orbit

Kind = Literal["fold", "period-doubling", "neimark-sacker", "branch-point", "grazing", "user"]
CRITICAL: dict[Kind, int] = {
    "fold": 1,
    "period-doubling": 1,
    "neimark-sacker": 2,
    "branch-point": 1,
    "grazing": 0,
    "user": 0,
}
"""Multipliers on the unit circle at a special point of each kind; no stability changes where there is none."""
SCHEMA = 1


@dataclass(frozen=True, slots=True, eq=False)
class SpecialPoint:
    """A fold, period-doubling, Neimark-Sacker, branch or grazing point of a branch, or a zero of a user's function.

    Attributes
    ----------
    kind : str
        At a "grazing" point a contact interval appears or vanishes, ``note`` says which; at a "user" point the
        function that ``note`` names is zero.
    parameter : float
        Continuation parameter at the point.
    error : float
        Stated error of ``parameter``.
    orbit : Orbit
    bracket : tuple of float
        Parameters of the two branch points it was found between.
    index : int
        It lies between branch points ``index`` and ``index + 1``.
    status : "located" or "guessed"
        Whether the location converged to its stated error.
    note : str
        What a reader should know, empty mostly.
    problem : Problem or None
        What the branch was traced with; None when loaded from a file.
    node : Node or None
        The point as an unknown of that problem at the resolution of the branch, with the tangent of the branch; None
        when loaded from a file.
    form : NormalForm or None
        Critical eigenvectors, direction, rotation number; None where they are not computed.
    span : tuple of float
        Parameter range of the branch it was found on, in which other branches are followed from it unless told
        otherwise; None when loaded from a file.
    """

    kind: Kind
    parameter: float
    error: float
    orbit: Orbit
    bracket: tuple[float, float]
    index: int
    status: Literal["located", "guessed"] = "located"
    note: str = ""
    problem: Any = field(default=None, repr=False)
    node: Any = field(default=None, repr=False)
    form: NormalForm | None = None
    span: tuple[float, float] | None = None

    @property
    def multipliers(self) -> np.ndarray:
        """Floquet multipliers (n,), largest modulus first."""
        return self.orbit.multipliers

    @property
    def criticality(self) -> Criticality:
        """Whether the new orbits are stable ("supercritical") or not; "undetermined", or empty for other kinds."""
        return "" if self.form is None else self.form.criticality

    def __str__(self) -> str:
        note = f" ({self.note})" if self.note else ""
        form = str(self.form) if self.form is not None else ""
        what = f"{self.kind} at {self.orbit.parameter} = {self.parameter:.10g} +- {self.error:.1e}, {self.status}{note}"
        return f"{what}, {form}" if form else what


@dataclass(frozen=True, slots=True, eq=False)
class Branch:
    """Ordered orbits of one branch with its special points; immutable.

    Attributes
    ----------
    orbits : tuple of Orbit
    special_points : tuple of SpecialPoint, in order along the branch
    stop : str
        Why the branch ended, a sentence.
    work : mapping of str to int or float
        Counts: Newton steps, factorisations, orbits, seconds.
    provenance : mapping of str to str
        Method, versions, System.
    unresolved : tuple of str
        Intervals in which a change of stability could not be explained by a located point; empty when all is explained.
    """

    orbits: tuple[Orbit, ...]
    special_points: tuple[SpecialPoint, ...]
    stop: str
    work: Mapping[str, float]
    provenance: Mapping[str, str]
    unresolved: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("work", "provenance"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def __len__(self) -> int:
        return len(self.orbits)

    @property
    def parameter_name(self) -> str:
        """Name of the continuation parameter."""
        return self.orbits[0].parameter

    @property
    def period_multiple(self) -> int:
        """Excitation periods per period of the orbits."""
        return self.orbits[0].period_multiple

    @property
    def parameter(self) -> np.ndarray:
        """Continuation parameter of every orbit, shape (N,)."""
        return np.array([o.value for o in self.orbits])

    @property
    def multipliers(self) -> np.ndarray:
        """Floquet multipliers, shape (N, n), largest modulus first in each row."""
        return np.array([o.multipliers for o in self.orbits])

    @property
    def stability(self) -> np.ndarray:
        """Verdicts "stable", "unstable" or "undecided", shape (N,)."""
        return np.array([o.stability for o in self.orbits])

    @property
    def stable(self) -> np.ndarray:
        """Whether each orbit is certainly stable, shape (N,)."""
        return self.stability == "stable"

    @property
    def error(self) -> np.ndarray:
        """Estimated waveform error of every orbit, shape (N,)."""
        return np.array([o.error for o in self.orbits])

    def rms(self, state: str) -> np.ndarray:
        """Return the root mean square about the mean of one state, shape (N,)."""
        return np.array([o.rms(state) for o in self.orbits])

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready summary: points, special points, stop reason, work."""
        return {
            "schema": SCHEMA,
            "parameter": self.parameter_name,
            "period_multiple": self.period_multiple,
            "stop": self.stop,
            "points": [
                {
                    "parameter": o.value,
                    "rms": {s: o.rms(s) for s in o.state_names},
                    "stability": o.stability,
                    "leading_multiplier": leading(o.multipliers),
                    "error": o.error,
                }
                for o in self.orbits
            ],
            "special_points": [
                {
                    "kind": s.kind,
                    "parameter": s.parameter,
                    "error": s.error,
                    "status": s.status,
                    "note": s.note,
                    **_form(s.form),
                    "rms": {k: s.orbit.rms(k) for k in s.orbit.state_names},
                    "multipliers": [[m.real, m.imag] for m in s.multipliers.tolist()],
                }
                for s in self.special_points
            ],
            "unresolved": list(self.unresolved),
            "work": dict(self.work),
            "provenance": dict(self.provenance),
        }

    def save(self, path: str | Path) -> None:
        """Write the branch to a netCDF file (readable by xarray, MATLAB, Julia), atomically."""
        from continuation.storage import save_branch

        save_branch(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Branch:
        """Read a branch that :meth:`save` wrote."""
        from continuation.storage import load_branch

        return load_branch(path)

    def __str__(self) -> str:
        first, last = self.orbits[0], self.orbits[-1]
        counts = Counter(self.stability.tolist())
        lines = [
            f"Branch of {first.system!r}, period {self.period_multiple}: {len(self)} orbits, "
            f"{self.parameter_name} {first.value:.6g} to {last.value:.6g}",
            "  " + ", ".join(f"{counts[k]} {k}" for k in ("stable", "unstable", "undecided") if counts[k]),
            *(f"  {point}" for point in self.special_points),
            *(f"  unresolved: {text}" for text in self.unresolved),
            f"  stopped: {self.stop}; largest waveform error {self.error.max():.1e}",
        ]
        return "\n".join(lines)


def _form(form: NormalForm | None) -> dict[str, Any]:
    """Return the JSON-ready normal form; numbers that are not known are left out."""
    if form is None:
        return {}
    out: dict[str, Any] = {
        name: [[x.real, x.imag] for x in getattr(form, name).astype(complex).tolist()]
        for name in ("null_vector", "left_vector")
    }
    if np.isfinite(form.coefficient):
        out |= {"coefficient": form.coefficient, "coefficient_error": form.error}
    if form.criticality:
        out |= {"criticality": form.criticality, "reason": form.reason}
    if np.isfinite(form.rotation_number):
        name, distance = form.resonance
        out |= {"rotation_number": form.rotation_number, "resonance": name, "resonance_distance": distance}
    return out


def leading(multipliers: np.ndarray) -> list[float]:
    """Return [re, im] of the multiplier of largest modulus, im >= 0."""
    m = multipliers[int(np.argmax(np.abs(multipliers)))]
    return [float(m.real), abs(float(m.imag))]
