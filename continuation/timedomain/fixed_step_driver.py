"""The loop of the fixed-step march in C, and the C of one model's step in front of it."""

from __future__ import annotations

import casadi as ca

from continuation.timedomain.fixed_step_functions import ModeModel, StepFunctions

OK, NOT_FINITE, CHATTER, FULL = 0, 1, 2, 3
"""What ``march`` returns: done, the state left the finite numbers, a step with too many contact changes, no room left
for contact changes."""

SLACK = 1e-12
"""Part of a step by which two phases may differ and be the same."""


def source(model: ModeModel, functions: StepFunctions) -> str:
    """Return the C source of ``tabulate`` and ``march`` for one model."""
    generator = ca.CodeGenerator("model", {"with_header": False, "unroll_args": True})
    for function in (functions.forcing, functions.begin, functions.step, functions.observe):
        generator.add(function)
    sizes = {
        "N": model.x.numel(),
        "M": model.arguments.numel(),
        "O": model.observed.numel(),
        "E": functions.forcing.numel_out(0),
        "F": len(functions.fractions),
    }
    defines = "".join(f"#define {name} {size}\n#define {name}_ {max(size, 1)}\n" for name, size in sizes.items())
    defines += f"#define SLACK {SLACK!r}\n"
    return f"#define CASADI_SYMBOL_EXPORT static\n{generator.dump()}\n{defines}{_tables(model, functions)}{_DRIVER}"


def _tables(model: ModeModel, functions: StepFunctions) -> str:
    """Return the numbers of the contacts one after the other, each with 0 breakpoints to spare."""
    breakpoints: list[float] = []
    slopes: list[float] = []
    intercepts: list[float] = []
    first = [0]
    for b, s, c in model.laws:
        breakpoints += [*b, 0.0]
        slopes += s
        intercepts += c
        first.append(len(slopes))

    def array(kind: str, name: str, values: list) -> str:
        return f"static const {kind} {name}[] = {{{', '.join(repr(v) for v in values or [0])}}};\n"

    return (
        array("double", "FRACTION", list(functions.fractions))
        + array("double", "BREAKPOINT", breakpoints)
        + array("double", "SLOPE", slopes)
        + array("double", "INTERCEPT", intercepts)
        + array("int", "FIRST", first)
    )


