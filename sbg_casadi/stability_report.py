"""Text of a Floquet report, made from the same document that is written as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rich.table import Table
from rich.text import Text

from sbg_casadi.documents import STATE
from sbg_casadi.report import amplitude, assumed_table, plain_table, ratio, reading_words, small, speed

if TYPE_CHECKING:
    from rich.console import RenderableType

Document = Mapping[str, Any]

KINDS = {
    "fold": "fold (jump)",
    "period-doubling": "period-doubling",
    "neimark-sacker": "Neimark-Sacker (torus)",
    "branch-point": "branch point",
    "grazing": "grazing (a contact interval comes or goes)",
}
_TYPES = {
    "fold": "real and above +1, as beyond a fold: a small disturbance grows without changing sides",
    "period-doubling": "real and below -1, as beyond a period-doubling: it changes sides every mesh period",
    "neimark-sacker": "a complex pair, as beyond a Neimark-Sacker point: a second frequency appears",
}


def stability_report(document: Document) -> list[RenderableType]:
    """Return the printable report of a stability document."""
    head = f"{document['pair']}, state {document['state']}: period-1 orbit at frequency ratio "
    head += f"{document['frequency_ratio']:.10g}{_rpm(document['pinion_rpm'])}, exact backlash law"
    parts: list[RenderableType] = [Text(head + reading_words(document), style="bold")]
    parts += [Text(f"FINISHED IN PART: {text}", style="bold red") for text in document["failures"]]
    parts += [_orbits(document), *(Text(line) for line in _choice(document)), _heading("stability")]
    parts += [Text(line) for line in _verdict(document)]
    for title, table in (
        ("multipliers over one mesh period", _multipliers(document)),
        ("along the branch from this orbit", _around(document)),
        ("contact over the mesh cycle", _contact(document)),
    ):
        parts += [_heading(title), table]
    parts += [Text(_shares(document)), _heading("waveform of lambda"), *(Text(line) for line in _waveform(document))]
    parts += [_harmonics(document), _heading("agreement of methods"), *(Text(line) for line in _agreement(document))]
    parts += [Text(f"unresolved on the branch: {text}") for text in document["unresolved"]]
    if document["assumed"]:
        parts += [_heading("assumed"), assumed_table(document["assumed"])]
    return [*parts, *(Text(line) for line in _explanation(document))]


def _heading(title: str) -> Text:
    return Text(f"\n{title}", style="bold")


def _rpm(rpm: float | None) -> str:
    return "" if rpm is None else f" ({speed(rpm)} rpm of the pinion)"


def distance(value: float) -> str:
    """Return a signed distance in frequency ratio as text: 10 decimals, fewer digits where that shows none.

    Examples
    --------
    >>> distance(0.0576292998), distance(-2.5e-11)
    ('+0.0576292998', '-2.5e-11')
    """
    return f"{value:+.10f}" if abs(value) >= 1e-8 else f"{value:+.1e}"


def complex_number(value: tuple[float, float], pair: bool) -> str:
    """Return a multiplier or exponent as text, 8 decimals; one row stands for both of a pair.

    Examples
    --------
    >>> complex_number((0.5, 0.25), True), complex_number((-1.5, 0.0), False)
    ('0.50000000 +- 0.25000000i', '-1.50000000')
    """
    re, im = value
    return f"{re:.8f} +- {im:.8f}i" if pair else f"{re:.8f}" + (f" + {im:.8f}i" if im else "")


# -------------------------------------------------------------------------------------------- orbits and verdict
def _orbits(document: Document) -> Table:
    table = plain_table(">branch", ">RMS", ">least", ">largest", ">largest |multiplier|", "stability", "")
    for o in document["orbits"]:
        size = abs(complex(*o["leading_multiplier"]))
        mark = "<- this report" if o["branch"] == document["branch"] else ""
        numbers = (amplitude(o["rms"]), amplitude(o["least"]), amplitude(o["largest"]), f"{size:.8f}")
        table.add_row(str(o["branch"]), *numbers, o["stability"], mark)
    return table


def _choice(document: Document) -> list[str]:
    first, last = document["range"]
    count = len(document["orbits"])
    where = f"on the period-1 response traced from {first:g} to {last:g}"
    if count == 1:
        return [f"the only orbit at this ratio {where}"]
    return [f"{count} orbits at this ratio, in order {where}; --branch 1 to {count} chooses"]


def _verdict(document: Document) -> list[str]:
    lines = [f"{document['stability']}: {document['reason']}"]
    for found in document["instabilities"]:
        value = complex_number(found["multiplier"], found["multiplier"][1] != 0)
        lines.append(f"instability through {found['through']}: {value}, {_TYPES[found['type']]}")
    nearest = document["nearest"]
    if nearest is None:
        first, last = sorted(document["range"])
        return [*lines, f"no change of stability on the branch between {first:g} and {last:g}"]
    what = {
        "stable": "nearest instability",
        "unstable": "nearest point where stability is regained",
        "undecided": "nearest special point",
    }[document["stability"]]
    lines.append(f"{what}: {_kind(nearest)} at {ratio(nearest['frequency_ratio'])} +- {small(nearest['error'])}")
    away = f"  {distance(nearest['distance'])} in frequency ratio"
    if nearest["distance_rpm"] is not None:
        away += f", {nearest['distance_rpm']:+.0f} rpm"
    if nearest["status"] == "guessed":
        away += f"; guessed, not located: {nearest['note']}"
    return [*lines, away + ("; reached only around a fold" if nearest["around_fold"] else "")]


def _kind(change: Document) -> str:
    return KINDS.get(str(change["kind"]), str(change["kind"]))


# -------------------------------------------------------------------------------------------- multipliers
def _multipliers(document: Document) -> Table:
    seconds = document["mesh_period_seconds"] is not None
    table = plain_table(
        ">multiplier", ">modulus", ">error", ">exponent", ">error", ">mesh periods to 1/e", ">error",
        *([">exponent / (1/s)"] if seconds else []),
    )  # fmt: skip
    for row in document["multipliers"]:
        rate = row["exponent_per_second"]
        table.add_row(
            complex_number(row["multiplier"], row["pair"]),
            f"{row['modulus']:.8f}",
            small(row["error"]),
            "-inf" if row["exponent"] is None else _exponent(row["exponent"], row["pair"], 5),
            small(row["exponent_error"]),
            _time(row["mesh_periods"]) + (" grows" if row["grows"] else ""),
            "unbounded" if row["mesh_periods_error"] is None else small(row["mesh_periods_error"]),
            *([("-inf" if rate is None else _exponent(rate, row["pair"], 1))] if seconds else []),
        )
    return table


def _exponent(value: tuple[float, float], pair: bool, digits: int) -> str:
    re, im = value
    return f"{re:.{digits}f}" + (f" +- {im:.{digits}f}i" if pair else f" + {im:.{digits}f}i" if im else "")


def _time(value: float | None) -> str:
    return "for ever" if value is None else f"{value:.6g}"


def _around(document: Document) -> Table:
    rpm = document["pinion_rpm"] is not None
    table = plain_table(
        "to", "special point", ">frequency ratio", ">error", ">distance", *([">pinion rpm"] if rpm else []), "beyond",
        "status",
    )  # fmt: skip
    for way in ("lower", "higher"):
        entries = document["around"][way]
        if not entries:
            table.add_row(way, "none in the traced range")
        for c in entries:
            table.add_row(
                way,
                _kind(c),
                ratio(c["frequency_ratio"]),
                small(c["error"]),
                distance(c["distance"]),
                *([speed(c["pinion_rpm"])] if rpm else []),
                c["beyond"],
                Text("; ".join(filter(None, (c["status"], "around a fold" if c["around_fold"] else "", c["note"])))),
            )
    return table


# -------------------------------------------------------------------------------------------- waveform
def _contact(document: Document) -> Table:
    table = plain_table("contact", ">from / deg", ">to / deg", ">share / %")
    for row in document["contact"]:
        ends = (f"{row['from_deg']:.4f}", f"{row['to_deg']:.4f}")
        table.add_row(row["flank"], *ends, f"{100 * row['share']:.4f}")
    return table


def _shares(document: Document) -> str:
    shares = ", ".join(f"{name} {100 * part:.4f} %" for name, part in document["contact_shares"].items())
    low, high = document["deflection"]["least"], document["deflection"]["largest"]
    return f"{shares} of the mesh cycle; lambda - e from {low:.6f} to {high:.6f}, contact beyond -1 and 1"


def _waveform(document: Document) -> list[str]:
    names = {"rms": "RMS", "mean": "mean", "least": "least", "largest": "largest", "peak_to_peak": "peak to peak"}
    wave = document[STATE]
    lines = [", ".join(f"{words} {amplitude(wave[key])}" for key, words in names.items()) + " half backlashes"]
    if document["micrometres"] is not None:
        lines.append(", ".join(f"{words} {document['micrometres'][key]:.4f}" for key, words in names.items()) + " um")
    kept, error = document["harmonics_kept"], small(document["waveform_error"])
    lines.append(f"largest error {error} half backlashes, {kept} harmonics kept")
    force = document["mesh_force"]
    lines.append(
        f"dynamic factor {document['dynamic_factor']:.6f}: mesh force over k_0 b, largest {force['largest']:.6f}, "
        f"mean {force['mean']:.6f}, least {force['least']:.6f}"
    )
    if document["mesh_force_newton"] is not None:
        newton = document["mesh_force_newton"]
        lines.append("mesh force " + ", ".join(f"{k} {newton[k]:.1f}" for k in ("largest", "mean", "least")) + " N")
    return lines


def _harmonics(document: Document) -> Table:
    table = plain_table(">harmonic", ">amplitude", ">phase / deg")
    for row in document["harmonics"]:
        table.add_row(str(row["order"]), f"{row['amplitude']:.3e}", f"{row['phase_deg']:.4f}")
    return table


# -------------------------------------------------------------------------------------------- agreement
def _agreement(document: Document) -> list[str]:
    found = document["agreement"]
    lines = ["found by harmonic balance, its multipliers by integration between contact changes; against these"]
    lines += [f"{name}: largest difference of a multiplier {small(d)}" for name, d in found["multipliers"].items()]
    lines += [f"{name}: not available, {why}" for name, why in found["missing"].items()]
    if found["waveform"] is not None:
        contact = found["contact_deg"]
        phases = "another sequence of contacts" if contact is None else f"contact phases {small(contact)} deg"
        stated = f"(stated errors together {small(found['expected'])})"
        lines.append(f"orbit by shooting: waveform of lambda {small(found['waveform'])} {stated}, {phases}")
    return [
        *lines,
        f"Liouville's determinant {small(found['liouville'])} in the logarithm, contact phases of the integration "
        f"{small(found['contact_defect_deg'])} deg",
    ]


def _explanation(document: Document) -> list[str]:
    lines = [
        "",
        "Lengths are in half backlashes, frequency ratio is omega_m/omega_n, phases are those of the mesh cycle;",
        "harmonics are amplitude cos(order theta + phase). The errors of multipliers and waveform are the larger of",
        "their own estimates and the difference of the methods; exponents are logarithms of multipliers, per period.",
    ]
    if document["mesh_frequency_hertz"] is not None:
        lines.append(f"Mesh frequency {document['mesh_frequency_hertz']:.1f} Hz.")
    return lines
