"""The map over a modification: the least amount without doublings, one set of numbers everywhere, and resumption."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from rich.console import Console
from typer.testing import CliRunner

import sbg_casadi.map_grid as grid_module
import sbg_casadi.map_study as study_module
from continuation import HarmonicBalance, trace
from continuation.branches.codimension_two import CurvePoint
from sbg_casadi import load_pair
from sbg_casadi.cli import app
from sbg_casadi.errors import PairError, UserError
from sbg_casadi.map_curves import Curves, MapCurve, Slice, assign, slice_values
from sbg_casadi.map_figure import SHADES, map_figure, map_shades
from sbg_casadi.map_grid import Grid
from sbg_casadi.map_least import End, Extent, extents, free
from sbg_casadi.map_parameters import QUANTITIES, vary
from sbg_casadi.map_study import run_map
from sbg_casadi.map_verdict import sentence
from sbg_casadi.model import gear_system
from sbg_casadi.response import PARAMETER

LEAST = 0.76365  # 1 - scale, scale = 0.23635 of the stiffness harmonics at which the two doublings meet
CONSISTENT: frozenset[int] = frozenset()


@pytest.fixture(scope="module")
def vanishing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example with a modification that takes away all fluctuation of the mesh stiffness."""
    rows = load_pair("example").to_toml().splitlines()
    kept = [r for r in rows if not r.startswith(("name", "stiffness_cosine", "stiffness_sine"))]
    states = [
        "[states.before]\nstiffness_cosine = [0.3, 0.1]\nstiffness_sine = [0.0, 0.0]",
        "[states.after]\nstiffness_cosine = [0.0, 0.0]\nstiffness_sine = [0.0, 0.0]",
    ]
    path = tmp_path_factory.mktemp("pair") / "vanishing.toml"
    path.write_text("\n".join(['name = "vanishing"', *kept, *states]) + "\n")
    return path


def console() -> Console:
    return Console(file=io.StringIO(), width=160, highlight=False)


def draw(pair: Path | str, out: Path, **more: Any) -> tuple[int, str]:
    screen = console()
    settings: dict[str, Any] = {
        "over": "modification", "start": 1.3, "stop": 1.4, "least": 0.6, "most": 0.9, "shape": (6, 4), "state": None,
        "json_file": None, "checks": 1, "workers": 2,
    } | more  # fmt: skip
    code = run_map(str(pair), out=out, console=screen, **settings)
    return code, screen.file.getvalue()  # type: ignore[attr-defined]


@dataclass
class Finished:
    """One finished map that the tests look at."""

    folder: Path
    code: int
    screen: str
    document: dict[str, Any]


@pytest.fixture(scope="module")
def finished(vanishing: Path, tmp_path_factory: pytest.TempPathFactory) -> Finished:
    folder = tmp_path_factory.mktemp("map") / "out"
    code, screen = draw(vanishing, folder, json_file=folder / "copy.json")
    return Finished(folder, code, screen, json.loads((folder / "map.json").read_text()))


# -------------------------------------------------------------------------------------------- the sentence
def test_least_modification_is_where_the_two_doublings_of_the_example_meet(finished: Finished) -> None:
    least = finished.document["least"]
    assert finished.code == 0
    assert finished.document["failures"] == []
    assert least["case"] == "extremum"
    assert least["value"] == pytest.approx(LEAST, abs=1e-5)
    assert least["error"] < 1e-6
    assert least["frequency_ratio"] == pytest.approx(1.3484, abs=1e-4)


def test_both_sides_are_confirmed_by_continuation_and_in_the_time_domain(finished: Finished) -> None:
    checks = finished.document["least"]["checks"]
    again, time_domain = checks["continuation"], checks["time_domain"]
    assert again["agrees"]
    assert time_domain["agrees"]
    assert len(again["with"]["frequency_ratios"]) == 2
    assert again["without"]["frequency_ratios"] == []
    assert again["with"]["value"] < LEAST < again["without"]["value"]
    assert (time_domain["with"]["attractor"], time_domain["with"]["stability"]) == ("period 2", "unstable")
    assert (time_domain["without"]["attractor"], time_domain["without"]["stability"]) == ("period 1", "stable")


