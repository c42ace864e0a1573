"""Edges that end a run, edges with a condition, and urgent ones, against closed forms."""

import jax
import numpy as np
import pytest

import hybrid as hy

from .contract.ways import WAYS

#: One of each mechanism.
SOME = ["DOP853", "Radau", "taylor", "Tsit5", "ensemble", "as_function"]

ways = pytest.mark.parametrize("way", [WAYS[name] for name in SOME], ids=SOME)


class Shot(hy.Automaton):
    """Ends on the ground: t = (v + sqrt(v^2 + 2 g y)) / g."""

    y = hy.state()
    v = hy.state()
    g: float = hy.parameter(2.0)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -self.g

    @hy.edge(flight, to=hy.TERMINATE, guard=lambda self, t, s: s.y)
    def ground(self, t, s):
        return s.replace(v=0.5 * s.v)


START = {"y": 3.0, "v": 1.0}
HIT = (1.0 + np.sqrt(13.0)) / 2.0


@ways
def test_a_run_ends_at_the_zero_of_a_guard(way):
    """At the exact time, with the state that the reset gives; the jump is recorded."""
    result = way.run(Shot(), START, (0.0, 100.0), rtol=1e-9)
    assert (result.status, result.jumps) == ("terminated", 1)
    assert result.t == pytest.approx(HIT, rel=1e-9)  # a parabola: methods are exact
    assert result.final.v == pytest.approx(-0.5 * np.sqrt(13.0), rel=1e-8)
    assert result.times[0] == result.t
    assert "hy.TERMINATE" in result.said


def test_the_sentence_names_the_edge_and_survives_a_file(tmp_path):
    """What is printed, explained and loaded says which edge has ended the run."""
    run = hy.simulate(Shot(), START, (0.0, 100.0))
    assert run.status is hy.Status.TERMINATED
    assert [arc.mode for arc in run.arcs] == ["flight", "flight"]
    assert run.t1 == run.jumps.t[-1]
    run.save(tmp_path / "run.nc")
    for each in (run, hy.load(tmp_path / "run.nc")):
        assert each.status is hy.Status.TERMINATED
        assert "the edge ground" in each.explain()
        assert "the edge ground" in repr(each)


def test_lanes_end_each_at_its_own_time():
    """Some come to the ground and some to the last time, which their status says."""
    v = np.array([0.0, 1.0, 2.0, 8.0])
    lanes = hy.ensemble(Shot(), {"y": 3.0, "v": v}, (0.0, 5.0))
    assert lanes.status.values.tolist() == ["terminated"] * 3 + ["reached_end"]
    exact = (v + np.sqrt(v**2 + 12.0)) / 2.0
    np.testing.assert_allclose(lanes.t.values, np.minimum(exact, 5.0), rtol=1e-14)


@pytest.fixture
def wide():
    """64 bits also on the thread on which JAX calls back."""
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


def test_derivatives_of_the_time_of_the_end(wide):
    """First and second: those of (v + sqrt(v^2 + 2 g y)) / g."""
    end = hy.as_function(Shot(), t=(0.0, 100.0), max_jumps=4)
    time = lambda v: end(Shot(), {"y": 3.0, "v": v}).t  # noqa: E731
    first, second = jax.grad(time)(1.0), jax.grad(jax.grad(time))(1.0)
    assert first == pytest.approx((1.0 + 1.0 / np.sqrt(13.0)) / 2.0, rel=1e-13)
    assert second == pytest.approx(6.0 / 13.0**1.5, rel=1e-12)


class Seen(Shot):
    """Its acceleration is the speed it had, a lag ago: the speed goes on as it was."""

    @hy.mode(initial=True)
    def flight(self, t, s, past):
        return past(1.0).v, -self.g


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_a_run_with_delays_ends(solver):
    """y' = v(t - 1) with v = 1 before: y = 3 + t, then 3 + 1 + s - s^2, s = t - 1."""
    run = hy.simulate(Seen(), START, (0.0, 9.0), history={"y": 3.0, "v": 1.0}, solver=solver)
    assert run.status is hy.Status.TERMINATED
    assert run.t1 == pytest.approx(1.0 + (1.0 + np.sqrt(17.0)) / 2.0, rel=1e-8)


def test_a_map_beyond_the_end_says_so():
    """A run that has ended does not return; to the edge that ends it there is a map."""
    assert hy.return_map(Shot(), "ground")(START).v == pytest.approx(-0.5 * np.sqrt(13.0))
    with pytest.raises(hy.OrbitError, match="TERMINATE"):
        hy.return_map(Shot(), lambda self, t, s: s.y + 1.0)(START)


def test_a_run_may_not_end_on_its_way_to_no_mode():
    """What is no mode is refused as before."""
    with pytest.raises(hy.DeclarationError, match="is no mode"):

        class Wrong(Shot):
            wrong = hy.edge("flight", to="TERMINATE", guard=lambda self, t, s: s.v)
