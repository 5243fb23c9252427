"""Parts of an identification: targets files, addresses in pair files, search, scores, what data determine."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sbg_casadi import UserError, load_pair
from sbg_casadi.identification.addresses import known_addresses, put
from sbg_casadi.identification.checking import has_regime
from sbg_casadi.identification.determinacy import RANGE_ERROR, determinacy, search_conflicts
from sbg_casadi.identification.parametric import parametric
from sbg_casadi.identification.runs import LARGEST_PERIOD, Response, Runs, Swept
from sbg_casadi.identification.scoring import Score, cost, nearest_jump, peak_of, regime_residual
from sbg_casadi.identification.search import Archive, search
from sbg_casadi.identification.targets_file import load_targets, read_targets
from sbg_casadi.identification.unknowns import Candidates, Unknown
from sbg_casadi.pair import build_pair

UNKNOWN = {"key": "mesh.damping_ratio", "bounds": [0.01, 0.1], "scale": "log"}
TARGET = {"state": "before", "kind": "rms", "at": 1.0, "value": 0.1, "tolerance": 0.01}


def fault(unknown: dict[str, Any], target: dict[str, Any], name: str = "iso-f2") -> str:
    with pytest.raises(UserError) as caught:
        read_targets({"unknowns": [unknown], "targets": [target]}, load_pair(name))
    return str(caught.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"key": "mesh.dampin_ratio"}, "did you mean 'mesh.damping_ratio'"),
        ({"key": "states.befor.stiffness_cosine.1"}, "did you mean 'states.before.stiffness_cosine.1'"),
        ({"key": "states.before.stiffness_cosine.99"}, "harmonic 99; expected one from 1 to 20"),
        ({"key": "mesh.coast_stiffness_ratio"}, "a slope of the contact law"),
        ({"key": "geometry.teeth"}, "no such number"),
        ({"key": "bearings.pinion_y"}, '"1 N/m"'),
        ({"bounds": [0.1, 0.01]}, "expected the first smaller"),
        ({"bounds": [0.0, 0.1]}, "positive for log"),
        ({"bounds": ["a", "b"]}, "is not a plain number"),
        ({"scale": "square"}, 'expected "linear" or "log"'),
        ({"bound": [0, 1]}, "did you mean 'bounds'?"),
        ({"key": "load.member"}, "expected some of pinion, gear"),
    ],
)
def test_unknowns_are_refused_in_one_sentence(change: dict[str, Any], words: str) -> None:
    message = fault(UNKNOWN | change, TARGET)
    assert words in message
    assert message.startswith("targets: unknowns[1]")


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ({"kind": "rmse"}, "expected one of rms, peak, jump, regime, exponent"),
        (TARGET | {"state": "befor"}, "expected one of before, after"),
        (TARGET | {"tolerance": 0}, "tolerance = 0; expected a positive number"),
        ({"state": "before", "kind": "rms", "value": 1.0, "tolerance": 1.0}, "at is missing"),
        ({"state": "before", "kind": "peak", "height": 1.0}, "height_tolerance is missing"),
        ({"state": "before", "kind": "peak"}, "expected height with height_tolerance"),
        ({"state": "before", "kind": "regime", "at": 1.0, "regime": "period-65"}, "expected period-1 to period-64"),
        (TARGET | {"tolerence": 0.1}, "did you mean 'tolerance'?"),
        (TARGET | {"kind": "jump", "at": 1.0}, "unknown key 'at'"),
    ],
)
def test_targets_are_refused_in_one_sentence(target: dict[str, Any], words: str) -> None:
    assert words in fault(UNKNOWN, target)


def test_files_that_can_not_be_read(tmp_path: Path) -> None:
    pair = load_pair("iso-f2")
    with pytest.raises(UserError, match="does not exist"):
        load_targets(tmp_path / "none.toml", pair)
    (tmp_path / "bad.toml").write_text("unknowns = [")
    with pytest.raises(UserError, match="not valid TOML"):
        load_targets(tmp_path / "bad.toml", pair)
    with pytest.raises(UserError, match="expected at least one table"):
        read_targets({"unknowns": []}, pair)
    with pytest.raises(UserError, match="looked for twice"):
        read_targets({"unknowns": [UNKNOWN, UNKNOWN], "targets": [TARGET]}, pair)


@pytest.mark.parametrize("name", ["example", "iso-f2", "case3"])
def test_every_address_can_be_written(name: str) -> None:
    """A value written at each address is in the pair, tagged, and nothing else has changed its source."""
    pair = load_pair(name)
    for key in known_addresses(pair):
        if key.endswith(("side", "plane", "member")) or (name == "iso-f2" and "stiffness_shape" in key):
            continue
        raw = tomllib.loads(pair.to_toml())
        value = 1.6 if key.endswith("contact_ratio") else 0.02
        put(pair, raw, key, value, "a note")
        found = build_pair(raw, "here", Path())
        tagged = {row.key for row in found.rows() if row.source == "calibrated"}
        assert tagged == {key.split(".")[2 if key.startswith("states") else 1]}, key


def test_a_shape_gives_way_to_its_harmonics() -> None:
    pair = load_pair("case3")
    raw = tomllib.loads(pair.to_toml())
    put(pair, raw, "states.before.stiffness_cosine.7", 0.01, "a note")
    found = build_pair(raw, "here", Path())
    before, now = pair.dimensionless("before").stiffness_cosine, found.dimensionless("before").stiffness_cosine
    assert now == (*before, 0.0, 0.01)
    assert found.dimensionless("after") == pair.dimensionless("after")


def test_coordinates_of_given_values() -> None:
    pair = load_pair("iso-f2")
    raw = {
        "unknowns": [
            {"key": "mesh.damping_ratio", "bounds": [0.005, 0.08], "scale": "log"},
            {
                "keys": ["bearings.pinion_y", "bearings.pinion_x"],
                "factors": [1.0, 0.7],
                "bounds": ["1e8 N/m", "5e8 N/m"],
            },
            {"key": "geometry.spiral_angle", "bounds": ["30 deg", "40 deg"]},
            {"key": "load.member", "choices": ["gear", "pinion"]},
        ],
        "targets": [TARGET],
    }
    candidates = Candidates(pair, read_targets(raw, pair).unknowns, Path())
    given = candidates.given()
    np.testing.assert_allclose(given, [0.5, 0.5, 0.5, 0.75])
    assert candidates.states(given)["after"] == candidates.at(given).dimensionless("after")
    assert candidates.at(given).dimensionless("after").bearing_stiffness == pytest.approx(
        pair.dimensionless("after").bearing_stiffness, rel=1e-14
    )


def test_slopes_of_the_formulas() -> None:
    """d(log) and chain through the spiral angle: a3 = cos(alpha) cos(beta)."""
    pair = load_pair("iso-f2")
    raw = {"unknowns": [{"key": "geometry.spiral_angle", "bounds": ["30 deg", "40 deg"]}, UNKNOWN], "targets": [TARGET]}
    candidates, equations = (
        Candidates(pair, read_targets(raw, pair).unknowns, Path()),
        parametric(pair.dimensionless(), 2),
    )
    slopes = candidates.slopes(np.array([0.5, 0.5]), ["before"], equations.numbers)["before"]
    a3 = equations.names.index("tangential_cosine")
    expected = -np.cos(np.radians(20)) * np.sin(np.radians(35)) * np.radians(10)
    assert slopes[a3] == pytest.approx([expected, 0.0], rel=1e-7, abs=1e-12)
    xi = equations.names.index("mesh_damping_ratio")
    assert slopes[xi] == pytest.approx([0.0, np.sqrt(0.001) * np.log(10)], rel=1e-7, abs=1e-12)


def test_choices_have_no_slope() -> None:
    member = Unknown("member", ("load.member",), (1.0,), 0.0, 1.0, "", "linear", ("pinion", "gear"))
    assert (member.value(0.2), member.value(1.0), member.slope(0.3)) == ("pinion", "gear", 0.0)
    assert member.value(member.coordinate("gear")) == "gear"


# -------------------------------------------------------------------------------------------- search
def rosenbrock(t: np.ndarray, limit: float) -> Score:
    x = 4 * t - 2
    r = np.concatenate([10 * (x[1:] - x[:-1] ** 2), 1 - x[:-1]])
    return Score(r, float(r @ r), ())


def test_search_finds_a_curved_valley_and_repeats_itself() -> None:
    found = search(rosenbrock, 3, evaluations=3000, seed=4)
    assert np.abs(4 * found.coordinates[found.best(1)[0]] - 3).max() < 0.2
    again = search(rosenbrock, 3, evaluations=300, seed=4)
    other = search(rosenbrock, 3, evaluations=300, seed=5)
    assert len(again) == 300
    assert all(np.array_equal(a, b) for a, b in zip(again.coordinates[:60], found.coordinates[:60], strict=False))
    assert not np.array_equal(again.coordinates[10], other.coordinates[10])
    start = np.array([0.7, 0.95, 0.5])
    near = search(rosenbrock, 3, evaluations=100, seed=4, start=[start], near=0.1)
    assert max(np.abs(t - start).max() for t in near.coordinates[:20]) <= 0.1


def test_an_interrupted_search_keeps_what_it_has() -> None:
    archive, calls = Archive(), iter(range(1000))

    def stop(t: np.ndarray, limit: float) -> Score:
        if next(calls) == 40:
            raise KeyboardInterrupt
        return rosenbrock(t, limit)

    with pytest.raises(KeyboardInterrupt):
        search(stop, 3, evaluations=1000, seed=0, archive=archive)
    assert len(archive) == 40
    assert [len(archive.best(count)) for count in (0, 1, 3)] == [0, 1, 3]


# -------------------------------------------------------------------------------------------- scores
def response(period: int, growth: float, returns: float = 1.0) -> Response:
    return Response(period, growth, 0.001, np.full(LARGEST_PERIOD, returns), 0.1, np.zeros(14))


def test_regimes_are_graded() -> None:
    assert regime_residual("chaotic", response(0, 0.3)) == 0
    assert regime_residual("period-2", response(2, -0.1)) == regime_residual("periodic", response(7, -0.1)) == 0
    assert regime_residual("quasi-periodic", response(0, 0.001)) == 0
    wrong = [regime_residual("chaotic", response(1, growth)) for growth in (-0.6, -0.3, -0.05)]
    assert wrong == sorted(wrong, reverse=True)
    assert wrong[-1] > 1
    near, far = (regime_residual("period-2", response(1, growth)) for growth in (-0.02, -0.4))
    assert 1 < near < far
    calm, wild = (regime_residual("period-1", response(0, growth)) for growth in (0.02, 0.3))
    assert 1 < calm < wild
    for regime in ("period-3", "periodic", "chaotic", "quasi-periodic"):
        for other in (response(0, 0.02, 0.5), response(4, -1.0), response(0, -0.5, 0.01)):
            residual = regime_residual(regime, other)
            assert residual == 0 or residual >= 1


def test_verdicts_of_regimes() -> None:
    assert has_regime("period-10", "period-10")
    assert has_regime("period-10", "periodic")
    assert not has_regime("not recognised", "chaotic")
    assert not has_regime("quasi-periodic", "periodic")


def test_peaks_and_jumps_of_sweeps() -> None:
    x = np.linspace(1.0, 2.0, 41)
    smooth = 0.5 - (x - 1.513) ** 2
    swept = Swept(x, np.array([smooth, smooth]), np.zeros((2, 41, 14)))
    assert peak_of(swept) == pytest.approx((1.513, 0.5), abs=1e-12)
    jumps = np.where(x < 1.7, 0.1 + 0.2 * x, 0.05 + 0.01 * x)
    swept = Swept(x, np.array([jumps, smooth]), np.zeros((2, 41, 14)))
    assert nearest_jump(swept, 1.0) == pytest.approx(1.6875, abs=1e-12)
    assert peak_of(Swept(x, np.array([jumps, jumps]), np.zeros((2, 41, 14))))[0] == pytest.approx(x[x < 1.7][-1])


def test_cost_counts_far_targets_less() -> None:
    assert cost(np.array([0.5, 1.0])) == pytest.approx(1.25)
    steps = np.diff([cost(np.array([r])) for r in np.arange(0.0, 12.0, 0.5)])
    assert (steps > 0).all()
    assert steps[-1] < steps[4]


# -------------------------------------------------------------------------------------------- what data determine
def test_determinacy_of_a_known_matrix() -> None:
    """Two targets see x and y + z alone: x is known to 1/100, y and z no better than by their range."""
    found = determinacy(np.array([[100.0, 0.0, 0.0], [0.0, 40.0, 40.0]]))
    assert found.determined.tolist() == [True, False, False]
    assert found.errors[0] == pytest.approx(0.01, rel=1e-3)
    assert found.errors[1] == pytest.approx(RANGE_ERROR / np.sqrt(2), rel=1e-2)
    assert found.singular_values == pytest.approx([100.0, 40.0 * np.sqrt(2)])
    nothing = determinacy(np.zeros((2, 3)))
    assert nothing.errors == pytest.approx(np.full(3, RANGE_ERROR))
    assert not nothing.determined.any()


def test_conflicts_seen_by_the_search() -> None:
    archive = Archive()
    for r in (*[[0.1, 3.0, 0.0]] * 20, [4.0, 0.2, 0.0], [0.3, np.nan, np.nan]):
        archive.add(np.zeros(1), Score(np.array(r), 1.0, ()))
    found = search_conflicts(np.array([0.1, 3.0, 0.0]), archive, ["a", "b", "c"])
    assert [(c.target, c.others) for c in found] == [("b", ("a",))]
    none = Archive([np.zeros(1)] * 20, archive.scores[:20])
    found = search_conflicts(np.array([0.1, 3.0, 0.0]), none, ["a", "b", "c"])
    assert [(c.target, c.others) for c in found] == [("b", ())]
    few = Archive([np.zeros(1)] * 2, archive.scores[:2])
    assert search_conflicts(np.array([0.1, 3.0, 0.0]), few, ["a", "b", "c"]) == []


def test_cheap_responses_agree_with_the_sweep() -> None:
    """Steps of 0.2/omega_n: RMS to 5e-3 of that of the careful sweep, and the same periods."""
    from continuation import sweep
    from sbg_casadi import gear_system, static_state

    d = load_pair("example").dimensionless()
    runs, ratios = Runs(parametric(d, 2)), [0.5, 0.8, 1.1]
    start = np.tile(static_state(d), (3, 1))
    careful = sweep(gear_system(d), "frequency_ratio", ratios, quantity="lambda", start=start)
    for i, ratio in enumerate(ratios):
        cheap = runs.response(d, ratio)
        assert cheap.period == careful.period[i]
        assert cheap.rms == pytest.approx(careful.rms[i], rel=5e-3)
        assert cheap.growth < 0
