"""Figures of branches and sweeps; every plot function has a pure one beside it that returns the arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from continuation.branches.branch import CRITICAL, Branch, Kind, SpecialPoint
from continuation.orbits.orbit import Orbit, Stability

if TYPE_CHECKING:
    from continuation.branches.tracked import Curve
    from continuation.timedomain.sweep import Sweep

LINE_STYLE: dict[Stability, str] = {"stable": "-", "unstable": "--", "undecided": ":"}
MARKER: dict[Kind, str] = {
    "fold": "s",
    "period-doubling": "^",
    "neimark-sacker": "D",
    "branch-point": "P",
    "grazing": "X",
    "user": "*",
}
CURVE_STYLE: dict[str, str] = {"fold": "-", "period-doubling": "--", "neimark-sacker": "-.", "grazing": ":"}
CURVE_MARKER: dict[str, str] = {
    "extremum": ".",
    "cusp": "v",
    "generalised-doubling": "o",
    "fold-flip": "*",
    "1:1": "$1$",
    "1:2": "$2$",
    "1:3": "$3$",
    "1:4": "$4$",
}
SWEEP_MARKER: dict[str, tuple[str, Literal["full", "none"]]] = {"up": (".", "full"), "down": ("o", "none")}
"""Marker and fill of a sweep; where both agree a dot lies inside a circle."""

Quantity = str | Callable[[Orbit], float]


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """A piece of a branch of one stability; x is the continuation parameter, y the quantity, both shape (N,)."""

    stability: Stability
    x: np.ndarray
    y: np.ndarray


def branch_segments(branch: Branch, quantity: Quantity) -> list[Segment]:
    """Split a branch where its stability changes, exactly at its special points.

    Parameters
    ----------
    branch : Branch
    quantity : str or callable
        Name of a state, whose root mean square about the mean is meant, or a function of an Orbit.

    Returns
    -------
    list of Segment
        In order along the branch; each begins with the last point of the one before. Every special point is a point
        of the curve. A change of stability without a special point between gives a piece of its own, "undecided".

    Raises
    ------
    ValueError
        If there is no such state.

    Examples
    --------
    >>> import numpy as np
    >>> from continuation.branches.branch import Branch
    >>> from continuation.orbits.orbit import Orbit
    >>> def orbit(g, stability):
    ...     return Orbit(system="s", state_names=("x",), parameter="g", parameters={"g": g}, period=1.0,
    ...                  period_multiple=1, coefficients=np.array([[0j], [g]]), multipliers=np.array([0.5 + 0j]),
    ...                  multiplier_error=np.zeros(1), stability=stability, error=0.0)
    >>> branch = Branch((orbit(0.1, "stable"), orbit(0.2, "stable"), orbit(0.3, "unstable")), (), "", {}, {})
    >>> [(s.stability, s.x.tolist()) for s in branch_segments(branch, "x")]
    [('stable', [0.1, 0.2]), ('undecided', [0.2, 0.3])]
    """
    value = _function(quantity)
    pieces = [piece for i in range(len(branch) - 1) for piece in _pieces(branch, i)]
    segments: list[Segment] = []
    run: list[Orbit] = [branch.orbits[0]]
    for i, (start, end, stability) in enumerate(pieces):
        if i and stability != pieces[i - 1][2]:
            segments.append(_segment(run, pieces[i - 1][2], value))
            run = [start]
        run.append(end)
    segments.append(_segment(run, pieces[-1][2] if pieces else branch.orbits[0].stability, value))
    return segments


def branch_markers(branch: Branch, quantity: Quantity) -> dict[Kind, tuple[np.ndarray, np.ndarray]]:
    """Return parameter and quantity (N,) of the special points of each kind that the branch has."""
    value = _function(quantity)
    markers: dict[Kind, tuple[np.ndarray, np.ndarray]] = {}
    for kind in MARKER:
        points = [p for p in branch.special_points if p.kind == kind]
        if points:
            markers[kind] = np.array([p.parameter for p in points]), np.array([value(p.orbit) for p in points])
    return markers


def plot_branch(
    branch: Branch, quantity: Quantity, *, ax: Axes | None = None, colour: str = "black", label: str | None = None
) -> Axes:
    """Draw a branch: stable solid, unstable dashed, undecided dotted, one marker per kind of special point.

    Parameters
    ----------
    branch : Branch
    quantity : str or callable
        Name of a state, whose root mean square about the mean is drawn, or a function of an Orbit.
    ax : matplotlib Axes, optional
        Where to draw; a new figure when absent.
    colour : str
        Colour of lines and markers.
    label : str, optional
        Name of the branch in a legend.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    ValueError
        If there is no such state.
    """
    ax = new_axes() if ax is None else ax
    for i, segment in enumerate(branch_segments(branch, quantity)):
        style = LINE_STYLE[segment.stability]
        name = label if i == 0 else None
        ax.plot(segment.x, segment.y, style, color=colour, linewidth=1.2, label=name, gid=segment.stability)
    for kind, (x, y) in branch_markers(branch, quantity).items():
        (marks,) = ax.plot(x, y, linestyle="none", color=colour, gid=kind)
        marks.set(marker=MARKER[kind], markersize=6, markerfacecolor="white", zorder=4)
    ax.set_xlabel(branch.parameter_name)
    ax.set_ylabel(f"RMS of {quantity} about its mean" if isinstance(quantity, str) else quantity.__name__)
    return ax


def plot_curve(curve: Curve, *, ax: Axes | None = None, colour: str = "black", label: str | None = None) -> Axes:
    """Draw a tracked special point in the plane of its two parameters, with its points of codimension two.

    Parameters
    ----------
    curve : Curve
    ax : matplotlib Axes, optional
        Where to draw; a new figure when absent.
    colour : str
        Colour of line and markers.
    label : str, optional
        Name of the curve in a legend.

    Returns
    -------
    matplotlib Axes
    """
    ax = new_axes() if ax is None else ax
    ax.plot(*curve.values.T, CURVE_STYLE.get(curve.kind, "-"), color=colour, linewidth=1.2, label=label, gid=curve.kind)
    for point in curve.points:
        (marks,) = ax.plot(*point.parameters, linestyle="none", color=colour, gid=point.kind)
        marks.set(marker=CURVE_MARKER[point.kind], markersize=6, markerfacecolor="white", zorder=4)
    ax.set_xlabel(curve.parameters[0])
    ax.set_ylabel(curve.parameters[1])
    return ax


def sweep_direction(sweep: Sweep) -> str:
    """Return "up" for a sweep in the order of increasing values, else "down"."""
    return "up" if sweep.values[-1] >= sweep.values[0] else "down"


def plot_sweep(sweep: Sweep, *, ax: Axes | None = None, colour: str = "black", label: str | None = None) -> Axes:
    """Draw the root mean square of a sweep against its parameter: dots for a sweep up, circles for one down.

    Parameters
    ----------
    sweep : Sweep
        Values at which the integrator failed leave no mark.
    ax : matplotlib Axes, optional
        Where to draw; a new figure when absent.
    colour : str
        Colour of the marks.
    label : str, optional
        Name of the sweep in a legend.

    Returns
    -------
    matplotlib Axes
    """
    ax = new_axes() if ax is None else ax
    direction = sweep_direction(sweep)
    marker, fill = SWEEP_MARKER[direction]
    (line,) = ax.plot(sweep.values, sweep.rms, color=colour, label=label, gid=f"sweep {direction}")
    line.set(linestyle="none", marker=marker, markersize=4, markeredgewidth=0.6, fillstyle=fill)
    ax.set_xlabel(sweep.parameter)
    ax.set_ylabel(f"RMS of {sweep.quantity} about its mean")
    return ax


def new_axes(width: float = 8.0, height: float = 5.0) -> Axes:
    """Return the axes of a new figure of that size in inches, drawn without a window or any global state."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure.add_subplot()


