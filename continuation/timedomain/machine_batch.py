"""Machine code that evaluates a CasADi function at many points, and that makes the step matrices of many steps."""

from __future__ import annotations

import ctypes

import casadi as ca
import numpy as np
from scipy.integrate import DOP853

from continuation.model.machine_code import library


class MachineBatch:
    """Evaluate a function of SX at many points in compiled code; see :class:`~continuation.timedomain.kernels.Batch`.

    Raises
    ------
    NoMachineCode
        Where it can't be had; the message is the reason.
    """

    def __init__(self, function: ca.Function) -> None:
        function = _dense(function)
        self._lengths = [function.numel_in(i) for i in range(function.n_in())]
        self._sizes = [function.size_out(i) for i in range(function.n_out())]
        self._load(_generated(function) + _LOOP.replace("NAME", function.name()))

    def _load(self, source: str) -> None:
        self._many = ctypes.CDLL(library(source)).many
        self._many.argtypes = [ctypes.c_long] + [ctypes.c_void_p] * 3
        self._many.restype = ctypes.c_int

    def __call__(self, *values: np.ndarray) -> list[np.ndarray]:
        """Return one array (N, columns, rows) per result; arguments are (N,) or (N, n)."""
        count = len(values[0])
        given = [np.ascontiguousarray(v, dtype=float) for v in values]
        results = [np.empty((count, columns, rows)) for rows, columns in self._sizes]
        inputs = (ctypes.c_void_p * len(given))(*(v.ctypes.data for v in given))
        outputs = (ctypes.c_void_p * len(results))(*(r.ctypes.data for r in results))
        lengths = (ctypes.c_long * (len(given) + len(results)))(*self._lengths, *(r * c for r, c in self._sizes))
        if self._many(count, inputs, outputs, lengths):
            raise MemoryError(f"no memory for the step matrices of {self._lengths[0]} states")
        return results


class MachineTransition(MachineBatch):
    """Step matrices from the stages of a step, with fused sums: 6 microseconds a step for a 14-state gear.

    Parameters
    ----------
    stages : casadi.Function
        (x, theta, h, p, slopes, intercepts) -> trace, contact arguments (m, 12), Jacobians of the 12 stages.
    """

    def __init__(self, stages: ca.Function) -> None:
        pattern = stages.sparsity_out(2)
        n, symbols = pattern.size1(), stages.mx_in()
        trace, met, *slopes = stages.call(symbols)
        entries = ca.horzcat(*(ca.densify(ca.vertcat(*_nonzeros(slope))) for slope in slopes))
        flat = _dense(ca.Function("stages", symbols, [trace, met, entries]).expand())
        self._lengths = [flat.numel_in(i) for i in range(flat.n_in())]
        self._sizes = [(n, n), (2, n), (1, 1), flat.size_out(1)]
        rows, columns = pattern.get_triplet()
        tables = "".join(
            f"static const int {name}[] = {{{', '.join(str(v) for v in (*values, 0))}}};\n"
            for name, values in (("ROW", rows), ("COLUMN", columns))
        )
        sizes = f"#define N {n}\n#define NN {n * n}\n#define NNZ {len(rows)}\n"
        self._load(_generated(flat) + sizes + tables + _TRANSITIONS.replace("STAGES", _stage_loops()))


def _nonzeros(matrix: ca.MX) -> list[ca.MX]:
    return [matrix.nz[i] for i in range(matrix.nnz())] or [ca.MX(0, 1)]


def _dense(function: ca.Function) -> ca.Function:
    symbols = function.sx_in()
    return ca.Function(function.name(), symbols, [ca.densify(e) for e in function.call(symbols)])


def _generated(function: ca.Function) -> str:
    generator = ca.CodeGenerator(function.name(), {"with_header": False})
    generator.add(function)
    work = f"#define WORK {max(function.sz_w(), 1)}\n#define INTEGERS {max(function.sz_iw(), 1)}\n"
    work += f"#define ARGUMENTS {function.sz_arg() + 1}\n#define RESULTS {function.sz_res() + 1}\n"
    return f"#define CASADI_SYMBOL_EXPORT static\n{generator.dump()}\n{work}"


