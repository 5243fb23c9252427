"""The figure of a response or a study: RMS over frequency ratio, rpm of the pinion on the upper axis."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from continuation.branches.branch import Branch
from continuation.plotting import LINE_STYLE, MARKER, new_axes, plot_branch, plot_sweep
from continuation.timedomain.sweep import Sweep
from sbg_casadi.documents import STATE

COLOURS = ("black", "#d95f02", "#7570b3", "#1b9e77")
"""One for each state; black and orange differ also in grey."""


def response_figure(
    title: str,
    branches: Mapping[str, Branch],
    sweeps: Mapping[str, Sequence[Sweep]],
    unit_ratio_rpm: float | None,
) -> Figure:
    """Draw the branches and sweeps of every state in one figure.

    Parameters
    ----------
    title : str
    branches : mapping of state to Branch
    sweeps : mapping of state to sequence of Sweep
        May lack states.
    unit_ratio_rpm : float or None
        Pinion speed in rev/min at frequency ratio 1 for the upper axis; None leaves the axis out.
    """
    ax = new_axes(9.0, 5.5)
    figure = ax.get_figure(root=True)
    assert figure is not None  # new_axes has just made it
    for (state, branch), colour in zip(branches.items(), COLOURS * (1 + len(branches) // len(COLOURS)), strict=False):
        for sweep in sweeps.get(state, ()):
            plot_sweep(sweep, ax=ax, colour=colour)
        plot_branch(branch, STATE, ax=ax, colour=colour, label=state)
    ax.set_xlabel("frequency ratio omega_m / omega_n")
    ax.set_ylabel("RMS of lambda about its mean / half backlash")
    ax.set_ylim(bottom=-0.02 * ax.get_ylim()[1])  # room for marks of small amplitude
    if unit_ratio_rpm is not None:
        rpm = unit_ratio_rpm
        upper = ax.secondary_xaxis("top", functions=(_times(rpm), _times(1 / rpm)))
        upper.set_xlabel("pinion speed / rpm")
    ax.set_title(title)
    ax.legend(handles=_legend(ax, branches, sweeps), loc="best", fontsize="small", frameon=True)
    return figure


def _times(factor: float) -> Callable[[Any], Any]:
    return lambda values: values * factor


def _legend(ax: Axes, branches: Mapping[str, Branch], sweeps: Mapping[str, Sequence[Sweep]]) -> list[Line2D]:
    """Return what the legend shows: states by colour, then line styles and markers that occur, in grey."""
    drawn = {line.get_gid(): line for line in ax.get_lines()}
    handles = [
        Line2D([], [], color=line.get_color(), label=line.get_label())
        for line in ax.get_lines()
        if line.get_label() in branches
    ]
    lines = [Line2D([], [], color="grey", linestyle=s, label=n) for n, s in LINE_STYLE.items() if n in drawn]
    handles += [*lines, *(_mark(marker, kind, "white") for kind, marker in MARKER.items() if kind in drawn)]
    for name in ("sweep up", "sweep down"):
        if name in drawn:
            line = drawn[name]
            handles.append(_mark(str(line.get_marker()), name, "none" if line.get_fillstyle() == "none" else "grey"))
    return handles


def _mark(marker: str, label: str, face: str) -> Line2D:
    return Line2D(
        [], [], linestyle="none", marker=marker, markersize=6, color="grey", markerfacecolor=face, label=label
    )


def save_figure(figure: Figure, folder: Path) -> None:
    """Write ``response.png`` into a folder."""
    figure.savefig(folder / "response.png", dpi=150)
