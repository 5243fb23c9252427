"""All figures of a run in the order of the paper, each with its name, heading and bytes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from sbg_casadi.paper import figures as draw
from sbg_casadi.paper.model_rows import FIGURES
from sbg_casadi.paper.plan import STATES

_MAPS = {("case3", "before"): "Figure 13", ("case3", "after"): "Figure 15", ("case4", "before"): "Figure 18",
         ("case4", "after"): "Figure 20"}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Picture:
    """One figure.

    Attributes
    ----------
    name : str
        File name, ``.png``.
    case : str
        Case it belongs to, empty for Figure 2.
    heading : str
        What it shows and which figure of the paper that is.
    data : bytes
        PNG.
    """

    name: str
    case: str
    heading: str
    data: bytes


def gallery(cases: Mapping[str, Any], stiff: Mapping[str, Any] | None) -> list[Picture]:
    """Return the figures of what could be computed.

    Parameters
    ----------
    cases : mapping
        Parts by case.
    stiff : mapping or None
        The stiff-bearing part.
    """
    found = []
    if stiff is not None:
        image = draw.png(draw.one_panel(draw.plot_stiff, stiff))
        found.append(Picture("stiff-bearings.png", "", "Figure 2: very stiff bearings", image))
    for case, parts in cases.items():
        found += _of_case(case, parts)
    return found


def _of_case(case: str, parts: Mapping[str, Any]) -> list[Picture]:
    places = FIGURES[case]
    heads = case if parts["pair"] == case else f"{case}, {parts['pair']}"

    def picture(name: str, place: str, text: str, figure: Any) -> Picture:
        return Picture(f"{case}-{name}.png", case, f"{place}: {text} ({heads})", draw.png(figure))

    found = [picture("overview", "Overview", "before and after", draw.overview(parts, heads))]
    if any(parts[s].get("stiffness") for s in STATES):
        figure = draw.one_panel(draw.plot_stiffness, parts)
        found.append(picture("stiffness", places["stiffness"], "mesh stiffness", figure))
    if any(parts[s].get("sweeps") or parts[s].get("response") for s in STATES):
        figure = draw.one_panel(draw.plot_rms, parts)
        found.append(picture("rms", places["RMS"], "RMS over the frequency ratio", figure))
    for state in STATES:
        if parts[state].get("sweeps"):
            figure = draw.one_panel(draw.plot_bifurcation, parts[state], state)
            found.append(picture(f"bifurcation-{state}", places[state], f"bifurcation diagram, {state}", figure))
        part = parts[state].get("motions")
        if part and part["frequencies"]:
            place = _MAPS[case, state]
            text = f"Poincare maps and phase portraits, {state}"
            found.append(picture(f"motions-{state}", place, text, draw.motions_figure(part, state)))
    return found
