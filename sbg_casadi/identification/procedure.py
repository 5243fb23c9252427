"""Find unknown numbers of a pair from targets: global search, gradient refinement, check in the time domain."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sbg_casadi.errors import PairError, UserError
from sbg_casadi.identification.addresses import MOST_HARMONICS
from sbg_casadi.identification.assembly import Parts, agree, put_together, unchecked, values_of
from sbg_casadi.identification.checking import check_targets
from sbg_casadi.identification.outcome import Identification, Settings
from sbg_casadi.identification.parametric import Parametric, parametric
from sbg_casadi.identification.refinement import NO_ORBIT, Model, build_model, refine
from sbg_casadi.identification.runs import Runs
from sbg_casadi.identification.scoring import Score, cost, lost, score
from sbg_casadi.identification.search import Archive, search
from sbg_casadi.identification.targets_file import TargetsFile, load_targets, read_targets, selected
from sbg_casadi.identification.unknowns import Candidates
from sbg_casadi.pair import Pair, folder_of, load_pair

Tell = Callable[[str, float, str], None]
"""Told the stage, the fraction of it that is done, and a line of text."""

_SUFFIX = "-calibrated"
_PATH = (1.0, 0.5, 0.25)  # of the way from a start to where the refinement leads


def identify(
    pair: str | os.PathLike[str],
    targets: str | os.PathLike[str] | Mapping[str, Any],
    *,
    state: str | None = None,
    unknowns: str | None = None,
    settings: Settings | None = None,
    command: str = "sbg_casadi.identify",
    start: Sequence[np.ndarray] = (),
    tell: Tell | None = None,
) -> Identification:
    """Find the unknowns of a targets file.

    Parameters
    ----------
    pair : str or path
        Built-in case or pair file; gives all that is not looked for.
    targets : str, path or mapping
        Path of a targets file, the name of a built-in one, or the parsed content of one.
    state : str, optional
        Meet the targets of this state alone, with its own unknowns and those that states share.
    unknowns : str, optional
        Look for the unknowns alone whose keys fit this pattern, such as ``states.after.*``; others keep their values.
    settings : Settings, optional
    command : str
        Written into the note of every value found.
    start : sequence of ndarray (n,)
        Coordinates to begin with, besides the values that the pair has.
    tell : callable, optional
        Told the progress.

    Returns
    -------
    Identification
        Also after a KeyboardInterrupt, with the best so far and ``complete`` False.

    Raises
    ------
    UserError
        If a file can't be used, or there is no pair inside the bounds.

    Notes
    -----
    Targets are met in the sense of least squares over their tolerances (see
    :func:`~sbg_casadi.identification.scoring.cost`). Regimes and exponents bound the values but have no gradient.

    Examples
    --------
    >>> from sbg_casadi.identification import Settings, identify
    >>> wanted = {"unknowns": [{"key": "dimensionless.stiffness_cosine.1", "bounds": [0.25, 0.35]}],
    ...           "targets": [{"kind": "rms", "at": 2.5, "value": 0.009, "tolerance": 1e-4}]}
    >>> found = identify("example", wanted, settings=Settings(evaluations=0))
    >>> round(found.found["dimensionless.stiffness_cosine.1"], 3)
    0.325
    """
    loaded = load_pair(pair)
    wanted = read_targets(targets, loaded) if isinstance(targets, Mapping) else load_targets(targets, loaded)
    wanted = selected(wanted, state, unknowns)
    work = _Work(loaded, wanted, folder_of(pair), settings or Settings(), command, tell or _nobody)
    try:
        work.search(start)
        work.refine()
    except KeyboardInterrupt:
        work.complete = False
        work.notes.append("interrupted: the values are the best found until then")
    return work.result()


def _nobody(stage: str, part: float, text: str) -> None:
    """Report to nobody."""


class _Work:
    """The stages of an identification and what they have found."""

    def __init__(
        self, pair: Pair, targets: TargetsFile, folder: Path, settings: Settings, command: str, tell: Tell
    ) -> None:
        self.settings, self.targets, self.tell = settings, targets.targets, tell
        self.candidates = Candidates(pair, targets.unknowns, folder, f"found by {command}")
        self.name = pair.name if pair.name.endswith(_SUFFIX) else pair.name + _SUFFIX
        self.equations = _equations(pair, targets)
        self.runs = Runs(self.equations)
        self.archive, self.complete = Archive(), True
        given = self.candidates.given()
        self.given = np.where(np.isnan(given), 0.5, given)
        self.best: tuple[np.ndarray, float] | None = None
        self.notes: list[str] = []

    # ------------------------------------------------------------------------------------------- search
    def score(self, t: np.ndarray, limit: float = np.inf) -> Score:
        """Return the cheap score of a candidate."""
        try:
            states = self.candidates.states(t)
        except PairError:
            return lost(self.targets)
        return score(self.runs, self.targets, states, limit)

    def search(self, start: Sequence[np.ndarray]) -> None:
        """Search the whole range, beginning with the values that the pair has."""
        first = [*start, self.given]
        try:
            search(
                self.score,
                len(self.given),
                evaluations=max(self.settings.evaluations, len(first)),
                seed=self.settings.seed,
                start=first,
                near=self.settings.near,
                progress=lambda part, text: self.tell("search", part, text),
                archive=self.archive,
            )
        finally:
            if len(self.archive):
                i = self.archive.best(1)[0]
                self._offer(self.archive.coordinates[i], self.archive.scores[i].cost)

    def _offer(self, t: np.ndarray, value: float) -> None:
        if self.best is None or value < self.best[1]:
            self.best = t.copy(), value

    # ------------------------------------------------------------------------------------------- refinement
    def refine(self) -> None:
        """Refine the best candidates one after the other; a result counts only if all targets together gain."""
        chosen = self.archive.best(self.settings.refined)
        for number, i in enumerate(chosen):
            t = self.archive.coordinates[i]
            part, text = number / len(chosen), f"candidate {number + 1} of {len(chosen)}"
            self.tell("refinement", part, text)
            try:
                model = self._model(t)
                self._offer(t, self.assess(t, model))
            except NO_ORBIT as error:
                self.notes.append(f"candidate {number + 1} was not refined: {error}")
                continue

            def tell(squares: float, part: float = part, text: str = text) -> None:
                self.tell("refinement", part, f"{text}, sum of squares {squares:.4g}")

            end = refine(model, t, steps=self.settings.steps, tell=tell)
            for share in _PATH:
                at = t + share * (end - t)
                value = self.assess(at, model)
                self._offer(at, value)
                if value <= self.best[1]:  # type: ignore[index]
                    break

    def _model(self, t: np.ndarray) -> Model:
        return build_model(self.candidates, self.equations, self.runs, self.targets, t)

    def assess(self, t: np.ndarray, model: Model) -> float:
        """Return the cost of a candidate with the followed targets taken from their orbits.

        Where the run in time leads to something else, such as another peak that has become the highest, it counts.
        """
        cheap = self.score(t)
        try:
            own = model.residuals(t)
        except NO_ORBIT:
            return cheap.cost
        r, place = cheap.residuals.copy(), 0
        measured = dict(zip((target.name for target in self.targets), cheap.measured, strict=True))
        for follower in model.followers:
            count = len(follower.target.labels)
            exact = own[place : place + count]
            if agree(follower.target, values_of(follower.target, exact), measured[follower.target.name]):
                r[follower.place : follower.place + count] = exact
            place += count
        return cost(r)

    # ------------------------------------------------------------------------------------------- result
    def result(self) -> Identification:
        """Check the best candidate in the time domain and judge what the data determine."""
        if self.best is None:
            raise KeyboardInterrupt
        t = self.best[0]
        try:
            pair = self.candidates.at(t, self.name)
        except PairError as error:
            raise UserError(f"no candidate inside the bounds is a pair: {error}") from None
        cheap = self.score(t)
        model, matrix, own = None, np.zeros((0, len(t))), np.zeros(0)
        try:
            self.tell("check", 0.0, "sensitivities")
            model, matrix, own = self._sensitivity(t)
            checked = check_targets(
                pair, self.equations, self.targets, lambda part, text: self.tell("check", part, text)
            )
        except KeyboardInterrupt:
            self.complete = False
            self.notes.append("interrupted: the values are not checked, what they lead to is that of the search")
            checked = [unchecked(target, m) for target, m in zip(self.targets, cheap.measured, strict=True)]
        parts = Parts(
            pair,
            self.candidates.unknowns,
            tuple(self.targets),
            t,
            model,
            own,
            matrix,
            tuple(checked),
            cheap,
            self.archive,
            self.notes,
            self.complete,
        )
        return put_together(parts)

    def _sensitivity(self, t: np.ndarray) -> tuple[Model | None, np.ndarray, np.ndarray]:
        try:
            model = self._model(t)
            if not model.followers:
                return model, np.zeros((0, len(t))), np.zeros(0)
            own, matrix = model.linearise(t)
        except NO_ORBIT as error:
            self.notes.append(f"sensitivities could not be computed: {error}")
            return None, np.zeros((0, len(t))), np.zeros(0)
        return model, matrix, own


def _equations(pair: Pair, targets: TargetsFile) -> Parametric:
    """Return the equations with as many harmonics as pair and unknowns have."""
    counts = {"stiffness": 1, "error": 0}
    for state in pair.states:
        d = pair.dimensionless(state)
        counts["stiffness"] = max(counts["stiffness"], len(d.stiffness_cosine))
        counts["error"] = max(counts["error"], len(d.error_cosine) if any((*d.error_cosine, *d.error_sine)) else 0)
    for key in (key for u in targets.unknowns for key in u.keys):
        *_, series, index = ("", *key.split("."))
        group = series.split("_")[0]
        if index.isdecimal() and group in counts:
            counts[group] = max(counts[group], min(int(index), MOST_HARMONICS))
    return parametric(pair.dimensionless(), counts["stiffness"], counts["error"])
