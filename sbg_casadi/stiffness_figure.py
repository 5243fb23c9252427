"""The figure of measured mesh stiffness: samples with truncated series, and the spectrum, before and after together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from sbg_casadi.figure import COLOURS
from sbg_casadi.mesh import fourier_series

_LINES = ("-", "--", "-.", ":")
_MARKERS = ("o", "s", "^", "D")
_POINTS = 401


def series_curve(table: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return mesh phase (cycles) and truncated series (N/m) over one mesh cycle, shape (401,) each.

    Parameters
    ----------
    table : mapping
        One of the tables of a stiffness document.
    """
    phase = np.linspace(0.0, 1.0, _POINTS)
    wave = fourier_series(table["stiffness_cosine"], table["stiffness_sine"], 2 * np.pi * phase)
    return phase, table["mean"] * (1.0 + wave)


def plot_stiffness(tables: Sequence[Mapping[str, Any]], *, ax: Axes) -> Axes:
    """Draw samples as marks and the truncated series as a line for each table, in N/um over the mesh phase."""
    for table, colour, line, mark in zip(tables, cycle(COLOURS), cycle(_LINES), cycle(_MARKERS), strict=False):
        folded = np.mod(table["phase"], 1.0)
        samples = np.asarray(table["samples"]) / 1e6
        ax.plot(folded, samples, mark, color=colour, markersize=3.5, fillstyle="none", label=f"{table['name']}, table")
        phase, values = series_curve(table)
        label = f"{table['name']}, {table['harmonics']} harmonics"
        ax.plot(phase, values / 1e6, line, color=colour, label=label)
    ax.set_xlabel("mesh phase / mesh cycle")
    ax.set_ylabel("mesh stiffness / (N/um)")
    ax.legend(loc="best", fontsize="small")
    return ax


def plot_spectrum(tables: Sequence[Mapping[str, Any]], *, ax: Axes) -> Axes:
    """Draw the amplitude of each harmonic over the mean, one bar beside the other for the tables."""
    width = 0.8 / len(tables)
    for i, (table, colour) in enumerate(zip(tables, cycle(COLOURS), strict=False)):
        order = np.arange(1, table["harmonics"] + 1)
        heights = np.hypot(table["stiffness_cosine"], table["stiffness_sine"])
        ax.bar(order + (i + 0.5) * width - 0.4, heights, width, color=colour, label=table["name"])
    ax.set_xlabel("harmonic of the mesh frequency")
    ax.set_ylabel("amplitude / mean stiffness")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.legend(loc="best", fontsize="small")
    return ax


def save_stiffness_figure(title: str, tables: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the figure with both plots to a file."""
    figure = Figure(figsize=(8.0, 8.0), layout="constrained")
    FigureCanvasAgg(figure)
    upper, lower = figure.subplots(2, 1)
    plot_stiffness(tables, ax=upper)
    plot_spectrum(tables, ax=lower)
    upper.set_title(title)
    figure.savefig(path, dpi=150)
