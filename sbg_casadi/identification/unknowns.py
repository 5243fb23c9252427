"""What is looked for: numbers and choices of a pair file inside bounds, on coordinates from 0 to 1."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sbg_casadi.dimensionless import Dimensionless
from sbg_casadi.identification.addresses import current, put, without_change
from sbg_casadi.normalise import derive, given_series, given_states, physical_series, physical_states
from sbg_casadi.pair import Pair, build_pair
from sbg_casadi.schema import DimensionlessFile, read_file

Numbers = Callable[[Dimensionless], np.ndarray]

_STEP = 1e-4  # of the range: the formulas between file and equations are smooth, their differences err by 1e-8


@dataclass(frozen=True, slots=True)
class Unknown:
    """Describe one value that is looked for.

    Attributes
    ----------
    name : str
        How reports call it, the first key where the file gives no other name.
    keys : tuple of str
        Addresses in the pair file that it is written to.
    factors : tuple of float
        What it is multiplied with at each of them.
    low, high : float
        Bounds in ``unit``.
    unit : str
        SI unit, empty for plain numbers.
    scale : {"linear", "log"}
    choices : tuple
        Instead of bounds: the words or whole numbers it may be.

    Examples
    --------
    >>> xi = Unknown("xi", ("mesh.damping_ratio",), (1.0,), 0.01, 0.16, "", "log")
    >>> round(xi.value(0.5), 9), xi.coordinate(0.04)
    (0.04, 0.5)
    """

    name: str
    keys: tuple[str, ...]
    factors: tuple[float, ...]
    low: float
    high: float
    unit: str
    scale: Literal["linear", "log"]
    choices: tuple[Any, ...] = ()

    def value(self, t: float) -> Any:
        """Return the value at a coordinate from 0 to 1."""
        if self.choices:
            return self.choices[min(int(t * len(self.choices)), len(self.choices) - 1)]
        if self.scale == "log":
            return float(self.low * (self.high / self.low) ** t)
        return float(self.low + t * (self.high - self.low))

    def coordinate(self, value: Any) -> float:
        """Return the coordinate of a value."""
        if self.choices:
            return (self.choices.index(value) + 0.5) / len(self.choices)
        if self.scale == "log":
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (float(value) - self.low) / (self.high - self.low)

    def slope(self, t: float) -> float:
        """Return the derivative of the value in the coordinate; 0 for a choice."""
        if self.choices:
            return 0.0
        return float(self.value(t)) * math.log(self.high / self.low) if self.scale == "log" else self.high - self.low


class Candidates:
    """Turn coordinates (n,) of unknowns into pairs.

    Parameters
    ----------
    pair : Pair
        Gives all that is not looked for.
    unknowns : sequence of Unknown
    folder : Path
        Folder of the pair file.
    note : str
        Written beside every value found.
    """

    def __init__(self, pair: Pair, unknowns: Sequence[Unknown], folder: Path, note: str = "") -> None:
        self.pair, self.unknowns, self.folder, self.note = pair, tuple(unknowns), folder, note
        self._place = f"pair {pair.name!r} with the values looked for"
        self._raw = tomllib.loads(pair.to_toml())

    def raw(self, t: np.ndarray, name: str | None = None) -> dict[str, Any]:
        """Return the parsed pair file at coordinates (n,)."""
        raw = without_change(self._raw)
        for unknown, at in zip(self.unknowns, t.tolist(), strict=True):
            value = unknown.value(at)
            for key, factor in zip(unknown.keys, unknown.factors, strict=True):
                put(self.pair, raw, key, value if unknown.choices else factor * value, self.note)
        if name is not None:
            raw["name"] = {"value": name, "source": "calibrated", "note": f"{self.pair.name}, {self.note}"}
        return raw

    def at(self, t: np.ndarray, name: str | None = None) -> Pair:
        """Return the pair at coordinates (n,); raises PairError where there is none."""
        return build_pair(self.raw(t, name), self._place, self.folder)

    def states(self, t: np.ndarray) -> dict[str, Dimensionless]:
        """Return the numbers of all states at coordinates (n,), the same as those of :meth:`at` in a third of its time.

        Raises
        ------
        PairError
            Where there is no pair.
        """
        tables = read_file(self.raw(t), self._place)
        if isinstance(tables, DimensionlessFile):
            found = given_states(tables, given_series(tables))
        else:
            derived = derive(tables, self.folder)
            found = physical_states(tables, derived, physical_series(tables, derived, self.folder))
        return {d.state: d for d in found}

    def slopes(self, t: np.ndarray, states: Iterable[str], numbers: Numbers) -> dict[str, np.ndarray]:
        """Return the derivative (parameters, n) of the numbers of every state in the coordinates.

        By central differences of the closed formulas between file and equations; choices have none. ``numbers`` takes
        a :class:`Dimensionless` to an array (parameters,).
        """
        names = tuple(dict.fromkeys(states))
        columns: dict[str, list[np.ndarray]] = {state: [] for state in names}
        for i, unknown in enumerate(self.unknowns if names else ()):
            reach = np.zeros(len(t))
            reach[i] = 0.0 if unknown.choices else _STEP
            high, low = self.states(t + reach), self.states(t - reach)
            for state in names:
                change = numbers(high[state]) - numbers(low[state])
                columns[state].append(change / (2 * _STEP))
        return {state: np.column_stack(found) for state, found in columns.items()}

    def given(self) -> np.ndarray:
        """Return the coordinates (n,) of the values that the pair has, inside 0..1; NaN where it has none."""
        out = []
        for unknown in self.unknowns:
            out.append(self._given(unknown))
        return np.array(out)

    def _given(self, unknown: Unknown) -> float:
        value = current(self.pair, self._raw, unknown.keys[0])
        if value is None:
            return math.nan
        if unknown.choices:
            return unknown.coordinate(value) if value in unknown.choices else math.nan
        if unknown.unit:
            from sbg_casadi.units import parse_quantity

            value = parse_quantity(value[0] if isinstance(value, list) else value, unknown.unit)[0]
        value = float(value) / unknown.factors[0]
        if unknown.scale == "log" and value <= 0:
            return math.nan
        return float(np.clip(unknown.coordinate(value), 0.0, 1.0))
