"""Figures of the paper's diagrams from the parts of a case; every one is drawn from the numbers that are written."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from continuation.plotting import LINE_STYLE, MARKER
from sbg_casadi.paper.plan import STATES

Parts = Mapping[str, Any]

COLOURS = {"before": "black", "after": "#d95f02"}
"""They differ in grey, too."""

RATIO = "frequency ratio omega_m / omega_n"
RMS = "RMS of lambda about its mean / half backlash"
_DPI = 110


def png(figure: Figure) -> bytes:
    """Return a figure as the bytes of a PNG file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=_DPI, metadata={"Software": None})  # no version: equal runs, equal bytes
    return stream.getvalue()


def blank(width: float, height: float) -> Figure:
    """Return an empty figure, inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def plot_stiffness(case: Parts, *, ax: Axes) -> Axes:
    """Draw the mesh stiffness over one cycle before and after, in N/um where its mean is known."""
    scale = None
    for state in STATES:
        part = case[state].get("stiffness")
        if part:
            scale = part["mean"]
            values = np.array(part["value"]) * (1.0 if scale is None else scale / 1e6)
            ax.plot(part["phase"], values, "-" if state == "before" else "--", color=COLOURS[state], label=state)
    unit = "its mean" if scale is None else "(N/um)"
    ax.set(xlabel="mesh cycle", ylabel=f"mesh stiffness / {unit}", title="mesh stiffness")
    ax.legend(loc="best", fontsize="small")
    return ax


def stability_pieces(points: Sequence[Parts]) -> list[tuple[str, list[float], list[float]]]:
    """Return stability, frequency ratios and RMS of the pieces of a branch; neighbours share their end.

    Examples
    --------
    >>> rows = [{"frequency_ratio": f, "rms": 0.1, "stability": s} for f, s in
    ...         [(1.0, "stable"), (1.1, "stable"), (1.2, "unstable")]]
    >>> [(s, x) for s, x, _ in stability_pieces(rows)]
    [('stable', [1.0, 1.1]), ('unstable', [1.1, 1.2])]
    """
    pieces: list[tuple[str, list[float], list[float]]] = []
    for a, b in pairwise(points):
        kind = a["stability"] if a["stability"] == b["stability"] else b["stability"]
        if not pieces or pieces[-1][0] != kind:
            pieces.append((kind, [a["frequency_ratio"]], [a["rms"]]))
        pieces[-1][1].append(b["frequency_ratio"])
        pieces[-1][2].append(b["rms"])
    return pieces


def plot_rms(case: Parts, *, ax: Axes) -> Axes:
    """Draw RMS over frequency ratio: traced branches as lines over the dots of the sweeps up and down."""
    for state in STATES:
        colour = COLOURS[state]
        for number, entry in enumerate((case[state].get("sweeps") or {}).get("sweeps", ())):
            x, y = ([p[k] for p in entry["points"]] for k in ("frequency_ratio", "rms"))
            y = [np.nan if v is None else v for v in y]
            mark, size = ((".", 3.0), ("o", 4.5))[number]
            label = f"{state}, sweep {entry['direction']}"
            ax.plot(x, y, mark, color=colour, markersize=size, fillstyle="none", markeredgewidth=0.5, label=label)
        for n, branch in enumerate((case[state].get("response") or {}).get("branches", ())):
            for i, (kind, x, y) in enumerate(stability_pieces(branch["points"])):
                name = f"{state}, branch" if n == i == 0 else None
                ax.plot(x, y, LINE_STYLE[kind], color=colour, linewidth=1.0, label=name)  # type: ignore[index]
            _marks(branch, colour, ax)
    ax.set(xlabel=RATIO, ylabel=RMS, title="RMS of the dynamic transmission error")
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="best", fontsize="x-small")
    return ax


def _marks(branch: Parts, colour: str, ax: Axes) -> None:
    for kind, marker in MARKER.items():
        inside = [p for p in branch["special_points"] if p["kind"] == kind and kind != "grazing"]
        if inside:
            x, y = ([p[k] for p in inside] for k in ("frequency_ratio", "rms"))
            (line,) = ax.plot(x, y, linestyle="none", color=colour, zorder=4)
            line.set(marker=marker, markersize=5, markerfacecolor="white")


def plot_bifurcation(parts: Parts, state: str, *, ax: Axes) -> Axes:
    """Draw lambda at phase 0 of every mesh period over the frequency ratio, with the located doublings as lines."""
    for number, entry in enumerate((parts.get("sweeps") or {}).get("sweeps", ())):
        x = [p["frequency_ratio"] for p in entry["points"] for _ in p["poincare"]]
        y = [v for p in entry["points"] for v in p["poincare"]]
        colour, mark, size = (("black", ".", 1.5), ("#d95f02", "o", 2.5))[number]
        ax.plot(x, y, mark, color=colour, markersize=size, fillstyle="none", markeredgewidth=0.4,
                label=f"sweep {entry['direction']}")  # fmt: skip
    drawn: set[str] = set()
    for branch in (parts.get("response") or {}).get("branches", ()):
        for point in branch["special_points"]:
            if point["kind"] == "period-doubling":
                n = branch["period_multiple"]
                label, style = f"doubling {n} to {2 * n}", "--" if n == 1 else ":"
                name = None if label in drawn else label
                ax.axvline(point["frequency_ratio"], color="#7570b3", linewidth=0.9, linestyle=style, label=name)
                drawn.add(label)
    ax.set(xlabel=RATIO, ylabel="lambda at phase 0 / half backlash", title=f"bifurcation diagram, {state}")
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="best", fontsize="x-small")
    return ax


def plot_factor(case: Parts, *, ax: Axes) -> Axes:
    """Draw the dynamic factor of the sweeps before and after."""
    for state in STATES:
        for number, entry in enumerate((case[state].get("sweeps") or {}).get("sweeps", ())):
            x, y = ([p[k] for p in entry["points"]] for k in ("frequency_ratio", "dynamic_factor"))
            y = [np.nan if v is None else v for v in y]
            label = f"{state}, sweep {entry['direction']}"
            ax.plot(x, y, ("-", ":")[number], color=COLOURS[state], linewidth=1.0, label=label)
    ax.set(xlabel=RATIO, ylabel="largest over mean mesh force", title="dynamic factor")
    if ax.get_legend_handles_labels()[0]:
        ax.legend(loc="best", fontsize="x-small")
    return ax


def plot_least(case: Parts, *, ax: Axes) -> Axes:
    """Draw the curves of folds and doublings over frequency ratio and amount of modification."""
    styles = {"fold": ("-", "black"), "period-doubling": ("--", "#d95f02")}
    drawn: set[str] = set()
    for curve in (case.get("least") or {}).get("curves", ()):
        style, colour = styles[curve["kind"]]
        label = curve["kind"]
        name = None if label in drawn else label
        drawn.add(label)
        ax.plot(curve["frequency_ratio"], curve["value"], style, color=colour, linewidth=1.2, label=name)
    ax.set(
        xlabel=RATIO, ylabel="amount of modification", ylim=(0, 1), title="folds and doublings over the modification"
    )
    if drawn:
        ax.legend(loc="best", fontsize="x-small")
    else:
        ax.text(0.5, 0.5, "no fold and no doubling", ha="center", transform=ax.transAxes)
    return ax


def overview(case: Parts, name: str) -> Figure:
    """Return the figure of one case before and after the modification, six panels."""
    figure = blank(11.0, 12.0)
    axes = figure.subplots(3, 2).ravel()
    plot_stiffness(case, ax=axes[0])
    plot_rms(case, ax=axes[1])
    for ax, state in zip(axes[2:4], STATES, strict=True):
        plot_bifurcation(case[state], state, ax=ax)
    plot_factor(case, ax=axes[4])
    plot_least(case, ax=axes[5])
    figure.suptitle(f"{name} before and after the modification")
    return figure


def one_panel(plot: Any, *arguments: Any) -> Figure:
    """Return a figure with one diagram."""
    figure = blank(8.0, 4.6)
    plot(*arguments, ax=figure.subplots())
    return figure


def motions_figure(part: Parts, state: str) -> Figure:
    """Return Poincare maps beside phase portraits, one row for each motion at the paper's frequencies."""
    rows = [(f["frequency_ratio"], m) for f in part["frequencies"] for m in f["motions"]]
    figure = blank(8.5, 2.6 * len(rows))
    axes = figure.subplots(len(rows), 2, squeeze=False)
    for (left, right), (ratio, motion) in zip(axes, rows, strict=True):
        strobe, portrait = np.array(motion["strobe"]), np.array(motion["portrait"])
        left.plot(strobe[:, 0], strobe[:, 1], ".", color="black", markersize=2.5)
        right.plot(portrait[:, 0], portrait[:, 1], color="black", linewidth=0.5)
        left.set(xlim=right.get_xlim(), ylim=right.get_ylim())  # a single point has no scale of its own
        left.set_title(f"{ratio:g}, {state}: {motion['verdict']}", fontsize="medium")
        right.set_title(f"reached {', '.join(motion['reached'])}", fontsize="medium")
        for ax in (left, right):
            ax.set(xlabel="lambda / half backlash", ylabel="rate in tau")
    return figure


def plot_stiff(part: Parts, *, ax: Axes) -> Axes:
    """Draw the RMS of the oscillator with one degree of freedom as a line, that with stiff bearings as marks."""
    ax.plot(part["curve"]["frequency_ratio"], part["curve"]["rms"], "-", color="black", label="one degree of freedom")
    for curve, mark in zip(part["stiff"], ("x", "o", "s"), strict=False):
        y = [np.nan if v is None else v for v in curve["rms"]]
        label = f"bearings {curve['factor']:g} times as stiff"
        ax.plot(part["frequency_ratio"], y, mark, color="#d95f02", markersize=5, fillstyle="none", label=label)
    ax.set(xlabel=RATIO, ylabel=RMS, title="limit of stiff bearings")
    ax.legend(loc="best", fontsize="small")
    return ax
