"""The ways in themselves: each fills what it says it tells, in the same words."""

import numpy as np
import pytest

import hybrid as hy
from models.bouncing_ball import BouncingBall

from .ways import ALL, TABLE, Result

WAYS = ALL

pytestmark = pytest.mark.each_method

#: Fields of a result that are None where they are not told.
FIELDS = {"final", "t", "mode", "jumps", "accumulations", "run"} | TABLE

#: A ball dropped from 1, g = 9.81, r = 0.7: sqrt(2 / g) (1 + r) / (1 - r).
T_INF = 2.55863396558580846


def test_a_result_has_what_its_way_tells(way):
    """A field that is told is there; one that is not is None."""
    result = way.run(BouncingBall(), {"x": 1.0, "v": 0.0}, (0.0, 3.0), rtol=1e-9)
    assert {name for name in FIELDS if getattr(result, name) is not None} == way.told & FIELDS
    assert (result.status, result.t, result.final.x) == ("reached_end", 3.0, 0.0)
    assert abs(result.t_inf - T_INF) <= 1e-6
    if way.tells("bound"):
        assert abs(result.t_inf - T_INF) <= result.t_error
    if way.tells("edges"):
        assert result.edges == ["impact"] * result.jumps
        assert result.times[0] == pytest.approx(np.sqrt(2 / 9.81), abs=1e-9)
        np.testing.assert_allclose(result.after.v, -0.7 * result.before.v, rtol=1e-12)
    if way.tells("limit"):
        assert result.zeno[0].state.x == pytest.approx(0.0, abs=1e-12)


def test_many_runs_are_runs_of_their_own(way):
    """Starts, parameters and last times differ; the second is outside the domain."""
    results = way.many(
        BouncingBall(),
        [{"x": 1.0, "v": 0.0}, {"x": -1.0, "v": 0.0}, {"x": 0.25, "v": 0.0}],
        (0.0, [3.0, 3.0, 1.0]),
        {"r": [0.7, 0.7, 0.5]},
    )
    assert [result.status for result in results] == ["reached_end", "refused", "reached_end"]
    assert results[0].t_inf == pytest.approx(T_INF, abs=1e-6)
    assert results[2].t_inf == pytest.approx(3 * np.sqrt(0.5 / 9.81), abs=1e-6)
    assert results[2].t == 1.0


def test_wrong_options_stay_errors(way):
    """Only what the model does has a status."""
    with pytest.raises(hy.OptionError):
        way.run(BouncingBall(), {"x": 1.0, "v": 0.0}, (0.0, 3.0), mode="air")


def test_nothing_accumulated_is_nan():
    """``t_inf`` of a result without accumulations compares unequal to everything."""
    assert np.isnan(Result(status="reached_end").t_inf)
