"""Sweeps side by side: in two threads, in two processes, or with any executor."""

from __future__ import annotations

import logging
import multiprocessing
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np

from continuation.model.machine_code import find_compiler
from continuation.model.system import System
from continuation.timedomain.cvodes import CVODES
from continuation.timedomain.fixed_step import FixedStep
from continuation.timedomain.parts import Keeper
from continuation.timedomain.period_map import Integrator
from continuation.timedomain.sweep import Progress, Sweep, SweepTask, one_integrator, task
from continuation.timedomain.sweep_result import joined

logger = logging.getLogger(__name__)

_PART = 16  # values with a start of their own that go to a worker together

_reports: Any = None
"""In a worker: the queue on which it tells that a value is done."""


def up_and_down(
    system: System,
    parameter: str,
    values: Sequence[float] | np.ndarray,
    *,
    quantity: str,
    load: str = "",
    integrator: Integrator | None = None,
    method: CVODES | None = None,
    start: Sequence[float] | np.ndarray | None = None,
    transient: int = 32,
    limit: int = 400,
    recorded: int = 64,
    tolerance: float = 1e-7,
    march: str = "",
    workers: int = 2,
    executor: Executor | None = None,
    resume: str | Path = "",
    progress: Progress | None = None,
) -> tuple[Sweep, Sweep]:
    """Sweep over the values in increasing and in decreasing order.

    Parameters
    ----------
    values : array (k,)
        In any order.
    start : array (n,), optional
        State at phase 0 before the first value of each direction.
    workers : int
        With 1 the sweeps run one after the other in this thread, else side by side: fixed steps in machine code in
        threads, the rest in processes. The results are the same.
    executor : concurrent.futures.Executor, optional
        Runs the two sweeps instead, in other processes or on other machines if it likes.
    resume : str or Path
        Folder in which ``up.nc`` and ``down.nc`` keep finished values; a rerun with the same arguments goes on there.
    progress : callable, optional
        Called in this process with the number of values done and of all values, both directions together.

    The other arguments, the errors and the notes are those of :func:`~continuation.timedomain.sweep.sweep`.

    Returns
    -------
    tuple of Sweep
        Up and down.

    Notes
    -----
    Worker processes import the calling program's main module, as always with ``multiprocessing``: a script needs the
    usual ``if __name__ == "__main__":``. Where processes can't be started, the reason is logged as a warning and the
    sweeps run here.
    """
    ordered = np.sort(np.ravel(np.asarray(values, dtype=float)))
    settings = (quantity, load, one_integrator(integrator, method), start, transient, limit, recorded, tolerance, march)
    tasks = [task(system, parameter, v, *settings) for v in (ordered, ordered[::-1])]
    if len(tasks[0].starts) > 1:
        raise ValueError("up_and_down: start must be one state; sweep takes one for each value")
    if resume:
        Path(resume).mkdir(parents=True, exist_ok=True)
        files = (str(Path(resume) / f"{name}.nc") for name in ("up", "down"))
        tasks = [replace(t, resume=f) for t, f in zip(tasks, files, strict=True)]
    up, down = run_all(tasks, workers, progress, executor)
    return up, down


def run_all(
    tasks: Sequence[SweepTask], workers: int = 2, progress: Progress | None = None, executor: Executor | None = None
) -> list[Sweep]:
    """Run sweeps side by side; results in the order of the tasks, equal to those of running one after the other.

    Raises
    ------
    ValueError
        If the number of workers is not positive.
    """
    if workers < 1:
        raise ValueError(f"workers: expected at least 1, got {workers}")
    if executor is not None:
        return _run_with(executor, tasks, progress)
    if workers > 1 and len(tasks) > 1:
        if all(t.integrator is None or isinstance(t.integrator, FixedStep) for t in tasks) and find_compiler():
            return _run_in_threads(tasks, workers, progress)
        try:
            return _run_in_pool(tasks, workers, progress)
        except (OSError, BrokenProcessPool, AssertionError) as error:
            logger.warning("sweeps run one after the other, because worker processes can't be started: %s", error)
    total = sum(len(t.values) for t in tasks)
    results: list[Sweep] = []
    for t in tasks:
        results.append(t.run(_shifted(progress, sum(len(r.values) for r in results), total)))
    return results