def _stage_loops() -> str:
    """Return the C of all stages: the sum of those before, its product with the Jacobian; then matrix and errors."""
    lines = []
    for i, weights in enumerate(DOP853.A):
        if i:
            lines.append(f"for (e = 0; e < NN; ++e) W[e] = h * ({_sum(weights[:i])});")
            lines.append("for (e = 0; e < N; ++e) W[e * N + e] += 1;")
        else:
            lines.append("for (e = 0; e < NN; ++e) W[e] = 0;\nfor (e = 0; e < N; ++e) W[e * N + e] = 1;")
        lines.append(f"times(entries + {i} * NNZ, W, K + {i} * NN);")
    for name, weights in (("F", DOP853.E5), ("T", DOP853.E3)):
        lines.append(f"for (e = 0; e < NN; ++e) {name}[e] = h * ({_sum(weights[:12])});")
    lines.append(f"for (e = 0; e < NN; ++e) W[e] = h * ({_sum(DOP853.B)});\nfor (e = 0; e < N; ++e) W[e * N + e] += 1;")
    return "\n    ".join(lines)


def _sum(weights: np.ndarray) -> str:
    return " + ".join(f"{float(w)!r} * K[{j} * NN + e]" for j, w in enumerate(weights) if w != 0.0)


_LOOP = r"""
#include <stdlib.h>
int many(long count, const double** in, double** out, const long* size) {
  const double* arg[ARGUMENTS]; double* res[RESULTS]; casadi_int iw[INTEGERS];
  double* w = malloc(sizeof(double) * WORK);           /* not static: threads may run side by side */
  long k; int i;
  if (!w) return 1;
  for (k = 0; k < count; ++k) {
    for (i = 0; i < NAME_n_in(); ++i) arg[i] = in[i] + k * size[i];
    for (i = 0; i < NAME_n_out(); ++i) res[i] = out[i] + k * size[NAME_n_in() + i];
    NAME(arg, res, iw, w, 0);
  }
  free(w);
  return 0;
}
"""

_TRANSITIONS = r"""
#include <stdlib.h>
static void times(const double* restrict a, const double* restrict W, double* restrict K) {  /* K = A W, all by rows */
  int e, z;
  for (e = 0; e < NN; ++e) K[e] = 0;
  for (z = 0; z < NNZ; ++z) {
    const double v = a[z], *restrict from = W + COLUMN[z] * N;
    double* restrict to = K + ROW[z] * N;
    for (e = 0; e < N; ++e) to[e] += v * from[e];
  }
}
int many(long count, const double** in, double** out, const long* size) {
  double* memory = malloc(sizeof(double) * (15 * NN + 12 * NNZ + WORK + 1));
  double *restrict K = memory, *restrict W = K + 12 * NN, *restrict F = W + NN, *restrict T = F + NN;
  double *entries = T + NN, *w = entries + 12 * NNZ;
  const double* arg[ARGUMENTS]; double* res[RESULTS]; casadi_int iw[INTEGERS];
  long k; int i, j, e;
  if (!memory) return 1;
  for (k = 0; k < count; ++k) {
    const double h = in[2][k];
    double *matrix = out[0] + k * NN, *squares = out[1] + k * 2 * N;
    for (i = 0; i < 6; ++i) arg[i] = in[i] + k * size[i];
    res[0] = out[2] + k; res[1] = out[3] + k * size[9]; res[2] = entries;
    stages(arg, res, iw, w, 0);
    STAGES
    for (i = 0; i < N; ++i) {
      double fifth = 0, third = 0;
      for (j = 0; j < N; ++j) {
        matrix[i * N + j] = W[j * N + i];
        fifth += F[j * N + i] * F[j * N + i];
        third += T[j * N + i] * T[j * N + i];
      }
      squares[2 * i] = fifth; squares[2 * i + 1] = third;
    }
  }
  free(memory);
  return 0;
}
"""
