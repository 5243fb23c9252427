"""The figure of a Floquet report: multipliers in the unit circle, the orbit in the phase plane, its waveform."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from continuation.plotting import new_axes
from sbg_casadi.documents import STATE
from sbg_casadi.stability_numbers import FLANKS

Document = Mapping[str, Any]

SHADE = {"drive": "none", "free": "0.88", "coast": "0.7"}
"""Background of contact intervals; drive, the usual one, has none."""

LINE = {"drive": "-", "free": (0, (4, 1.5)), "coast": (0, (1, 1))}
_VISIBLE = 0.01  # error bars below this radius are smaller than the mark


def multiplier_marks(document: Document) -> tuple[np.ndarray, np.ndarray]:
    """Return all multipliers (n,), both of every pair, and their error bars (n,); infinity for an unknown one."""
    values, bars = [], []
    for row in document["multipliers"]:
        mu = complex(*row["multiplier"])
        both = [mu, mu.conjugate()] if row["pair"] else [mu]
        values += both
        bars += [np.inf if row["error"] is None else row["error"]] * len(both)
    return np.array(values), np.array(bars)


def contact_intervals(document: Document) -> list[tuple[str, float, float]]:
    """Return flank, first and last phase in degrees of the contact intervals, cut at 0 and 360.

    Examples
    --------
    >>> contact_intervals({"contact": [{"flank": "free", "from_deg": 300.0, "to_deg": 400.0}]})
    [('free', 300.0, 360.0), ('free', 0.0, 40.0)]
    """
    found = []
    for row in document["contact"]:
        name, start, end = row["flank"], row["from_deg"], row["to_deg"]
        found.append((name, start, min(end, 360.0)))
        if end > 360.0:
            found.append((name, 0.0, end - 360.0))
    return found


def phase_plane(document: Document) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Return flank, deflection and its rate of the pieces of an orbit, cut where it passes -1 and 1.

    Shape (N,) each; neighbouring pieces share the point at which the contact changes.
    """
    wave = document["waveform"]
    x, v = wave["deflection"], wave["rate"]
    pieces: list[tuple[str, np.ndarray, np.ndarray]] = []
    run: list[tuple[float, float]] = [(x[0], v[0])]
    for i in range(1, len(x)):
        for level in sorted((-1.0, 1.0), reverse=x[i] < x[i - 1]):
            if (x[i - 1] > level) != (x[i] > level):
                part = (level - x[i - 1]) / (x[i] - x[i - 1])
                run.append((level, v[i - 1] + part * (v[i] - v[i - 1])))
                pieces.append(_piece(run))
                run = [run[-1]]
        run.append((x[i], v[i]))
    return [*pieces, _piece(run)]


def _piece(run: list[tuple[float, float]]) -> tuple[str, np.ndarray, np.ndarray]:
    x, v = np.array(run).T
    return FLANKS[int(np.searchsorted((-1.0, 1.0), x.mean()))], x, v


def plot_multipliers(document: Document, *, ax: Axes | None = None) -> Axes:
    """Draw the multipliers and the unit circle: inside full, outside open; error bars that can be seen as circles."""
    ax = new_axes() if ax is None else ax
    mu, bars = multiplier_marks(document)
    ax.add_patch(Circle((0, 0), 1.0, fill=False, edgecolor="black", linewidth=1.0, gid="unit circle"))
    for inside, face in ((True, "black"), (False, "white")):
        marked = mu[(np.abs(mu) <= 1) == inside]
        (line,) = ax.plot(marked.real, marked.imag, "o", color="black", gid="inside" if inside else "outside")
        line.set(markersize=5, markerfacecolor=face, zorder=4)
    for value, bar in zip(mu.tolist(), bars.tolist(), strict=True):
        if _VISIBLE < bar < np.inf:
            centre = (value.real, value.imag)
            ax.add_patch(Circle(centre, bar, fill=False, edgecolor="grey", linewidth=0.8, gid="error bar"))
    ax.axhline(0.0, color="0.6", linewidth=0.5, zorder=0)
    ax.axvline(0.0, color="0.6", linewidth=0.5, zorder=0)
    reach = 1.1 * max(1.0, float(np.abs(mu).max(initial=0.0)))
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    ax.set_xlabel("Re of multiplier")
    ax.set_ylabel("Im of multiplier")
    return ax


def plot_phase_plane(document: Document, *, ax: Axes | None = None) -> Axes:
    """Draw the rate of lambda - e over lambda - e: drive solid, free dashed, coast dotted, contact limits as lines."""
    ax = new_axes() if ax is None else ax
    seen: set[str] = set()
    for flank, x, v in phase_plane(document):
        label = None if flank in seen else flank
        ax.plot(x, v, color="black", linestyle=LINE[flank], linewidth=1.2, label=label, gid=flank)
        seen.add(flank)
    low, high = ax.get_xlim()
    for level in (-1.0, 1.0):
        if low <= level <= high:
            ax.axvline(level, color="0.5", linewidth=0.8, gid="contact limit")
    ax.set_xlabel("lambda - e / half backlash")
    ax.set_ylabel("its rate in tau = omega_n t")
    ax.legend(loc="best", fontsize="small")
    return ax


def plot_waveform(document: Document, *, ax: Axes | None = None) -> Axes:
    """Draw lambda over one mesh cycle in half backlashes, the intervals without drive contact shaded."""
    ax = new_axes() if ax is None else ax
    seen: set[str] = set()
    for flank, start, end in contact_intervals(document):
        if SHADE[flank] != "none":
            label = None if flank in seen else f"{flank}, shaded"
            ax.axvspan(start, end, color=SHADE[flank], linewidth=0, label=label, gid=flank)
            seen.add(flank)
    wave = document["waveform"]
    ax.plot(wave["phase_deg"], wave[STATE], color="black", linewidth=1.2, gid=STATE)
    ax.set(xlim=(0.0, 360.0), xticks=range(0, 361, 60))
    ax.set_xlabel("mesh phase / deg")
    ax.set_ylabel("lambda / half backlash")
    if seen:
        ax.legend(loc="best", fontsize="small")
    return ax


def stability_figure(document: Document) -> Figure:
    """Return the three plots side by side."""
    figure = Figure(figsize=(13.0, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    left, middle, right = figure.subplots(1, 3)
    plot_multipliers(document, ax=left)
    plot_phase_plane(document, ax=middle)
    plot_waveform(document, ax=right)
    figure.suptitle(
        f"{document['pair']}, {document['state']}: orbit {document['branch']} of {len(document['orbits'])} "
        f"at frequency ratio {document['frequency_ratio']:.10g}, {document['stability']}"
    )
    return figure


def save_stability_figure(document: Document, path: Path) -> None:
    """Write the figure to a file."""
    stability_figure(document).savefig(path, dpi=150)
