"""Rows for what nobody can check with the paper alone, and that no model can stand in for."""

from __future__ import annotations

from sbg_casadi.paper.printed import PAIRS
from sbg_casadi.paper.row import Kind, Row, number, unchecked

_OPEN: tuple[tuple[str, str, Kind, str, str, str], ...] = (
    ("validation", "Figure 2; section 3", "figure", "close agreement with the RMS curve of reference [19]",
     "close agreement", "neither curve is printed as numbers, nor the parameters of that run."),
    ("constant-bearings", "Section 3", "sentence", "bearing stiffness is the same constant in all four cases",
     "constant", "no bearing stiffness is printed."),
    ("conversion", "Section 4", "sentence", "mesh stiffness is converted from a graph of the transmission error",
     "K_m from the graph", "neither the graphs nor the rule of conversion are printed; F_n over the loaded error alone "
     "would count the unloaded error twice."),
    ("mid-section", "Tables 2-5; List of symbols", "table", "the base radii hold at the mid-section", "mid-section",
     "the section in which the module holds and the face width are not printed."),
    ("methods", "Table 1; section 1", "table", "cases 1 and 2 have topology modifications, 3 and 4 flank ones",
     "topology, flank", "section 1 calls the first 'ease-off flank modification' with an 'ease-off topography' and the "
     "second 'flank topography', and says neither of cases 3 and 4."),
    ("year-case3", "Table 1", "table", "year of the source of case3", "2018", "section 1 does not name it."),
    ("directions", "Section 2", "sentence", "x, y and z are the lateral, longitudinal and torsional directions",
     "names of axes", "Figure 1 is not available as numbers, and (1)-(6) have a displacement along each axis."),
    ("parameters", "Section Numerical Results", "sentence", "parameters are those of reference [16], adjusted",
     "minor adjustments", "neither parameters nor adjustments are printed."),
    ("both-directions", "Section Numerical Results", "sentence", "forward and backward runs capture all responses",
     "all responses", "two sweeps can miss a response that no sweep leads to; start values and steps are not printed."),
    ("reading-of-rms", "Figures 7, 9, 12, 16", "figure", "RMS of the dynamic transmission error", "0.08 to 0.68",
     "whether the mean is taken off is not said; with the mean in it, contact keeps it near or above 1, so it is taken "
     "off here."),
    ("same-regions", "Figure 14", "figure", "behaviour stays suspicious in the same regions as before",
     "regions 1-4", "region 3 is at 1.7 before, and nothing is printed there after the modification."),
    ("earlier-work", "Section 1", "sentence", "a method of 2019 reduces RMS by 44 % and peak-to-peak error by 35 %",
     "44 %, 35 %", "the numbers are those of another paper."),
    ("manufacture", "Discussion; Conclusions", "sentence", "the modifications can be made by milling and grinding",
     "feasible", "no modification is described by numbers."),
    ("lifespan", "Abstract; Conclusions", "sentence", "the modifications improve the lifespan of the gears",
     "longer life", "no life is computed."),
    ("surface-deviation", "Abstract", "sentence", "less tooth surface deviation reduces vibration", "reduces",
     "no surface deviation is printed."),
)  # fmt: skip


def open_rows() -> list[Row]:
    """Return the rows that rest on nothing printed.

    Examples
    --------
    >>> {r.verdict for r in open_rows()}
    {'not checkable'}
    """
    rows = [unchecked(key, place, kind, text, printed, reason) for key, place, kind, text, printed, reason in _OPEN]
    for case, table in PAIRS.items():
        place = f"Table {table.number}"
        teeth = f"{table.teeth[0]} and {table.teeth[1]}"
        for name, printed, reason in (
            ("teeth", teeth, "an input, taken as printed."),
            ("module", f"{table.module} mm", "an input, taken as outer transverse, which is not printed."),
            ("pressure angle", f"{table.pressure_angle} deg", "an input, taken as normal, which is not printed."),
            ("torque", f"{table.torque} N m", "the member it acts on is not printed; the load differs by the ratio."),
        ):
            key = f"{name.replace(' ', '-')}-{case}"
            rows.append(unchecked(key, place, "table", f"{name} of {case}", printed, reason, "as printed"))
        share = 100 * float(table.backlash) / float(table.module)
        rows.append(
            unchecked(
                f"backlash-{case}", place, "table", f"backlash of {case}", f"{table.backlash} mm",
                f"its plane is not printed; it is {share:.1f} % of the module, where 3 to 6 % are usual.",
                f"{number(share)} % of the module",
            )
        )  # fmt: skip
    return rows
