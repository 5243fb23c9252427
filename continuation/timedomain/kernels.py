"""Call CasADi functions through fixed NumPy buffers, one at a time or in batches."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

BATCH = 16
"""Evaluations per call of a :class:`Batch`."""


class Kernel:
    """Call a CasADi function through fixed NumPy buffers: a few microseconds instead of tens for small functions.

    Examples
    --------
    >>> x = ca.SX.sym("x", 2)
    >>> Kernel(ca.Function("f", [x], [2 * x, x[0] * x.T]))([1.0, 3.0])
    (array([2., 6.]), array([[1., 3.]]))
    """

    def __init__(self, function: ca.Function) -> None:
        symbols = function.mx_in()
        dense = ca.Function(function.name(), symbols, [ca.densify(e) for e in function.call(symbols)])
        same = all(function.sparsity_out(i).is_dense() for i in range(function.n_out()))
        buffer: Any
        buffer, self.evaluate = (function if same else dense).buffer()
        self._buffer = buffer  # kept: it owns the memory that the evaluation reads
        self.inputs = [np.zeros(_shape(function.size_in(i)), order="F") for i in range(function.n_in())]
        self.outputs = [np.zeros(_shape(function.size_out(i)), order="F") for i in range(function.n_out())]
        for i, array in enumerate(self.inputs):
            self._buffer.set_arg(i, array.reshape(-1, order="F").data)
        for i, array in enumerate(self.outputs):
            self._buffer.set_res(i, array.reshape(-1, order="F").data)

    def __call__(self, *values: np.ndarray | list[float] | float) -> tuple[np.ndarray, ...]:
        """Return new arrays; column vectors are flat, scalars have shape (1,)."""
        for array, value in zip(self.inputs, values, strict=True):
            array[...] = value
        self.evaluate()
        return tuple(a.copy() for a in self.outputs)


class Batch:
    """Evaluate a CasADi function at many points, ``BATCH`` of them per call.

    Arguments have the points along their first axis: scalars (N,), vectors (N, n). Results are (N, columns, rows), so
    that a column vector comes as (N, 1, rows).

    Examples
    --------
    >>> x, a = ca.SX.sym("x", 2), ca.SX.sym("a")
    >>> Batch(ca.Function("f", [x, a], [a * x]))(np.array([[1.0, 3.0], [0.0, 1.0]]), np.array([2.0, 5.0]))[0].tolist()
    [[[2.0, 6.0]], [[0.0, 5.0]]]
    """

    def __init__(self, function: ca.Function) -> None:
        self._kernel = Kernel(function.map(BATCH))
        self._sizes = [function.size_out(i) for i in range(function.n_out())]

    def __call__(self, *values: np.ndarray) -> list[np.ndarray]:
        """Return one array per result."""
        count = len(values[0])
        results = [np.empty((count, columns, rows)) for rows, columns in self._sizes]
        for k in range(0, count, BATCH):
            few = min(BATCH, count - k)  # what is left of the buffers is computed and not looked at
            for buffer, value in zip(self._kernel.inputs, values, strict=True):
                if value.ndim == 1:
                    buffer[0, :few] = value[k : k + few]
                else:
                    buffer[:, :few] = value[k : k + few].T
            self._kernel.evaluate()
            for (_, columns), buffer, result in zip(self._sizes, self._kernel.outputs, results, strict=True):
                result[k : k + few] = buffer.T[: few * columns].reshape(few, columns, -1)
        return results


def _shape(size: tuple[int, int]) -> tuple[int, ...]:
    return size if size[1] != 1 else size[:1]
