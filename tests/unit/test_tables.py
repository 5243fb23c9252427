"""CSV tables of transmission error and stiffness: what is read, and one sentence with the line for what isn't."""

import re
from pathlib import Path

import numpy as np
import pytest

from sbg_casadi import PairError
from sbg_casadi.fourier import check_harmonics, check_periodic, fourier_fit, sampling
from sbg_casadi.mesh import fourier_series
from sbg_casadi.tables import parse_table, read_table

TEXT = """# measured on the bench
pinion roll angle [deg]; loaded TE gear 300 N m [urad]; loaded TE pinion 400 Nm [um]; unloaded TE normal [um]

0; 20; 2; 0.5   # first
10; 21; 3; 0.25
20; 19; 2.5; -0.5
"""


def test_every_unit_is_read_into_si() -> None:
    table = parse_table(TEXT)
    one, two, three = table.columns
    assert (one.quantity, one.member, one.angular, one.torque) == ("loaded TE", "gear", True, 300.0)
    assert (two.quantity, two.member, two.angular, two.torque) == ("loaded TE", "pinion", False, 400.0)
    assert (three.quantity, three.member, three.torque) == ("unloaded TE", "normal", None)
    np.testing.assert_allclose(one.values, [20e-6, 21e-6, 19e-6], rtol=1e-14)
    np.testing.assert_allclose(three.values, [0.5e-6, 0.25e-6, -0.5e-6], rtol=1e-14)
    np.testing.assert_allclose(table.cycles((18, 40)), [0, 0.5, 1.0], rtol=1e-14)
    assert table.lines.tolist() == [4, 5, 6]
    arcsec = parse_table("phase [1],unloaded TE gear [arcsec]\n0,1\n.5,2\n1,1\n").columns[0]
    np.testing.assert_allclose(arcsec.values * 180 * 3600 / np.pi, [1, 2, 1], rtol=1e-14)
    assert parse_table("gear angle [rad]\tstiffness [N/um]\n0\t1\n1\t2\n2\t1\n").columns[0].values[1] == 2e6


HEAD = "phase [1], stiffness [N/um]\n"
WRONG = [
    ("", "is empty; expected a header such as"),
    ("# only a comment\n", "is empty"),
    ("time [s], stiffness [N/m]\n", "line 1: the first column is 'time [s]'; expected phase [1]"),
    ("phase [deg], stiffness [N/m]\n", "line 1: phase has the unit 'deg'; expected phase [1]"),
    ("pinion angle [mm], stiffness [N/m]\n", "line 1: 'pinion angle [mm]' has the wrong unit 'mm'; expected deg"),
    ("phase [1]\n0\n", "line 1: one column only"),
    ("phase [1], loaded TE [urad]\n", "line 1: can't read the column 'loaded TE [urad]'; expected loaded TE"),
    ("phase [1], loaded TE gear\n", "line 1: can't read the column 'loaded TE gear'"),
    ("phase [1], loaded TE normal [urad]\n", "has the wrong unit 'urad'; expected um"),
    ("phase [1], loaded TE gear [N]\n", "has the wrong unit 'N'; expected deg, urad, arcsec or um"),
    ("phase [1], loaded TE gear 300 N [urad]\n", "torque '300 N' has the wrong unit 'N'; expected such as 300 N m"),
    ("phase [1], loaded TE gear -3 N m [urad]\n", "torque '-3 N m' is not positive"),
    ("phase [1], unloaded TE gear 3 N m [urad]\n", "has a torque; expected none for an unloaded TE"),
    (HEAD + "0, 1\n0.5, 2, 3\n", "line 3: 3 values; expected 2, one for each column"),
    (HEAD + "0, 1\n0.5, two\n", "line 3: 'two' is not a number; expected such as 0.125"),
    (HEAD + "0, 1\n0.5, nan\n", "line 3: 'nan' is not finite"),
    (HEAD + "0, 1\n0.5, 1e16\n", "line 3: '1e16' is not finite or too large"),
    (HEAD + "0, 1\n# x\n\n0.5, 2\n0.5, 3\n1, 1\n", "line 6: phase [1] = 0.5 after 0.5; expected an increasing first"),
    (HEAD + "0, 1\n1, 1\n", "holds 2 rows of numbers; expected at least 3"),
]


@pytest.mark.parametrize(("text", "words"), WRONG)
def test_what_can_not_be_read_is_one_sentence(text: str, words: str) -> None:
    with pytest.raises(PairError, match=re.escape(words)) as info:
        parse_table(text, "table 'a.csv'")
    assert "\n" not in str(info.value)
    assert str(info.value).startswith("table 'a.csv'")


