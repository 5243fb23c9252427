"""Result of a study of basins: attractors, shares with errors, and the label of every state."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from continuation.model.system import System


@dataclass(frozen=True, slots=True, eq=False)
class Attractor:
    """Hold one attractor.

    Attributes
    ----------
    verdict, evidence : str
        ``period-n``, ``quasi-periodic`` or ``chaotic``, and what that rests on.
    period : int
        Excitation periods after which it repeats, 0 when it does not.
    points : ndarray (k, n)
        States at phase 0: the cycle, or 128 points of what does not repeat.
    scale : ndarray (n,)
        Largest size of every coordinate.
    numbers : ndarray (n, 4)
        Rms about the mean, mean, minimum and maximum of every coordinate.
    spread : ndarray (n, 2)
        Standard errors of the mean of every coordinate and of its square, from block averages; 0 for a cycle.
    """

    verdict: str
    evidence: str
    period: int
    points: np.ndarray
    scale: np.ndarray
    numbers: np.ndarray
    spread: np.ndarray

    def distance(self, x: np.ndarray) -> float:
        """Return the distance of a state at phase 0 from the nearest point, over the scale."""
        return float((abs(self.points - x) / self.scale).max(axis=1).min())


@dataclass(frozen=True, slots=True, eq=False)
class Basins:
    """Hold which states go to which attractor.

    Attributes
    ----------
    system : str
    parameters : dict of str to float
    state_names : tuple of str, length n
    axes : dict of str to (float, float)
        Coordinates that varied, and their limits.
    points : ndarray (k, axes)
        These coordinates of every state.
    counts : tuple of int or None
        Cells of the grid along each coordinate; None for random states.
    labels : ndarray of int (k,)
        Position of the attractor, the most frequent one first; -1: not found within the limit, -2: the state left the
        finite numbers or could not be integrated.
    attractors : tuple of Attractor
    """

    system: str
    parameters: dict[str, float]
    state_names: tuple[str, ...]
    axes: dict[str, tuple[float, float]]
    points: np.ndarray
    counts: tuple[int, ...] | None
    labels: np.ndarray
    attractors: tuple[Attractor, ...]

    @classmethod
    def of(
        cls,
        system: System,
        parameters: dict[str, float],
        axes: Mapping[str, tuple[float, float]],
        points: np.ndarray,
        counts: tuple[int, ...] | None,
        labels: np.ndarray,
        attractors: Sequence[Attractor],
    ) -> Basins:
        """Collect a result, attractors in the order of their shares."""
        sizes = np.array([(labels == k).sum() for k in range(len(attractors))], dtype=int)
        order = np.argsort(-sizes, kind="stable")
        rank = np.empty(len(order), dtype=int)
        rank[order] = np.arange(len(order))
        named = np.array([rank[k] if k >= 0 else k for k in labels.tolist()], dtype=int)
        limits = {k: (float(a), float(b)) for k, (a, b) in axes.items()}
        listed = tuple(attractors[int(k)] for k in order)
        return cls(system.name, parameters, system.state_names, limits, points, counts, named, listed)

    def share(self, label: int) -> float:
        """Return the share of the states with a label."""
        return float((self.labels == label).mean())

    @property
    def fractions(self) -> np.ndarray:
        """Return the share of every attractor, shape (attractors,)."""
        return np.array([self.share(k) for k in range(len(self.attractors))])

    @property
    def fraction_errors(self) -> np.ndarray:
        """Return the standard error of every share, shape (attractors,).

        Random states: the binomial one, with one state more on either side, so that it is not 0 for a share of 0 or 1.
        Grid: every cell with a neighbour of another label is as good as undecided, as if drawn at random, which leaves
        half the root of their number over all; at least half a cell.
        """
        count = len(self.labels)
        if self.counts is None:
            share = (self.fractions * count + 1) / (count + 2)
            return np.sqrt(share * (1 - share) / count)
        table = self.labels.reshape(self.counts)
        errors = []
        for k in range(len(self.attractors)):
            inside, edge = table == k, np.zeros(table.shape, dtype=bool)
            for axis in range(table.ndim):
                a, b = np.moveaxis(inside, axis, 0), np.moveaxis(edge, axis, 0)
                differs = a[1:] != a[:-1]
                b[1:] |= differs
                b[:-1] |= differs
            errors.append(max(np.sqrt(edge.sum()) / 2, 0.5) / count)
        return np.array(errors)

    def image(self) -> np.ndarray:
        """Return the labels on the grid, shape ``counts``.

        Raises
        ------
        ValueError
            If the states were drawn at random.
        """
        if self.counts is None:
            raise ValueError("basins: random states make no picture; expected a Grid")
        return self.labels.reshape(self.counts)

    def __str__(self) -> str:
        shares = zip(self.attractors, self.fractions, self.fraction_errors, strict=True)
        shown = ", ".join(f"{a.verdict} {f:.4f} +- {e:.1g}" for a, f, e in shares)
        rest = "".join(
            f", {words} {self.share(k):.4f}" for k, words in ((-1, "not recognised"), (-2, "lost")) if self.share(k)
        )
        return f"Basins of {self.system!r}: {len(self.labels)} states, {len(self.attractors)} attractors: {shown}{rest}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain lists, numbers and text, ready for JSON."""
        shares = zip(self.attractors, self.fractions.tolist(), self.fraction_errors.tolist(), strict=True)
        return {
            "system": self.system,
            "parameters": dict(self.parameters),
            "axes": {k: list(v) for k, v in self.axes.items()},
            "states": len(self.labels),
            "grid": None if self.counts is None else list(self.counts),
            "attractors": [
                {
                    "verdict": a.verdict,
                    "evidence": a.evidence,
                    "period": a.period,
                    "fraction": fraction,
                    "fraction_error": error,
                    "state": dict(zip(self.state_names, a.points[0].tolist(), strict=True)),
                    "rms": dict(zip(self.state_names, a.numbers[:, 0].tolist(), strict=True)),
                    "mean": dict(zip(self.state_names, a.numbers[:, 1].tolist(), strict=True)),
                }
                for a, fraction, error in shares
            ],
            "not_recognised": self.share(-1),
            "lost": self.share(-2),
        }

    def save(self, path: str | Path) -> None:
        """Write a netCDF file, as a whole or not at all: points, labels, and the attractors' states at phase 0."""
        import xarray as xr  # slow to import, needed here alone

        from continuation.netcdf import write_dataset

        longest = max((len(a.points) for a in self.attractors), default=0)
        cycles = np.full((len(self.attractors), longest, len(self.state_names)), np.nan)
        for table, attractor in zip(cycles, self.attractors, strict=True):
            table[: len(attractor.points)] = attractor.points
        data = {
            "points": (("sample", "axis"), self.points),
            "labels": (("sample",), self.labels),
            "fraction": (("attractor",), self.fractions),
            "fraction_error": (("attractor",), self.fraction_errors),
            "period": (("attractor",), np.array([a.period for a in self.attractors], dtype=int)),
            "cycle": (("attractor", "point", "state"), cycles),
        }
        coordinates = {
            "axis": np.array(list(self.axes), dtype=object),
            "state": np.array(self.state_names, dtype=object),
        }
        verdicts = np.array([a.verdict for a in self.attractors], dtype=object)
        if len(verdicts):
            coordinates["attractor"] = verdicts
        attributes = {"format": "basins", "schema": 1, "system": self.system, "parameters": json.dumps(self.parameters)}
        attributes["grid"] = json.dumps(self.counts)
        write_dataset(xr.Dataset(data, coordinates, attributes), path)