# -------------------------------------------------------------------------------------------- stability along a branch
Piece = tuple[Orbit, Orbit, Stability]


def _pieces(branch: Branch, i: int) -> list[Piece]:
    """Return the pieces between branch points i and i + 1, cut at the special points between them."""
    before, after = branch.orbits[i], branch.orbits[i + 1]
    points = [p for p in branch.special_points if p.index == i]
    if not points:
        return [(before, after, _between(before.stability, after.stability))]
    nodes = [before, *(p.orbit for p in points), after]
    if not any(CRITICAL[p.kind] for p in points):
        verdicts = [_between(before.stability, after.stability)] * (len(points) + 1)
    else:
        verdicts = [before.stability, *_inside(before, points), after.stability]
    return list(zip(nodes[:-1], nodes[1:], verdicts, strict=True))


def _between(before: Stability, after: Stability) -> Stability:
    """Return the verdict of a piece that no special point explains: what both ends agree on, else undecided."""
    return before if before == after else "undecided"


def _inside(before: Orbit, points: Sequence[SpecialPoint]) -> list[Stability]:
    """Return the verdicts between special points of one step, from the count of unstable multipliers.

    At a special point the critical multipliers (one, or a pair) lie on the unit circle and n others outside it; on
    one side the count is n, on the other n plus the critical ones.
    """
    count = int(np.sum(np.abs(before.multipliers) > 1))
    verdicts: list[Stability] = []
    for point in points[:-1]:
        critical = CRITICAL[point.kind]
        outside = np.abs(np.abs(point.multipliers) - 1)
        others = np.delete(np.abs(point.multipliers), np.argsort(outside)[:critical])
        if critical:
            count = 2 * int(np.sum(others > 1)) + critical - count
        verdicts.append("unstable" if count > 0 else "stable" if count == 0 else "undecided")
    return verdicts


def _segment(run: Sequence[Orbit], stability: Stability, value: Callable[[Orbit], float]) -> Segment:
    return Segment(stability, np.array([o.value for o in run]), np.array([value(o) for o in run]))


def _function(quantity: Quantity) -> Callable[[Orbit], float]:
    return quantity if callable(quantity) else lambda orbit: orbit.rms(quantity)