def test_a_file_that_can_not_be_opened_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(PairError, match="can't be read: No such file"):
        read_table(tmp_path / "none.csv")
    with pytest.raises(PairError, match="can't be read"):
        read_table(tmp_path)
    (tmp_path / "a.csv").write_bytes(b"\xff\xfe")
    with pytest.raises(PairError, match="is not UTF-8 text"):
        read_table(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_bytes(b"\xef\xbb\xbf" + HEAD.encode() + b"0, 1\r\n.5, 2\r\n1, 1\r\n")
    assert read_table(tmp_path / "b.csv").columns[0].values.tolist() == [1e6, 2e6, 1e6]


def made(phase: np.ndarray, values: np.ndarray) -> str:
    rows = zip(phase.tolist(), values.tolist(), strict=True)
    return "phase [1], stiffness [N/m]\n" + "".join(f"{a!r}, {b!r}\n" for a, b in rows)


def wave(phase: np.ndarray) -> np.ndarray:
    return 3.0 + fourier_series([0.5, 0.0, 0.1], [0.2, -0.3, 0.0], 2 * np.pi * phase)


GRIDS = {
    "closed": np.linspace(0, 1, 33),
    "open": np.arange(16) / 16,
    "odd, shifted": 0.3 + np.arange(15) / 15,
    "several cycles": np.linspace(0, 3, 61),
    "cycles not divided evenly": np.arange(50) * 3 / 50,
    "uneven": np.linspace(0, 1, 25) + 0.01 * np.sin(2 * np.pi * np.linspace(0, 1, 25)),
    "uneven, two cycles": np.sort(np.append(np.random.default_rng(3).uniform(0, 2, 40), np.arange(0, 2.01, 0.1))),
}


@pytest.mark.parametrize("phase", GRIDS.values(), ids=GRIDS.keys())
def test_coefficients_come_back_within_1e_12(phase: np.ndarray) -> None:
    table = parse_table(made(phase, wave(phase)))
    grid = sampling(table, None)
    series = fourier_fit(table, grid, table.columns[0].values, 4)
    assert abs(series.mean - 3.0) < 1e-12
    np.testing.assert_allclose(series.cosine, [0.5, 0.0, 0.1, 0.0], atol=1e-12)
    np.testing.assert_allclose(series.sine, [0.2, -0.3, 0.0, 0.0], atol=1e-12)
    assert series.deviation < 1e-12
    np.testing.assert_allclose(series(grid.phase), table.columns[0].values, atol=1e-12)


def test_the_truncation_error_is_the_largest_distance_from_the_samples() -> None:
    phase = np.linspace(0, 1, 33)
    table = parse_table(made(phase, wave(phase)))
    series = fourier_fit(table, sampling(table, None), table.columns[0].values, 2)
    assert series.deviation == pytest.approx(0.1, rel=1e-12)  # the third harmonic, cosine 0.1 at phase 0


def check(phase: np.ndarray, values: np.ndarray, harmonics: int = 3, tolerance: float = 0.02) -> None:
    table = parse_table(made(phase, values), "table 'a.csv'")
    grid = sampling(table, None)
    check_harmonics(table, grid, harmonics)
    check_periodic(table, grid, table.columns[0].values, "stiffness", tolerance)
    fourier_fit(table, grid, table.columns[0].values, harmonics)


def test_cycles_that_do_not_repeat_or_are_not_whole_are_one_sentence() -> None:
    phase = np.linspace(0, 1, 33)
    drift = wave(phase) + 0.1 * phase
    with pytest.raises(PairError, match=r"line 34: stiffness is not periodic within 2 % .*values of line 2"):
        check(phase, drift)
    check(phase, drift, tolerance=0.1)
    ramp = np.arange(16) / 16
    with pytest.raises(PairError, match=r"line 17: .* the step back to line 2 is larger than three times any other"):
        check(ramp, 1 + ramp)
    phase = np.linspace(0, 2, 65)
    bump = wave(phase)
    bump[40] += 0.1
    with pytest.raises(PairError, match=r"line 42: .* expected the values of the first mesh cycle"):
        check(phase, bump)
    phase = np.linspace(0, 0.8, 33)
    with pytest.raises(PairError, match=r"lines 2 to 34: covers 0.8 mesh cycles; expected one or more whole cycles"):
        check(phase, wave(phase))


def test_too_few_samples_are_one_sentence() -> None:
    phase = np.linspace(0, 1, 9)
    check(phase, wave(phase), harmonics=3)
    with pytest.raises(PairError, match=r"8 samples in a mesh cycle are enough for 3 harmonics, .* expected 9 samples"):
        check(phase, wave(phase), harmonics=4)
    gap = np.append(np.linspace(0, 0.5, 20), 1.0)
    with pytest.raises(PairError, match=r"line 21: the next sample is 0.5 mesh cycles away, too far for 5 harmonics"):
        check(gap, wave(gap), harmonics=5)
