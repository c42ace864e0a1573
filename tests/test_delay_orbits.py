"""Orbits of models with delays, and rests that nothing can end."""

import jax.numpy as jnp
import pytest

import hybrid as hy


class Pyragas(hy.Automaton):
    """A hard spring at a wall, under Pyragas' control."""

    x1 = hy.state()
    x2 = hy.state()
    wall = hy.parameter(2.0)
    r = hy.parameter(0.6)
    C = hy.parameter(-30.0)
    tau = hy.parameter(1.0)

    @hy.mode
    def flight(self, t, s, past):
        return s.x2, -(s.x1**3) - jnp.cos(s.x2) + self.C * (past(self.tau).x1 - s.x1)

    impact = hy.contact(
        flight, gap=lambda self, t, s: s.x1 - self.wall, restitution="r", rests=True
    )


class Pressed(hy.Automaton):
    """A ball held down by a spring that remembers, and by a force that may change in time."""

    x = hy.state()
    v = hy.state()

    def force(self, t):
        return -9.0

    @hy.mode
    def flight(self, t, s, past):
        return s.v, self.force(t) + past(1.0).x - s.x

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5, rests=True)


class Changing(Pressed):
    """The same with a force that changes."""

    def force(self, t):
        return -9.0 + jnp.sin(t)


# ---------------------------------------------------------------------------------------
# rest for ever


@pytest.mark.parametrize("start", [2.1, 2.5, 3.0, 5.0, 10.0, 100.0, 200.0])
def test_control_that_remembers_ends_at_rest_for_ever(start):
    """A lag after the accumulation: the load is ``9 + 30 (past - 2)``, and there is no less."""
    run = hy.simulate(Pyragas(), [start, 0.0], (0.0, 4.0))
    found = run.settles()
    assert (found.kind, found.for_ever) == ("rest", True)
    since = f"since t = {run.zeno[0].t + 1.0:.9g} everything that the load depends on stands still"
    assert since in found.reason
    assert "it is 9 and was never below 9" in found.reason


def test_a_lag_must_have_passed():
    """Before, what comes out of the past may still lift it."""
    run = hy.simulate(Pyragas(), [2.5, 0.0], (0.0, 1.5))
    found = run.settles()
    assert (found.kind, found.for_ever) == ("rest", False)
    assert f"changes until t = {run.zeno[0].t + 1.0:.9g}" in found.reason


def test_rests_that_end_are_not_for_ever():
    """With C = 60 and r = 0.2 it is lifted four times; then it rests for ever."""
    model, start = Pyragas(C=60.0, r=0.2), [2.5, 0.0]
    whole = hy.simulate(model, start, (0.0, 20.0))
    releases = [point.t_release for point in whole.zeno]
    assert len(releases) == 5
    assert releases.pop() is None
    for point, release in zip(whole.zeno, releases, strict=False):
        run = hy.simulate(model, start, (0.0, 0.5 * (point.t + release)))
        assert run.mode == "flight.rest(impact)"
        assert not run.settles().for_ever
    assert whole.settles().for_ever
    assert "was never below 6.389" in whole.settles().reason


def test_time_may_end_a_rest():
    """A force that depends on it, but not one that depends on the past."""
    still = hy.simulate(Pressed(), [1.0, 0.0], (0.0, 9.0)).settles()
    assert (still.kind, still.for_ever) == ("rest", True)
    found = hy.simulate(Changing(), [1.0, 0.0], (0.0, 9.0)).settles()
    assert (found.kind, found.for_ever) == ("rest", False)
    assert "not known to be for ever: the flow in flight.rest(impact) depends on" in found.reason


def test_a_run_from_a_file_does_not_know_its_model(tmp_path):
    run = hy.simulate(Pyragas(), [2.5, 0.0], (0.0, 4.0))
    run.save(tmp_path / "run.nc")
    found = hy.load(tmp_path / "run.nc").settles()
    assert (found.kind, found.for_ever) == ("rest", False)
