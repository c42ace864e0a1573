"""The bound on an accumulation's time holds, on random scenes whose truth is known."""

from functools import cache

import pytest

from .scenes import scenes

#: A few of the scenes of ``benchmarks/bounds.py``, which goes through five hundred; made when the
#: first is asked for, as every worker reads this file.
COUNT = 24
made = cache(lambda: list(scenes(COUNT, seed=16)))


@pytest.mark.parametrize("rtol", [1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize("solver", ["scipy", "taylor"])
@pytest.mark.parametrize("number", range(COUNT))
def test_the_error_lies_within_its_bound(number, solver, rtol):
    """Balls, moving floors, weights that switch, hard springs; units from 1e-6 to 1e6."""
    scene = made()[number]
    (point,) = scene.run(solver, rtol).zeno
    assert abs(point.t - scene.exact) <= point.t_error