def test_one_curve_passes_every_doubling_located_on_its_own(finished: Finished) -> None:
    assert [(c["kind"], c["period_multiple"]) for c in finished.document["curves"]] == [("period-doubling", 1)]
    located = {s["value"]: [p for p in s["points"] if p["period_multiple"] == 1] for s in finished.document["slices"]}
    assert {v: [p["curve"] for p in points] for v, points in located.items()} == {0.6: [0, 0], 0.75: [0, 0], 0.9: []}
    # the same numbers from the plain equations of the pair with scaled harmonics, without any map
    d = load_pair("example").dimensionless()
    scaled = replace(d, stiffness_cosine=tuple(0.4 * a for a in d.stiffness_cosine))
    problem = HarmonicBalance().discretise(gear_system(scaled), PARAMETER)
    branch = trace(problem, problem.guess(frequency_ratio=1.3), (1.3, 1.4))
    assert sorted(p["frequency_ratio"] for p in located[0.6]) == pytest.approx(
        sorted(q.parameter for q in branch.special_points), abs=1e-8
    )


def test_grid_shows_period_2_inside_the_tongue_and_period_1_beyond_it(finished: Finished) -> None:
    grid = finished.document["grid"]
    at = {v: i for i, v in enumerate(np.round(grid["value"], 6))}
    tip = int(np.argmin(np.abs(np.array(grid["frequency_ratio"]) - 1.348)))
    for direction in (0, 1):
        assert grid["attractor"][direction][at[0.6]][tip] == "periodic"
        assert grid["period"][direction][at[0.6]][tip] == 2
        assert grid["period"][direction][at[0.8]] == [1] * 6
        assert grid["period"][direction][at[0.9]] == [1] * 6
    assert finished.document["least"]["attractors_beyond"] == {"period 1": 24}


# -------------------------------------------------------------------------------------------- output
def test_the_same_numbers_in_text_json_and_netcdf(finished: Finished) -> None:
    document = finished.document
    assert {p.name for p in finished.folder.iterdir()} == {
        "map.png", "summary.txt", "map.json", "map.nc", "copy.json", ".sbg-results"
    }  # fmt: skip
    assert json.loads((finished.folder / "copy.json").read_text()) == document
    summary = (finished.folder / "summary.txt").read_text()
    for text in (summary, finished.screen):
        assert document["least"]["sentence"][:60] in " ".join(text.split())
        assert f"{document['least']['value']:.7g}" in text
        assert "confirmed" in text
    with xr.open_dataset(finished.folder / "map.nc", engine="h5netcdf") as data:
        assert data["period"].values.tolist() == document["grid"]["period"]
        assert data["curve_value"].values.tolist() == document["curves"][0]["value"]
        assert data["curve_frequency"].values.tolist() == document["curves"][0]["frequency_ratio"]
        assert data["frequency"].values.tolist() == document["grid"]["frequency_ratio"]


def test_figure_has_the_shades_and_curves_of_the_document(finished: Finished) -> None:
    document = finished.document
    figure = map_figure(document)
    shades = map_shades(document)
    assert shades.shape == (2, 4, 6)
    assert {SHADES[i][0] for i in np.unique(shades)} >= {"period 1", "period 2"}
    for ax, shaded in zip(figure.axes, shades, strict=True):
        (mesh,) = ax.collections
        assert np.asarray(mesh.get_array()).reshape(4, 6).tolist() == shaded.tolist()
        drawn = {line.get_gid(): line for line in ax.get_lines()}
        assert np.asarray(drawn["doublings 1 to 2"].get_ydata()).tolist() == document["curves"][0]["value"]
        assert np.asarray(drawn["least"].get_ydata())[0] == document["least"]["value"]