def run_in_parts(whole: SweepTask, executor: Executor, progress: Progress | None) -> Sweep:
    """Run a sweep whose values have a start each, 16 values at a time; with one start for all it stays whole."""
    if len(whole.starts) == 1:
        return _run_with(executor, [whole], progress)[0]
    keeper = Keeper(Path(whole.resume), whole.fingerprint) if whole.resume else None
    before = keeper.load() if keeper else None
    known = [] if before is None else [before]
    count = sum(len(s.values) for s in known)
    bare, cuts = replace(whole, resume=""), range(count, len(whole.values), _PART)
    parts = [replace(bare, values=bare.values[i : i + _PART], starts=bare.starts[i : i + _PART]) for i in cuts]
    finished: list[Sweep] = []

    def keep(results: list[Sweep]) -> None:
        finished[:] = results
        if keeper and results:
            keeper.keep(lambda: joined([*known, *results]))

    try:
        return joined([*known, *_run_with(executor, parts, progress, keep, count)])
    finally:
        if keeper and finished:
            keeper.keep(lambda: joined([*known, *finished]), now=True)


def _run_with(
    executor: Executor,
    tasks: Sequence[SweepTask],
    progress: Progress | None,
    keep: Callable[[list[Sweep]], None] | None = None,
    done: int = 0,
) -> list[Sweep]:
    """Run tasks with an executor; ``keep`` is told the results of all tasks before the first that is not finished."""
    futures = {executor.submit(_run_plain, t): t for t in tasks}
    total = done + sum(len(t.values) for t in tasks)
    try:
        for future in as_completed(futures):
            future.result()
            done += len(futures[future].values)
            if keep:
                keep(_finished(futures))
            if progress:
                progress(done, total)
    except BaseException:
        for future in futures:
            future.cancel()
        if keep:
            keep(_finished(futures))
        raise
    return [future.result() for future in futures]


def _finished(futures: Iterable[Future[Sweep]]) -> list[Sweep]:
    """Return the results before the first that is not there."""
    there = takewhile(lambda f: f.done() and not f.cancelled() and f.exception() is None, futures)
    return [future.result() for future in there]


def _run_plain(t: SweepTask) -> Sweep:
    return t.run()


def _shifted(progress: Progress | None, before: int, total: int) -> Progress | None:
    return None if progress is None else lambda done, _: progress(before + done, total)


# -------------------------------------------------------------------------------------------- threads
class _Stopped(Exception):
    """The main thread wants no more values."""


def _run_in_threads(tasks: Sequence[SweepTask], workers: int, progress: Progress | None) -> list[Sweep]:
    """Run sweeps in threads; an interrupt ends them after the values they are at."""
    stop, reports = threading.Event(), SimpleQueue[int]()

    def between(done: int, total: int) -> None:
        reports.put(done)
        if stop.is_set():
            raise _Stopped

    with ThreadPoolExecutor(min(workers, len(tasks))) as pool:
        futures = [pool.submit(t.run, between) for t in tasks]
        try:
            _follow(futures, reports, sum(len(t.values) for t in tasks), progress)
        finally:
            stop.set()  # where this point is reached without an error, all of them are done
        return [f.result() for f in futures]


# -------------------------------------------------------------------------------------------- processes
def _run_in_pool(tasks: Sequence[SweepTask], workers: int, progress: Progress | None) -> list[Sweep]:
    # Spawned, not forked: the parent may run threads of numerical libraries, which a fork can leave locked.
    context = multiprocessing.get_context("spawn")
    reports = context.Queue()
    with ProcessPoolExecutor(min(workers, len(tasks)), context, _remember, (reports if progress else None,)) as pool:
        futures = [pool.submit(_run_here, t) for t in tasks]
        _follow(futures, reports, sum(len(t.values) for t in tasks), progress)
        return [f.result() for f in futures]


def _follow(futures: list[Future], reports: Any, total: int, progress: Progress | None) -> None:
    done = 0
    take: Callable[..., Any] = reports.get
    while not all(f.done() for f in futures):
        if progress is None:
            wait(futures, timeout=0.5)  # short, so that an interrupt is heard
            continue
        try:
            take(timeout=0.2)
        except Empty:
            continue
        done += 1
        progress(done, total)
    if progress and done < total and not any(f.exception() is not None for f in futures):
        progress(total, total)


def _remember(reports: Any) -> None:
    global _reports
    _reports = reports


def _run_here(t: SweepTask) -> Sweep:
    return t.run(_reports and (lambda done, total: _reports.put(done)))
