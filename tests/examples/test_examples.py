"""Every example script runs and returns the numbers it promises."""

import runpy
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


def run(name):
    """Return what the main function of an example returns."""
    return runpy.run_path(str(EXAMPLES / name))["main"]()


def test_duffing():
    result = run("01_duffing.py")
    assert result["folds"] == pytest.approx([1.2696019555, 1.1157002518], abs=2e-10)  # AUTO-07p
    assert result["fold by shooting"] == pytest.approx(1.2696019555, abs=1e-9)
    assert result["branch"].stop == "reached omega = 2"
    folds = np.array([[o.parameters["g"], o.parameters["omega"]] for o in result["curve"].orbits])
    folds = folds[np.argsort(folds[:, 0])]
    assert folds[[0, -1], 0] == pytest.approx([0.15, 0.2], abs=1e-9)
    assert np.all(np.diff(folds[:, 1]) > 0)  # the stronger the load, the further the jump
    assert np.interp(0.18, *folds.T) == pytest.approx(1.2696019555, abs=1e-4)


def test_backlash_oscillator():
    result = run("02_backlash_oscillator.py")
    assert sorted(result["folds"]) == pytest.approx([0.70803162, 0.82846398], abs=1e-8)  # event-exact reference
    assert result["rms"] == pytest.approx(0.13308283, abs=1e-7)
    assert result["dynamic factor"] == pytest.approx(2.69255, abs=2e-5)
    assert result["smallest"] > -1.0  # the other flank is not reached
    assert 0.3 < result["separated"] < 0.45


def test_gear_pair():
    result = run("03_gear_pair.py")
    before, after = result["branches"]["before"], result["branches"]["after"]
    for branch in (before, after):
        assert [p.kind for p in branch.special_points if p.kind != "grazing"] == ["fold", "fold"]
        assert all(p.error < 1e-8 for p in branch.special_points)
        assert branch.unresolved == ()
    folds = [[p.parameter for p in b.special_points if p.kind == "fold"] for b in (before, after)]
    hanging = [max(f) - min(f) for f in folds]
    assert hanging[1] < hanging[0] / 3  # far less of a jump after the modification
    assert result["largest rms"]["before"] == pytest.approx(0.757, abs=2e-3)
    assert result["largest rms"]["after"] == pytest.approx(0.505, abs=2e-3)
    assert result["reduction"] == pytest.approx(0.333, abs=4e-3)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda p: p.name)
def test_every_example_is_tested_here(path):
    assert f'run("{path.name}")' in Path(__file__).read_text()
