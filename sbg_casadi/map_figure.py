"""The figure of a map: attractors as shades, one panel for each sweep direction, special points as curves."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

SHADES = (
    ("period 1", "#ffffff"),
    ("period 2", "#d0e1f2"),
    ("period 4", "#94c4df"),
    ("other periods", "#4a98c9"),
    ("quasi-periodic", "#d9b26f"),
    ("chaotic", "#7a1f2b"),
    ("not recognised", "#b0b0b0"),
    ("failed", "#303030"),
)
"""What is shaded how; lightness falls from period 1 to chaos, so that it reads in grey."""

CURVES = {
    ("fold", 1): ("folds", "black", "-"),
    ("period-doubling", 1): ("doublings 1 to 2", "#08519c", "--"),
    ("period-doubling", 2): ("doublings 2 to 4", "#08519c", ":"),
    ("neimark-sacker", 1): ("torus points", "#8c5109", "-."),
}


def shade(attractor: str, period: int) -> int:
    """Return the position in :data:`SHADES` of an attractor.

    >>> [SHADES[shade(*a)][0] for a in (("periodic", 2), ("periodic", 3), ("chaotic", 0))]
    ['period 2', 'other periods', 'chaotic']
    """
    names = [name for name, _ in SHADES]
    if attractor == "periodic":
        return names.index(f"period {period}") if period in (1, 2, 4) else names.index("other periods")
    return names.index(attractor)


def map_shades(document: Mapping[str, Any]) -> np.ndarray:
    """Return the shades (direction, value, frequency) of a map document as positions in :data:`SHADES`."""
    grid = document["grid"]
    return np.array(
        [
            [[shade(a, n) for a, n in zip(*row, strict=True)] for row in zip(*panel, strict=True)]
            for panel in zip(grid["attractor"], grid["period"], strict=True)
        ]
    )


def plot_map(document: Mapping[str, Any], direction: int, ax: Axes) -> Axes:
    """Draw one panel of a map: the attractors of one sweep direction, and the curves.

    Parameters
    ----------
    document : mapping
        Of a map.
    direction : int
        0 for sweeps up, 1 for sweeps down.
    ax : matplotlib Axes
    """
    grid = document["grid"]
    colours = ListedColormap([c for _, c in SHADES])
    mesh = ax.pcolormesh(
        np.array(grid["frequency_ratio"]),
        np.array(grid["value"]),
        map_shades(document)[direction],
        cmap=colours,
        norm=BoundaryNorm(np.arange(len(SHADES) + 1) - 0.5, len(SHADES)),
        shading="nearest",
    )
    mesh.set_gid("attractors")
    for curve in document["curves"]:
        label, colour, style = CURVES[curve["kind"], curve["period_multiple"]]
        ax.plot(curve["frequency_ratio"], curve["value"], style, color=colour, linewidth=1.3, gid=label)
    least = document["least"]
    if least["value"] is not None:
        ax.axhline(least["value"], color="grey", linewidth=0.8, gid="least")
        (mark,) = ax.plot([least["frequency_ratio"]], [least["value"]], "o", color="black", markersize=5, gid="tip")
        mark.set_zorder(5)
    ax.set_xlim(*sorted(document["range"]))
    ax.set_ylim(*document["span"])
    ax.set_xlabel("frequency ratio omega_m / omega_n")
    ax.set_title(f"sweeps {grid['directions'][direction]}")
    return ax


def map_figure(document: Mapping[str, Any]) -> Figure:
    """Draw a map: one panel for sweeps up, one for sweeps down, and what shades and lines mean."""
    figure = Figure(figsize=(11.0, 6.0), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 2, sharey=True)
    for direction, ax in enumerate(panels):
        plot_map(document, direction, ax)
    over = document["over"]
    panels[0].set_ylabel(over["label"] + (f" / {over['unit']}" if over["unit"] else ""))
    figure.suptitle(f"{document['pair']} over {over['name']}")
    present = {SHADES[i][0] for i in np.unique(map_shades(document))}
    handles: list[Any] = [Patch(facecolor=c, edgecolor="grey", label=n) for n, c in SHADES if n in present]
    drawn = {(c["kind"], c["period_multiple"]) for c in document["curves"]}
    handles += [
        Line2D([], [], color=colour, linestyle=style, label=label)
        for key, (label, colour, style) in CURVES.items()
        if key in drawn
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=6, fontsize="small")
    return figure


def save_map_figure(document: Mapping[str, Any], path: Path) -> None:
    """Write the figure of a map."""
    map_figure(document).savefig(path, dpi=150)
