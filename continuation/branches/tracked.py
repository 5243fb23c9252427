"""A special point tracked in two parameters: what :func:`continuation.track` returns."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from continuation.branches.branch import Kind, leading
from continuation.branches.codimension_two import CurvePoint
from continuation.orbits.orbit import Orbit

CURVE_SCHEMA = 1


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """A special point tracked in two parameters.

    Attributes
    ----------
    kind : str
    parameters : (str, str)
    values : array (N, 2)
        The two parameters along the curve.
    error : array (N, 2)
        Stated error of them: how far the true curve may be, across it.
    rotation_number : array (N,)
        Angle of the critical multiplier over 2 pi; NaN but on Neimark-Sacker curves.
    orbits : tuple of Orbit, length N
    points : tuple of CurvePoint
        Points of codimension two, and extrema of the second parameter, in order along the curve.
    stop : str
        Why it ended, a sentence.
    notes : tuple of str
        What was not looked for or not located.
    """

    kind: Kind
    parameters: tuple[str, str]
    values: np.ndarray
    error: np.ndarray
    rotation_number: np.ndarray
    orbits: tuple[Orbit, ...]
    points: tuple[CurvePoint, ...]
    stop: str
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.orbits)

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready summary."""
        return {
            "schema": CURVE_SCHEMA,
            "kind": self.kind,
            "parameters": list(self.parameters),
            "period_multiple": self.orbits[0].period_multiple,
            "stop": self.stop,
            "points": [
                {
                    "values": values,
                    "error": [e if np.isfinite(e) else None for e in error],
                    **({"rotation_number": nu} if np.isfinite(nu) else {}),
                    "rms": {s: o.rms(s) for s in o.state_names},
                    "leading_multiplier": leading(o.multipliers),
                }
                for values, error, nu, o in zip(
                    self.values.tolist(), self.error.tolist(), self.rotation_number.tolist(), self.orbits, strict=True
                )
            ],
            "special_points": [
                {
                    "kind": s.kind,
                    "values": list(s.parameters),
                    "error": [e if np.isfinite(e) else None for e in s.error],
                    "index": s.index,
                }
                for s in self.points
            ],
            "notes": list(self.notes),
        }

    def save(self, path: str | Path) -> None:
        """Write the curve to a netCDF file (readable by xarray, MATLAB, Julia), atomically."""
        from continuation.curve_storage import save_curve

        save_curve(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Curve:
        """Read a curve that :meth:`save` wrote."""
        from continuation.curve_storage import load_curve

        return load_curve(path)

    def __str__(self) -> str:
        (p, q), v = self.parameters, self.values
        lines = [
            f"Curve of {self.kind}s: {len(self)} points, {q} {v[0, 1]:.6g} to {v[-1, 1]:.6g}, "
            f"{p} {v[:, 0].min():.6g} to {v[:, 0].max():.6g}; stopped: {self.stop}",
            *(f"  {point}" for point in self.points),
            *(f"  {note}" for note in self.notes),
        ]
        return "\n".join(lines)
