"""What the engineer learns of a case: a paragraph made from its numbers alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

Numbers = Mapping[str, Any]

_WORDS = {
    ("fold", 1): "jump",
    ("period-doubling", 1): "doubling",
}
_LISTED = 4


def learned(case: str, found: Numbers) -> list[str]:
    """Return the sentences about one case: what changed, by which mechanism, and what would have sufficed.

    Parameters
    ----------
    case : str
    found : mapping
        :func:`~sbg_casadi.paper.numbers.case_numbers` of it.
    """
    before, after = found["states"]["before"], found["states"]["after"]
    sentences = [f"{case}, by the pair {found['pair']} (what is not printed is {found['basis']})."]
    sentences += _peaks(before, after) + _forces(before, after) + _intervals(before, after)
    sentences += _mechanism(found) + _least(found)
    sentences += [f"Not computed: {text}." for text in found["failures"]]
    return sentences


def change(before: float, after: float) -> str:
    """Return a change in percent with its sign.

    >>> change(0.2, 0.15)
    '-25.0 %'
    """
    return f"{100 * (after / before - 1):+.1f} %" if before else "-"


def _peaks(before: Numbers, after: Numbers) -> list[str]:
    if before["peak"] is None or after["peak"] is None:
        return []
    one, two = before["peak"], after["peak"]
    spans = before["peak_to_peak"], after["peak_to_peak"]
    return [
        f"The modification changes the stiffness fluctuation from {100 * spans[0]:.1f} to {100 * spans[1]:.1f} % peak "
        f"to peak ({change(*spans)}), and the largest RMS from {one['rms']:.4f} at {one['frequency_ratio']:.3f} to "
        f"{two['rms']:.4f} at {two['frequency_ratio']:.3f} ({change(one['rms'], two['rms'])})."
    ]


def _forces(before: Numbers, after: Numbers) -> list[str]:
    parts = []
    one, two = before["dynamic_factor"], after["dynamic_factor"]
    if one and two:
        parts.append(
            f"the largest dynamic factor goes from {one['value']:.3f} at {one['frequency_ratio']:.3f} to "
            f"{two['value']:.3f} at {two['frequency_ratio']:.3f} ({change(one['value'], two['value'])})"
        )
    for name, words in (
        ("bearing_force", "largest bearing force"),
        ("bearing_swing", "largest peak-to-peak bearing force"),
    ):
        one, two = before[name], after[name]
        if one and two:
            parts.append(
                f"the {words} of the stable orbits of period 1 and 2 from {one['value']:.4g} to "
                f"{two['value']:.4g} {before['unit']} ({change(one['value'], two['value'])})"
            )
    return [_capital("; ".join(parts)) + "."] if parts else []


def _intervals(before: Numbers, after: Numbers) -> list[str]:
    texts = []
    for name, state in (("before it,", before), ("after it,", after)):
        if state["intervals"] is None:
            continue
        chaos = [r for r in state["intervals"] if r["verdict"] == "chaotic"]
        rest = [r for r in state["intervals"] if r["verdict"] != "chaotic"]
        if not chaos and not rest:
            texts.append(f"{name} all motions of the sweeps are of period 1")
            continue
        text = f"{name} the sweeps find chaos " + (_ranges(chaos) if chaos else "nowhere")
        if rest:
            text += ", and " + "; ".join(
                f"{v} {_ranges([r for r in rest if r['verdict'] == v])}"
                for v in dict.fromkeys(r["verdict"] for r in rest)
            )
        texts.append(text)
    return [_capital("; ".join(texts)) + "."] if texts else []


def _ranges(rows: Sequence[Numbers]) -> str:
    shown = [
        f"{r['from']:.3f}" if r["from"] == r["to"] else f"{r['from']:.3f} to {r['to']:.3f}" for r in rows[:_LISTED]
    ]
    more = f" and {len(rows) - _LISTED} more places" if len(rows) > _LISTED else ""
    return "at " + ", ".join(shown) + more


def _mechanism(found: Numbers) -> list[str]:
    """Say which special points moved or vanished, by the curves they lie on over the amount of modification."""
    if found["least"] is None:
        return []
    texts, more = [], _others(found)
    for row in found["moves"]:
        word, old, new = _WORDS[row["kind"], row["period_multiple"]], row["before"], row["after"]
        if not old and not new:
            continue
        turns = row["turns"]
        at = (
            f" (their curve turns at amount {turns['value']:.3f}, ratio {turns['frequency_ratio']:.3f})"
            if turns
            else ""
        )
        if old and not new:
            verb = "vanishes" if len(old) == 1 else "vanish"
            texts.append(f"{_plural(word, old)} {verb}{at}")
        elif new and not old:
            texts.append(f"{_plural(word, new)} {'appears' if len(new) == 1 else 'appear'}{at}")
        elif len(old) == len(new):
            texts.append(f"{_plural(word, old)} {'moves' if len(old) == 1 else 'move'} to {_listed(new)}")
        else:
            texts.append(f"{_plural(word, old)} become {len(new)} at {_listed(new)}{at}")
    if not texts:
        if "fold" not in found.get("tracked", ["fold"]):
            return more
        return ["There is no jump and no doubling before or after: only the height of the response changes.", *more]
    if len(texts) > 8:
        texts = [*texts[:8], f"{len(texts) - 8} more groups of special points are in the data"]
    return ["The mechanism: " + "; ".join(texts) + ".", *more]


def _others(found: Numbers) -> list[str]:
    """Count the special points that are not tracked over the modification."""
    before, after = (found["states"][s]["special"] for s in ("before", "after"))
    if before is None or after is None:
        return []
    words = {} if "fold" in found.get("tracked", ["fold"]) else {"fold": "jumps"}
    words |= {"neimark-sacker": "torus points", "period-4": "doublings from period 2 to 4"}
    parts = [
        f"{len(before[kind])} {word} become {len(after[kind])}"
        for kind, word in words.items()
        if before[kind] or after[kind]
    ]
    return [f"Beside these, {' and '.join(parts)}."] if parts else []


def _plural(word: str, values: Sequence[float]) -> str:
    return f"the {word}{'' if len(values) == 1 else 's'} at {_listed(values)}"


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{v:.4f}" for v in values)


def _least(found: Numbers) -> list[str]:
    least = found["least"]
    if least is None:
        return []
    if least["value"] is None:
        return [least["sentence"]]
    share = f"{100 * least['value']:.1f} % of the modification would have sufficed against doublings"
    checks = least["checks"]
    sure = [name.replace("_", " ") for name, check in checks.items() if check["agrees"] is True]
    told = f" (confirmed on both sides by {' and '.join(sure)})" if sure else " (no check confirms it)"
    return [f"{share}{told}: {least['sentence']}"]


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
