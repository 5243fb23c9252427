"""Normal forms of special points as variables of a branch file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from continuation.branches.branch import SpecialPoint
from continuation.branches.criticality import NormalForm
from continuation.netcdf import about, pairs, unpaired


def form_variables(points: Sequence[SpecialPoint], n: int) -> dict[str, Any]:
    """Return the normal forms of special points, NaN and empty where there is none; n states."""
    row = "special_point"
    forms = [p.form for p in points]
    numbers = {
        "coefficient": "coefficient of the normal form",
        "error": "estimated error of the coefficient",
        "rotation_number": "angle of the critical multiplier over 2 pi",
    }
    variables: dict[str, Any] = {}
    for name, text in numbers.items():
        values = [np.nan if form is None else float(getattr(form, name)) for form in forms]
        variables[f"special_form_{name}"] = (row, np.array(values, dtype=float), about(text, "1"))
    for name in ("criticality", "reason"):  # texts
        texts = np.array(["" if form is None else getattr(form, name) for form in forms], dtype=object)
        variables[f"special_form_{name}"] = (row, texts, about(f"{name} of the bifurcation", "text"))
    for name, side in (("null_vector", "critical"), ("left_vector", "left critical")):
        vectors = np.full((len(points), n), np.nan, dtype=complex)
        for i, form in enumerate(forms):
            if form is not None and len(getattr(form, name)) == n:
                vectors[i] = getattr(form, name)
        text = f"{side} eigenvector of the monodromy matrix at phase 0"
        variables[f"special_form_{name}"] = ((row, "state", "complex"), pairs(vectors), about(text, "1"))
    return variables


def load_form(data: xr.Dataset, i: int) -> NormalForm | None:
    """Return the normal form of a special point, None where it has none or the file is of an earlier version."""
    if "special_form_null_vector" not in data:
        return None
    vector = unpaired(data["special_form_null_vector"].values[i])
    if np.isnan(vector).all():
        return None
    rotation = float(data["special_form_rotation_number"].values[i])
    left = np.full(0, np.nan)
    if "special_form_left_vector" in data:
        left = unpaired(data["special_form_left_vector"].values[i])
    left = np.zeros(0) if np.isnan(left).any() else left
    return NormalForm(
        coefficient=float(data["special_form_coefficient"].values[i]),
        error=float(data["special_form_error"].values[i]),
        criticality=str(data["special_form_criticality"].values[i]),  # type: ignore[arg-type]
        reason=str(data["special_form_reason"].values[i]),
        null_vector=vector if np.isfinite(rotation) else vector.real,
        left_vector=left if np.isfinite(rotation) else left.real,
        rotation_number=rotation,
    )
