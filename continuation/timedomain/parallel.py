"""Sweeps up and down side by side in two processes."""

from __future__ import annotations

import logging
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from queue import Empty
from typing import Any

import numpy as np

from continuation.model.system import System
from continuation.timedomain.cvodes import CVODES
from continuation.timedomain.sweep import Progress, Sweep, SweepTask, task

logger = logging.getLogger(__name__)

_reports: Any = None
"""In a worker: the queue on which it tells that a value is done."""


def up_and_down(
    system: System,
    parameter: str,
    values: Sequence[float] | np.ndarray,
    *,
    quantity: str,
    method: CVODES | None = None,
    start: Sequence[float] | np.ndarray | None = None,
    transient: int = 32,
    limit: int = 400,
    recorded: int = 64,
    tolerance: float = 1e-7,
    march: str = "",
    workers: int = 2,
    progress: Progress | None = None,
) -> tuple[Sweep, Sweep]:
    """Sweep over the values in increasing and in decreasing order.

    Parameters
    ----------
    values : array (k,)
        In any order.
    workers : int
        Processes; with 1 the sweeps run one after the other in this process, with the same results.
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
    settings = (quantity, method, start, transient, limit, recorded, tolerance, march)
    tasks = [task(system, parameter, v, *settings) for v in (ordered, ordered[::-1])]
    up, down = run_all(tasks, workers, progress)
    return up, down


def run_all(tasks: Sequence[SweepTask], workers: int = 2, progress: Progress | None = None) -> list[Sweep]:
    """Run sweeps side by side; results in the order of the tasks, equal to those of running one after the other.

    Raises
    ------
    ValueError
        If the number of workers is not positive.
    """
    if workers < 1:
        raise ValueError(f"workers: expected at least 1, got {workers}")
    if workers > 1 and len(tasks) > 1:
        try:
            return _run_in_pool(tasks, workers, progress)
        except (OSError, BrokenProcessPool, AssertionError) as error:
            logger.warning("sweeps run one after the other, because worker processes can't be started: %s", error)
    total = sum(len(t.values) for t in tasks)
    results: list[Sweep] = []
    for t in tasks:
        results.append(t.run(_shifted(progress, sum(len(r.values) for r in results), total)))
    return results


def _shifted(progress: Progress | None, before: int, total: int) -> Progress | None:
    return None if progress is None else lambda done, _: progress(before + done, total)


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
    while not all(f.done() for f in futures):
        if progress is None:
            wait(futures)
            continue
        try:
            reports.get(timeout=0.2)
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
