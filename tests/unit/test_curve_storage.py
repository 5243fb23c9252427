"""Curves and normal forms are stored without loss, summed up for JSON, and drawn as what they are."""

import dataclasses
import json

import numpy as np
import pytest
import xarray as xr
from synthetic_branch import folded_branch, make_orbit

from continuation.branches.branch import Branch
from continuation.branches.codimension_two import CurvePoint
from continuation.branches.criticality import NormalForm
from continuation.branches.tracked import Curve
from continuation.plotting import CURVE_MARKER, plot_curve


def torus_curve() -> Curve:
    orbits = tuple(make_orbit(p) for p in (1.0, 1.1, 1.2))
    points = (CurvePoint("extremum", (1.05, 0.29), (1e-9, 2e-9), 0), CurvePoint("1:3", (1.2, 0.5), (np.inf, 0.0), 2))
    values, error = np.array([[1.0, 0.3], [1.1, 0.35], [1.2, 0.5]]), np.full((3, 2), 1e-10)
    rotation = np.array([0.1, 0.2, 1 / 3])
    return Curve("neimark-sacker", ("g", "h"), values, error, rotation, orbits, points, "reached h = 0.5", ("a note",))


def with_form(form: NormalForm | None) -> Branch:
    branch = folded_branch()
    point = dataclasses.replace(branch.special_points[0], form=form)
    return dataclasses.replace(branch, special_points=(point,))


def test_a_curve_comes_back_as_it_was(tmp_path):
    curve = torus_curve()
    curve.save(tmp_path / "curve.nc")
    back = Curve.load(tmp_path / "curve.nc")
    assert (back.kind, back.parameters, back.stop, back.notes) == (
        curve.kind,
        curve.parameters,
        curve.stop,
        curve.notes,
    )
    for name in ("values", "error", "rotation_number"):
        np.testing.assert_array_equal(getattr(back, name), getattr(curve, name))
    for mine, its in zip(curve.points, back.points, strict=True):
        assert dataclasses.astuple(mine) == dataclasses.astuple(its)
    for mine, its in zip(curve.orbits, back.orbits, strict=True):
        np.testing.assert_array_equal(mine.coefficients, its.coefficients)
        assert mine.parameters == its.parameters
    assert str(back) == str(curve)


def test_a_curve_without_points_of_codimension_two(tmp_path):
    curve = dataclasses.replace(torus_curve(), points=(), notes=())
    curve.save(tmp_path / "curve.nc")
    assert Curve.load(tmp_path / "curve.nc").points == ()


def test_every_variable_of_a_curve_file_explains_itself(tmp_path):
    torus_curve().save(tmp_path / "curve.nc")
    with xr.open_dataset(tmp_path / "curve.nc", engine="h5netcdf") as data:
        assert data["values"].dims == ("point", "axis")
        assert data["axis"].values.tolist() == ["g", "h"]
        assert all(v.attrs["long_name"] and v.attrs["units"] for v in data.data_vars.values())


def test_a_branch_is_no_curve(tmp_path):
    folded_branch().save(tmp_path / "branch.nc")
    with pytest.raises(ValueError, match="without a continuation curve"):
        Curve.load(tmp_path / "branch.nc")


def test_the_summary_is_json():
    found = json.loads(json.dumps(torus_curve().to_dict(), allow_nan=False))
    assert found["parameters"] == ["g", "h"]
    assert [p["rotation_number"] for p in found["points"]] == [0.1, 0.2, 1 / 3]
    assert found["special_points"][1] == {"kind": "1:3", "values": [1.2, 0.5], "error": [None, 0.0], "index": 2}


@pytest.mark.parametrize("name", ["torus", "doubling", "none"])
def test_normal_forms_are_kept(tmp_path, name):
    n = len(folded_branch().orbits[0].state_names)
    vector = np.linspace(0.1, 1.0, n)
    forms = {
        "torus": NormalForm(-0.1, 1e-9, "supercritical", "", vector + 1j * vector[::-1], 0.3),
        "doubling": NormalForm(np.nan, np.nan, "undetermined", "near grazing", vector, left_vector=vector[::-1]),
        "none": None,
    }
    branch = with_form(forms[name])
    branch.save(tmp_path / "b.nc")
    (point,) = Branch.load(tmp_path / "b.nc").special_points
    if name == "none":
        assert point.form is None
        assert point.criticality == ""
        return
    mine = branch.special_points[0].form
    assert point.form.null_vector.dtype == mine.null_vector.dtype
    for part in ("coefficient", "error", "null_vector", "left_vector", "rotation_number"):
        np.testing.assert_array_equal(getattr(point.form, part), getattr(mine, part))
    assert (point.criticality, point.form.reason) == (mine.criticality, mine.reason)
    entry = json.loads(json.dumps(branch.to_dict(), allow_nan=False))["special_points"][0]
    assert entry["criticality"] == mine.criticality
    assert ("coefficient" in entry) == (name == "torus")
    assert str(mine) in str(point)


def test_a_curve_is_drawn_with_its_points():
    curve = torus_curve()
    ax = plot_curve(curve, label="torus")
    line, *marks = ax.get_lines()
    assert line.get_gid() == "neimark-sacker"
    np.testing.assert_array_equal(np.column_stack(line.get_data()), curve.values)
    assert [m.get_gid() for m in marks] == ["extremum", "1:3"]
    assert [m.get_marker() for m in marks] == [CURVE_MARKER["extremum"], CURVE_MARKER["1:3"]]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("g", "h")
