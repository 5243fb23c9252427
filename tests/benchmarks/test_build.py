"""Cost of building a System from a built-in pair file: parsing, units, derived quantities, symbolic equations.

``pytest tests/benchmarks --benchmark-enable -n 0`` times; in the ordinary test run it runs once, untimed.
"""

from sbg_casadi import gear_system, load_pair


def build():
    return gear_system(load_pair("iso-f2").dimensionless("before"))


def test_build(benchmark):
    assert len(benchmark(build).state_names) == 14