_DRIVER = r"""
#include <math.h>
#include <string.h>
#include <stdint.h>
#define MOST 64             /* contact changes in one interval of the grid */
#define NEWTON 3

typedef struct { double x[N], k[N], a[M_], r[M_]; } point;

typedef struct {
  const double *p, *phases;
  double h, turn, s[M_], c[M_], y[O_], dy[O_], centre[O_];     /* turn: phase per time */
  double *statistics, *dwell, *samples, *changes;              /* any of them may be NULL */
  int64_t sampled, next, capacity, count, period;
  int mode[M_];
} run;

static void force(double theta, double span, const double *p, double *e) {
  const double *arg[2]; double *res[1];
  for (int f = 0; f < F; f++) forcing_unrolled((double[]){theta + FRACTION[f]*span}, p, e + f*E, arg, res, 0, 0, 0);
}

static void attempt(const run *g, const point *u, double h, const double *e, point *v) {
  const double *arg[6]; double *res[4];
  step_unrolled(u->x, u->k, &h, e, g->s, g->c, v->x, v->k, v->a, v->r, arg, res, 0, 0, 0);
}

static void start(const run *g, point *u, double theta) {
  const double *arg[6]; double *res[4], e[E_];
  forcing_unrolled(&theta, g->p, e, arg, res, 0, 0, 0);
  begin_unrolled(u->x, e, g->s, g->c, u->k, u->a, u->r, arg, res, 0, 0, 0);
}

static void observed(const run *g, const point *u, double theta, double *y, double *dy) {
  const double *arg[6]; double *res[2];
  observe_unrolled(u->x, u->k, &theta, g->p, g->s, g->c, y, dy, arg, res, 0, 0, 0);
  for (int i = 0; i < O; i++) y[i] -= g->centre[i];
}

static void set_mode(run *g, int i, int j) {
  g->mode[i] = j; g->s[i] = SLOPE[FIRST[i] + j]; g->c[i] = INTERCEPT[FIRST[i] + j];
}

/* Value at t in [0, 1] of the cubic with values g0, g1 and derivatives d0, d1 at the ends. */
static double hermite(double g0, double d0, double g1, double d1, double t) {
  return g0 + t*(d0 + t*(3*(g1 - g0) - 2*d0 - d1 + t*(2*(g0 - g1) + d0 + d1)));
}

/* Interior extrema of that cubic in increasing order; returns how many. */
static int extrema(double g0, double d0, double g1, double d1, double *t) {
  double q = 3*(g1 - g0) - 2*d0 - d1, s = 3*(2*(g0 - g1) + d0 + d1), root = q*q - s*d0, w, a, b;
  int n = 0;
  if (!(root > 0)) return 0;
  w = q < 0 ? -q + sqrt(root) : -q - sqrt(root);
  a = w/s; b = d0/w;
  if (a > b) { double c = a; a = b; b = c; }
  if (a > 0 && a < 1) t[n++] = a;
  if (b > 0 && b < 1) t[n++] = b;
  return n;
}

/* Where a falling piece of that cubic meets zero, by Newton's method inside a bracket. */
static double falling_root(double g0, double d0, double g1, double d1, double low, double high) {
  double q = 3*(g1 - g0) - 2*d0 - d1, s = 2*(g0 - g1) + d0 + d1, t = (low + high)/2, before;
  for (int n = 0; n < 60; n++) {
    double value = hermite(g0, d0, g1, d1, t), slope = d0 + t*(2*q + 3*s*t);
    if (value > 0) low = t; else high = t;
    before = t;
    t = slope < 0 ? t - value/slope : low;
    if (!(low <= t && t <= high)) t = (low + high)/2;
    if (fabs(t - before) < 1e-15) break;
  }
  return t;
}

/* First instant in [0, 1] at which a gap that begins open, or at 0, closes; 2 when it stays open. */
static double closing(double g0, double d0, double g1, double d1) {
  double t[4] = {0}, left, right;
  int n;
  if (fmin(g0, g1) - (4./27)*(fmax(-d0, 0) + fmax(d1, 0)) > 0) return 2;   /* bound of the cubic from below */
  n = 1 + extrema(g0, d0, g1, d1, t + 1);
  t[n] = 1;
  for (int i = 0; i < n; i++) {
    left = i ? hermite(g0, d0, g1, d1, t[i]) : g0;
    right = i + 1 < n ? hermite(g0, d0, g1, d1, t[i + 1]) : g1;
    if (right < 0) return left > 0 ? falling_root(g0, d0, g1, d1, t[i], t[i + 1]) : t[i];
  }
  return 2;
}

/* First contact to leave its linear piece during a step; fraction of the step, 2 when none does. */
static double leaving(const run *g, const point *u, const point *v, double h, int *which, int *direction) {
  double first = 2;
  for (int i = 0; i < M; i++) {
    int j = g->mode[i], pieces = FIRST[i + 1] - FIRST[i];
    for (int side = -1; side <= 1; side += 2) {
      if (side < 0 ? j == 0 : j + 1 == pieces) continue;
      double b = BREAKPOINT[FIRST[i] + (side < 0 ? j - 1 : j)];
      double t = closing(side*(b - u->a[i]), -side*h*u->r[i], side*(b - v->a[i]), -side*h*v->r[i]);
      if (t < first) { first = t; *which = i; *direction = side; }
    }
  }
  return first;
}

/* States at the phases asked for that lie in a step, by shorter steps; phases from the start of the period. Those that
   differ from a point of the grid by rounding alone are that point. */
static void sample(run *g, const point *u, double phase, double end) {
  double slack = SLACK*g->h*g->turn;
  for (; g->next < g->sampled && g->phases[g->next] < end - slack; g->next++) {
    double *out = g->samples + (g->period*g->sampled + g->next)*N, ahead = g->phases[g->next] - phase, e[F_*E_];
    point v;
    if (!(ahead > slack)) { memcpy(out, u->x, sizeof(u->x)); continue; }
    force(phase, ahead, g->p, e);
    attempt(g, u, ahead/g->turn, e, &v);
    memcpy(out, v.x, sizeof(v.x));
  }
}

/* Integrals of y and y^2 (trapezoidal rule with end correction, 4th order) and extremes over a step. */
static void account(run *g, const point *v, double end, double h) {
  double y[O_], dy[O_], t[2];
  observed(g, v, end, y, dy);
  for (int i = 0; i < O; i++) {
    double *q = g->statistics + (g->period*O + i)*4, a = g->y[i], b = y[i], da = g->dy[i], db = dy[i];
    q[0] += h/2*(a + b + h/6*(da - db));
    q[1] += h/2*(a*a + b*b + h/3*(a*da - b*db));
    q[2] = fmin(q[2], b); q[3] = fmax(q[3], b);
    if (da*db < 0)
      for (int m = extrema(a, h*da, b, h*db, t); m--;) {
        double z = hermite(a, h*da, b, h*db, t[m]);
        q[2] = fmin(q[2], z); q[3] = fmax(q[3], z);
      }
  }
  memcpy(g->y, y, sizeof(y)); memcpy(g->dy, dy, sizeof(dy));
}

static void accept(run *g, const point *u, const point *v, double phase, double end, double h) {
  if (g->samples) sample(g, u, phase, end);
  if (g->statistics) account(g, v, end, h);
  if (g->dwell) for (int i = 0; i < M; i++) g->dwell[FIRST[i] + g->mode[i]] += h;
}

/* Step to the corner: the root of the cubic first, then Newton's method on the step itself. Returns its length. */
static double land(const run *g, const point *u, double phase, double length, double left, int i, int direction,
                   point *v) {
  double target = BREAKPOINT[FIRST[i] + (direction > 0 ? g->mode[i] : g->mode[i] - 1)], e[F_*E_];
  for (int trial = 0;; trial++) {
    force(phase, length*g->turn, g->p, e);
    attempt(g, u, length, e, v);
    double miss = v->a[i] - target, shift = miss/v->r[i];
    /* At a grazing contact the rate vanishes; an instant missed by d then costs d times the miss, which is nothing. */
    if (trial == NEWTON || !(v->r[i]*direction > 0) || !(fabs(shift) > 1e-12*g->h)) return length;
    if (fabs(shift) > 0.1*left || !(length - shift > 0)) return length;
    length = fmin(length - shift, left);
  }
}

/* Cross one interval of the grid, in pieces where contacts change; the result is left in *u. */
static int cross(run *g, point **u, point **v, double phase, double end, const double *grid) {
  double left = g->h, local[F_*E_];
  const double *e = grid;
  for (int n = 0; n < MOST; n++) {
    int which = 0, direction = 0;
    double t, length;
    point *swap;
    attempt(g, *u, left, e, *v);
    t = leaving(g, *u, *v, left, &which, &direction);
    if (t > 1) {
      accept(g, *u, *v, phase, end, left);
      swap = *u; *u = *v; *v = swap;
      return 0;
    }
    if (t > 0) {
      length = land(g, *u, phase, t*left, left, which, direction, *v);
      accept(g, *u, *v, phase, phase + length*g->turn, length);
      swap = *u; *u = *v; *v = swap;
      left = left - length; phase += length*g->turn;
    }
    if (g->changes) {
      if (g->count == g->capacity) return 3;
      double *row = g->changes + (4 + N)*g->count;
      row[0] = g->period; row[1] = phase; row[2] = which; row[3] = direction;
      memcpy(row + 4, (*u)->x, sizeof((*u)->x));
    }
    g->count++;
    set_mode(g, which, g->mode[which] + direction);
    start(g, *u, phase);
    if (g->statistics) observed(g, *u, phase, g->y, g->dy);
    if (!(left > 0)) {
      if (g->samples) sample(g, *u, phase, end);
      return 0;
    }
    force(phase, left*g->turn, g->p, local);
    e = local;
  }
  return 2;
}

static int all_finite(const point *u) {
  double sum = 0;
  for (int i = 0; i < N; i++) sum += 0*u->x[i];
  return sum == 0;
}

static int one_period(run *g, point **u, point **v, int64_t steps, const double *table, int careful, double *phase) {
  double width = g->h*g->turn;
  for (int64_t j = 0; j < steps; j++) {
    int flag = cross(g, u, v, j*width, (j + 1)*width, table + j*F*E);
    *phase = j*width;
    if (flag) return flag;
    if (careful && !all_finite(*u)) return 1;
  }
  g->next = 0;
  return all_finite(*u) ? 0 : 1;
}

void tabulate(const double *p, double width, int64_t steps, double *table) {
  for (int64_t j = 0; j < steps; j++) force(j*width, width, p, table + j*F*E);
}

/* March over whole periods from phase 0. x and mode are those at the end; where[0], where[1]: period and phase of a
   failure, where[2]: number of contact changes. */
int march(double *x, int64_t *mode, const double *p, double h, double turn, int64_t periods, int64_t steps,
          const double *table, double *strobe, double *statistics, double *dwell, const double *phases,
          int64_t sampled, double *samples, double *changes, int64_t capacity, const double *centre, double *where) {
  point a, b, before, *u = &a, *v = &b;
  run g = {.p = p, .h = h, .turn = turn, .statistics = statistics, .dwell = dwell, .phases = phases,
           .sampled = sampled, .samples = samples, .changes = changes, .capacity = capacity};
  int flag = 0;
  memcpy(a.x, x, sizeof(a.x));
  memcpy(g.centre, centre, O*sizeof(double));
  for (int i = 0; i < M; i++) set_mode(&g, i, (int)mode[i]);
  start(&g, u, 0);
  if (statistics) observed(&g, u, 0, g.y, g.dy);
  for (g.period = 0; g.period < periods; g.period++) {
    run saved = g;
    double phase = 0;
    before = *u;
    flag = one_period(&g, &u, &v, steps, table, 0, &phase);
    if (flag == 1) {                        /* once more, looking at every step, for the place of the failure */
      *u = before; g = saved; g.statistics = g.dwell = g.samples = g.changes = 0;
      one_period(&g, &u, &v, steps, table, 1, &phase);
    }
    where[0] = g.period; where[1] = phase;
    if (flag) { *u = before; g = saved; break; }
    if (strobe) memcpy(strobe + g.period*N, u->x, sizeof(u->x));
  }
  where[2] = g.count;
  memcpy(x, u->x, sizeof(u->x));
  for (int i = 0; i < M; i++) mode[i] = g.mode[i];
  return flag;
}
"""
