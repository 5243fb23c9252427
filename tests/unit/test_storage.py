"""Branches survive a file bit for bit, and nothing else passes for a branch."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from synthetic_branch import folded_branch, make_orbit, make_point

from continuation.branches.branch import Branch
from continuation.orbits.orbit import Orbit
from continuation.storage import load_branch, save_branch


def same_orbit(a: Orbit, b: Orbit) -> None:
    for field in dataclasses.fields(Orbit):
        x, y = getattr(a, field.name), getattr(b, field.name)
        if isinstance(x, np.ndarray):
            assert x.dtype == y.dtype
            assert x.shape == y.shape
            assert x.tobytes() == y.tobytes(), field.name  # also the sign of zero and the bits of NaN
        elif field.name == "contacts":
            assert list(x) == list(y)
            for one, other in zip(x.values(), y.values(), strict=True):
                assert [(v.dtype, v.tolist()) for v in one] == [(v.dtype, v.tolist()) for v in other]
        else:
            assert x == y, field.name
            assert type(x) is type(y), field.name


def same_branch(a: Branch, b: Branch) -> None:
    assert len(a) == len(b)
    assert len(a.special_points) == len(b.special_points)
    for x, y in zip(a.orbits, b.orbits, strict=True):
        same_orbit(x, y)
    for p, q in zip(a.special_points, b.special_points, strict=True):
        same_orbit(p.orbit, q.orbit)
        for name in ("kind", "parameter", "error", "bracket", "index", "status", "note"):
            assert getattr(p, name) == getattr(q, name), name
        assert q.problem is None
    for name in ("stop", "work", "provenance", "unresolved"):
        assert getattr(a, name) == getattr(b, name), name
    assert [type(v) for v in a.work.values()] == [type(v) for v in b.work.values()]


def test_everything_of_a_branch_comes_back(tmp_path: Path) -> None:
    branch = folded_branch()
    branch.save(tmp_path / "b.nc")
    loaded = Branch.load(tmp_path / "b.nc")
    same_branch(branch, loaded)
    assert str(loaded) == str(branch)
    assert loaded.to_dict() == branch.to_dict()
    assert [p.name for p in tmp_path.iterdir()] == ["b.nc"]


def test_a_branch_without_special_points_and_with_all_kinds_of_them(tmp_path: Path) -> None:
    bare = dataclasses.replace(folded_branch(), special_points=(), unresolved=(), work={}, provenance={}, stop="")
    save_branch(bare, tmp_path / "b.nc")
    same_branch(bare, load_branch(tmp_path / "b.nc"))
    kinds = ("fold", "period-doubling", "neimark-sacker", "branch-point", "grazing")
    points = tuple(make_point(kind, make_orbit(1.1 + i / 10), i) for i, kind in enumerate(kinds))
    guessed = dataclasses.replace(points[0], status="guessed", note='two lines\nand "quotes"', error=float("inf"))
    full = dataclasses.replace(bare, special_points=(guessed, *points[1:]), unresolved=("x" * 200,) * 1000)
    save_branch(full, tmp_path / "b.nc")
    same_branch(full, load_branch(tmp_path / "b.nc"))


def with_contacts(changes: Sequence[int]) -> Branch:
    """A branch with two contacts, one of which never changes, the other as often as told, orbit by orbit."""
    branch = folded_branch()
    orbits = tuple(
        dataclasses.replace(
            orbit,
            contacts={
                "mesh": (np.linspace(0.1, 6.0, count), np.arange(count + 1) % 3),
                "stop": (np.zeros(0), np.array([1])),
            },
            second_opinion=np.array([1e-12, np.nan]),
        )
        for orbit, count in zip((*branch.orbits, branch.special_points[0].orbit), changes, strict=True)
    )
    point = dataclasses.replace(branch.special_points[0], orbit=orbits[-1])
    return dataclasses.replace(branch, orbits=orbits[:-1], special_points=(point,))


@pytest.mark.parametrize("changes", [(2, 0, 4, 6, 2), (0, 0, 0, 0, 0), (0, 0, 0, 0, 8)])
def test_contact_patterns_of_any_length_come_back(tmp_path: Path, changes: tuple[int, ...]) -> None:
    branch = with_contacts(changes)
    branch.save(tmp_path / "b.nc")
    same_branch(branch, Branch.load(tmp_path / "b.nc"))


def test_a_file_of_an_earlier_version_still_loads(tmp_path: Path) -> None:
    branch = with_contacts((2, 0, 4, 6, 2))
    branch.save(tmp_path / "b.nc")
    with xr.open_dataset(tmp_path / "b.nc", engine="h5netcdf") as stored:
        data = stored.load()
    later = [v for v in data.variables if "contact" in str(v) or "second_opinion" in str(v)]
    assert len(later) == 9
    data.drop_vars(later).to_netcdf(tmp_path / "old.nc", engine="h5netcdf")
    loaded = Branch.load(tmp_path / "old.nc")
    for before, after in zip(branch.orbits, loaded.orbits, strict=True):
        assert after.contacts == {}
        assert np.isnan(after.second_opinion).all()
        same_orbit(dataclasses.replace(before, contacts={}, second_opinion=np.nan), after)


numbers = st.floats(allow_nan=False, width=64)


@settings(max_examples=10, deadline=None)
@given(data=st.data(), lengths=st.lists(st.integers(1, 6), min_size=1, max_size=4))
def test_any_numbers_survive(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, lengths: list[int]) -> None:
    complex_ = st.builds(complex, numbers, numbers)
    orbits = tuple(
        dataclasses.replace(
            make_orbit(1.0 + i),
            parameters={"omega": data.draw(numbers), "g": data.draw(numbers)},
            coefficients=data.draw(arrays(complex, (k, 2), elements=complex_)),
            multipliers=data.draw(arrays(complex, 2, elements=complex_)),
            error=data.draw(numbers),
            period=data.draw(numbers),
        )
        for i, k in enumerate(lengths)
    )
    branch = dataclasses.replace(folded_branch(), orbits=orbits)
    path = tmp_path_factory.mktemp("any") / "b.nc"
    with np.errstate(over="ignore", invalid="ignore"):  # the rms beside the coefficients may overflow
        save_branch(branch, path)
    same_branch(branch, load_branch(path))


def test_not_a_number_is_kept_and_not_taken_for_missing(tmp_path: Path) -> None:
    orbit = make_orbit(1.0, multipliers=(complex(np.nan, 0.0), 0.1))
    branch = dataclasses.replace(folded_branch(), orbits=(orbit,), special_points=())
    save_branch(branch, tmp_path / "b.nc")
    same_orbit(orbit, load_branch(tmp_path / "b.nc").orbits[0])


def test_the_file_explains_itself_in_plain_xarray(tmp_path: Path) -> None:
    branch = folded_branch()
    save_branch(branch, tmp_path / "b.nc")
    with xr.open_dataset(tmp_path / "b.nc", engine="h5netcdf") as data:
        assert data.sizes["point"] == 4
        assert data.sizes["special_point"] == 1
        assert data.sizes["complex"] == 2
        assert data["coefficients"].dims == ("point", "harmonic", "state", "complex")
        assert data["multipliers"].dims == ("point", "multiplier", "complex")
        assert data["harmonic_count"].values.tolist() == [2, 5, 3, 3]
        assert not np.isnan(data["coefficients"]).any()
        np.testing.assert_array_equal(data["parameter"], branch.parameter)
        np.testing.assert_array_equal(data["rms"].sel(state="x"), branch.rms("x"))
        np.testing.assert_array_equal(data["parameters"].sel(parameter_name="g"), 0.1)
        assert (
            data["coefficients"].sel(complex="imaginary", state="v")[0, 1] == branch.orbits[0].coefficients[1, 1].imag
        )
        meanings = data["stability"].attrs["flag_meanings"].split()
        assert [meanings[i] for i in data["stability"].values] == branch.stability.tolist()
        assert data.attrs["stop"] == branch.stop
        for name, variable in data.data_vars.items():
            assert variable.attrs["long_name"], name
            assert name == "special_note" or variable.attrs["units"], name


def test_an_earlier_file_is_replaced_whole_or_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "b.nc"
    branch = folded_branch()
    save_branch(branch, path)
    before = path.read_bytes()

    def fail(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("continuation.netcdf.os.replace", fail)
        with pytest.raises(KeyboardInterrupt):
            save_branch(dataclasses.replace(branch, stop="another"), path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["b.nc"]
    save_branch(dataclasses.replace(branch, stop="another"), path)
    assert load_branch(path).stop == "another"


def test_orbits_of_two_systems_and_empty_branches_are_refused(tmp_path: Path) -> None:
    branch = folded_branch()
    other = dataclasses.replace(make_orbit(1.0), system="another")
    with pytest.raises(ValueError, match=r"'synthetic' and 'another'"):
        save_branch(dataclasses.replace(branch, orbits=(*branch.orbits, other)), tmp_path / "b.nc")
    with pytest.raises(ValueError, match="at least one orbit"):
        save_branch(dataclasses.replace(branch, orbits=()), tmp_path / "b.nc")
    with pytest.raises(FileNotFoundError):
        save_branch(branch, tmp_path / "no" / "b.nc")
    assert list(tmp_path.iterdir()) == []


def _spoil(path: Path, kind: str) -> None:
    if kind == "text":
        path.write_text("period,rms\n1,2\n")
    elif kind == "empty":
        path.write_bytes(b"")
    elif kind == "cut":
        path.write_bytes(path.read_bytes()[:3000])
    else:
        with xr.open_dataset(path, engine="h5netcdf") as stored:
            data = stored.load()
        data = data.drop_vars("multipliers") if kind == "damaged" else data
        data.attrs |= {"newer": {"schema": 99}, "other": {"format": "map"}, "damaged": {}}[kind]
        data.to_netcdf(path, engine="h5netcdf")


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("text", "not a readable netCDF file"),
        ("empty", "not a readable netCDF file"),
        ("cut", "not a readable netCDF file"),
        ("other", "without a continuation branch"),
        ("newer", "schema 99"),
        ("damaged", "is damaged"),
    ],
)
def test_anything_else_is_refused_in_one_sentence(tmp_path: Path, kind: str, message: str) -> None:
    path = tmp_path / "b.nc"
    save_branch(folded_branch(), path)
    _spoil(path, kind)
    with pytest.raises(ValueError, match=message) as caught:
        load_branch(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_files_and_folders_are_told_by_the_system(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        load_branch(tmp_path / "none.nc")
    with pytest.raises(IsADirectoryError):
        load_branch(tmp_path)