# -------------------------------------------------------------------------------------------- resumption
def test_an_interrupted_map_is_kept_and_goes_on(
    vanishing: Path, finished: Finished, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    swept: list[int] = []
    run_all = grid_module.run_all

    def counted(tasks: Any, *rest: Any) -> Any:
        swept.append(len(tasks))
        if len(swept) == 3:
            raise KeyboardInterrupt
        return run_all(tasks, *rest)

    monkeypatch.setattr(grid_module, "run_all", counted)
    monkeypatch.setattr(study_module, "find_curves", lambda *_, **__: Curves([], [], []))  # what is kept is the grid
    code, screen = draw(vanishing, tmp_path / "out")
    assert code == 3
    assert "4 of 8 sweeps, no curves yet" in screen
    assert not json.loads((tmp_path / "out" / "map.json").read_text())["complete"]
    code, screen = draw(vanishing, tmp_path / "out")
    assert code == 0
    assert screen.startswith("going on with the map")
    assert sum(swept) == 2 + 2 + 2 + 4  # the row that was interrupted is swept again, what was kept is not
    document = json.loads((tmp_path / "out" / "map.json").read_text())
    assert document["grid"] == finished.document["grid"]
    code, screen = draw(vanishing, tmp_path / "out", shape=(2, 2), least=0.8, checks=0)
    assert "other settings; starting anew" in screen
    assert json.loads((tmp_path / "out" / "map.json").read_text())["least"]["case"] == "never"


# -------------------------------------------------------------------------------------------- quantities
@pytest.mark.parametrize("name", QUANTITIES)
@pytest.mark.parametrize("pair", ["iso-f2", "case1"])
def test_every_quantity_is_the_pair_with_that_number(pair: str, name: str) -> None:
    varied = vary(load_pair(pair), name, None, CONSISTENT)
    x = np.linspace(-1.5, 1.6, 14)
    for shown in (*varied.span, 0.3 * varied.span[0] + 0.7 * varied.span[1]):
        plain = gear_system(varied.at(shown))
        given = {varied.parameter: varied.inner(shown)}
        for theta in (0.4, 2.9):
            ours = varied.system.rhs(x, theta, frequency_ratio=0.7, **given)
            assert ours == pytest.approx(plain.rhs(x, theta, frequency_ratio=0.7), rel=1e-13, abs=1e-15)


def test_modification_is_before_at_0_and_after_at_1() -> None:
    pair = load_pair("iso-f2")
    varied = vary(pair, "modification", None, CONSISTENT)
    for amount, state in ((0.0, "before"), (1.0, "after")):
        mixed, given = varied.at(amount), pair.dimensionless(state)
        assert mixed.stiffness_cosine == pytest.approx(given.stiffness_cosine, abs=1e-16)
        assert replace(mixed, state=state, stiffness_cosine=given.stiffness_cosine) == given


def test_physical_quantities_carry_units() -> None:
    pair = load_pair("iso-f2")
    assert pair.derived is not None
    torque, backlash = (vary(pair, n, None, CONSISTENT) for n in ("torque", "backlash"))
    assert (torque.unit, backlash.unit) == ("N m", "mm")
    assert torque.inner(pair.derived.pinion_torque) == pytest.approx(pair.dimensionless().torque, rel=1e-14)
    assert backlash.inner(2e3 * pair.derived.half_backlash) == pytest.approx(1.0, rel=1e-14)
    assert backlash.at(4e3 * pair.derived.half_backlash).torque == pytest.approx(pair.dimensionless().torque / 2)


def test_without_contact_loss_doublings_do_not_depend_on_the_torque(tmp_path: Path) -> None:
    code, screen = draw(
        "example", tmp_path / "out", over="torque", start=1.4, stop=1.43, least=0.1, most=0.2, shape=(2, 2), checks=0
    )  # a linear equation with periodic coefficients: torque sets the size of the response alone
    document = json.loads((tmp_path / "out" / "map.json").read_text())
    assert code == 0, screen
    (curve,) = [c for c in document["curves"] if c["period_multiple"] == 1]
    assert curve["frequency_ratio"] == pytest.approx([1.4160415167] * len(curve["value"]), abs=1e-8)
    assert (min(curve["value"]), max(curve["value"])) == pytest.approx((0.1, 0.2))
    assert document["least"]["case"] == "persists"
    assert document["least"]["value"] is None
    assert "Up to the largest torque 0.2 the period-1 response doubles" in document["least"]["sentence"]


# -------------------------------------------------------------------------------------------- refusals
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["example", "--over", "torqe"], "did you mean 'torque'"),
        (["example", "--over", "modification"], "has no state 'before'"),
        (["iso-f2", "--over", "modification", "--state", "after"], "expected no --state"),
        (["example", "--over", "torque", "--least", "2", "--most", "1"], "--least = 2 and --most = 1"),
        (["example", "--over", "torque", "--least", "-1"], "torque = -1"),
        (["example", "--over", "fluctuation", "--most", "5"], "expected a mesh stiffness that stays positive"),
        (["example", "--over", "torque", "--grid", "1", "4"], "--grid 1 4"),
        (["example", "--over", "torque", "--from", "0"], "--from = 0"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(arguments: list[str], words: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["map", *arguments, "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert words in result.output
    assert not (tmp_path / "out").exists()


def test_modification_needs_states_that_differ_in_harmonics_alone() -> None:
    with pytest.raises(PairError, match="before"):
        vary(load_pair("example"), "modification", None, CONSISTENT)
    with pytest.raises(UserError, match="did you mean 'backlash'"):
        vary(load_pair("example"), "backlsh", None, CONSISTENT)


# -------------------------------------------------------------------------------------------- curves and extents
def arch(top: float, low: float, left: float = 1.1, right: float = 1.3, extremum: bool = True) -> MapCurve:
    """Return a curve of doublings p -> q that rises from low at both ends to a top in the middle."""
    problem_orbit = _orbit()
    p = np.linspace(left, right, 21)
    s = (p - (left + right) / 2) / ((right - left) / 2)
    points = np.column_stack([p, top - (top - low) * s**2])
    special = (CurvePoint("extremum", ((left + right) / 2, top), (1e-9, 1e-9), 9),) if extremum else ()
    return MapCurve("period-doubling", 1, points, (problem_orbit,) * 21, "made up", "made up", special)


def _orbit() -> Any:
    from continuation.orbits.orbit import Orbit

    return Orbit(
        system="s", state_names=("lambda",), parameter=PARAMETER, parameters={PARAMETER: 1.0}, period=1.0,
        period_multiple=1, coefficients=np.array([[0j], [0.1 + 0j]]), multipliers=np.array([0.5 + 0j]),
        multiplier_error=np.zeros(1), stability="stable", error=0.0,
    )  # fmt: skip


@pytest.mark.parametrize("extremum", [True, False])
def test_extent_ends_at_the_extremum_and_at_the_end_of_the_range(extremum: bool) -> None:
    varied = vary(load_pair("example"), "fluctuation", None, CONSISTENT)
    (found,) = extents(varied, [arch(0.7, 0.0, extremum=extremum)], (1.0, 1.4), (0.0, 1.0))
    assert (found.low.value, found.low.kind) == (0.0, "limit")
    assert (found.high.kind, found.high.frequency_ratio) == ("extremum", pytest.approx(1.2))
    assert found.high.value == pytest.approx(0.7, abs=1e-12)
    assert free([found], (0.0, 1.0)) == [(found.high, None)]


def test_overlapping_curves_give_one_interval_and_separate_ones_a_gap() -> None:
    varied = vary(load_pair("example"), "fluctuation", None, CONSISTENT)
    low, wide = arch(0.3, 0.0), arch(0.2, 0.0, 1.15, 1.25)
    upper = arch(0.6, 1.0, 1.1, 1.3)  # a trough that is open at the upper end of the range
    first, second = extents(varied, [low, wide, upper], (1.0, 1.4), (0.0, 1.0))
    assert (first.low.value, first.high.value) == (0.0, pytest.approx(0.3))
    assert (second.low.value, second.low.kind, second.high.kind) == (pytest.approx(0.6), "extremum", "limit")
    assert free([first, second], (0.0, 1.0)) == [(first.high, second.low)]
    text = sentence(varied, "persists", second.high, [first, second], (1.0, 1.4), (0.0, 1.0), [])
    assert text.startswith("Up to the largest fluctuation 1 the period-1 response doubles")
    assert "Between fluctuation 0.3 and 0.6 it has none" in text


def test_curves_outside_the_band_and_of_period_2_do_not_count() -> None:
    varied = vary(load_pair("example"), "fluctuation", None, CONSISTENT)
    doubled = replace(arch(0.7, 0.0), period_multiple=2)
    assert extents(varied, [arch(0.7, 0.0), doubled], (1.5, 1.6), (0.0, 1.0)) == []
    assert extents(varied, [doubled, replace(arch(0.7, 0.0), kind="fold")], (1.0, 1.4), (0.0, 1.0)) == []


def test_a_curve_that_ends_for_no_good_reason_leaves_the_matter_open() -> None:
    varied = vary(load_pair("example"), "fluctuation", None, CONSISTENT)
    half = arch(0.7, 0.0, extremum=False)
    cut = replace(half, points=half.points[:8], orbits=half.orbits[:8], stop="the step became too small")
    (found,) = extents(varied, [cut], (1.0, 1.4), (0.0, 1.0))
    assert found.high.kind == "stop"
    text = sentence(varied, "undecided", found.high, [found], (1.0, 1.4), (0.0, 1.0), [])
    assert text.startswith("Undecided")
    assert "the step became too small" in text


def test_a_point_is_on_a_curve_once_and_only_where_it_passes() -> None:
    curve = arch(0.7, 0.0)
    (left, off), (right, _) = curve.at(0.35)
    assert left[0] == pytest.approx(1.2 - 0.1 / np.sqrt(2), abs=1e-3)

    def point(p: float) -> Any:
        from continuation import SpecialPoint

        return SpecialPoint("period-doubling", p, 1e-9, replace(_orbit(), parameters={PARAMETER: p}), (p, p), 0)

    here, there = point(float(left[0])), point(float(right[0]))
    twin, away = point(float(left[0] + 0.1 * off[0])), point(1.2)
    assert assign([curve], Slice(0.35, (), (here, there, twin, away), [])) == [0, 0, None, None]


def test_values_traced_halve_the_widest_gaps() -> None:
    varied = vary(load_pair("iso-f2"), "modification", None, CONSISTENT)
    assert slice_values(varied, (0.0, 1.5), 4) == ([0.0, 1.0, 1.5], [0.25, 0.5, 0.75, 1.25])
    assert slice_values(varied, (0.2, 0.8), 0) == ([0.2, 0.8], [])


def test_sentences_of_the_other_cases() -> None:
    varied = vary(load_pair("iso-f2"), "torque", None, CONSISTENT)
    edge = End(300.0, 1e-6, 0.5, "band", 0)
    region = Extent(End(75.0, 0.0, 0.6, "limit", 0), edge)
    text = sentence(varied, "band", edge, [region], (1.2, 0.5), (75.0, 1200.0), [])
    assert "Beyond torque 300 N m" in text
    assert "leaves the band at frequency ratio 0.500000" in text
    never = sentence(varied, "never", None, [], (0.5, 1.2), (75.0, 1200.0), [])
    assert never == (
        "From torque 75 to 1200 N m the period-1 response has no doubling between frequency ratio 0.5 and 1.2."
    )


def test_an_empty_grid_knows_what_is_missing() -> None:
    grid = Grid.empty(np.array([1.2, 1.0]), np.array([0.0, 0.5]))
    assert grid.frequencies.tolist() == [1.0, 1.2]
    assert grid.missing == [(0, 0), (1, 0), (0, 1), (1, 1)]
    assert grid.counts() == {"not computed": 8}
