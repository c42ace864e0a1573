"""The bound on an accumulation's time holds, on random scenes whose truth is known."""

import pytest

from .scenes import scenes

#: A few of the scenes of ``benchmarks/bounds.py``, which goes through five hundred.
CASES = [(k, scene) for k, scene in enumerate(scenes(24, seed=16))]


@pytest.mark.parametrize("rtol", [1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize("solver", ["scipy", "taylor"])
@pytest.mark.parametrize("scene", [c for _, c in CASES], ids=[f"{c.what}{k}" for k, c in CASES])
def test_the_error_lies_within_its_bound(scene, solver, rtol):
    """Balls, moving floors, weights that switch, hard springs; units from 1e-6 to 1e6."""
    (point,) = scene.run(solver, rtol).zeno
    assert abs(point.t - scene.exact) <= point.t_error
