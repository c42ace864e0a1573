"""What a contact bears at rest, and what an impact gives, are the closed forms."""

import pickle

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy


class Table(hy.Automaton):
    """A body of mass m on a table that moves as a sine."""

    x = hy.state()
    v = hy.state()
    g: float = hy.parameter(10.0)
    m: float = hy.parameter(2.0)
    r: float = hy.parameter(0.0)
    a: float = hy.parameter(1.0)
    w: float = hy.parameter(2.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -self.g

    impact = hy.contact(
        flight,
        gap=lambda self, t, s: s.x - self.a * jnp.sin(self.w * t),
        restitution="r",
        inverse_mass=lambda self, t, s: 1.0 / self.m,
    )


class Corner(hy.Automaton):
    """A bead on a floor and at a wall, pushed into both; it starts at rest on the floor."""

    x = hy.state()
    y = hy.state()
    u = hy.state()
    v = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.u, s.v, -3.0, -10.0 + t

    floor = hy.contact(flight, gap=lambda self, t, s: s.y, restitution=0.0)
    slope = hy.contact(flight, gap=lambda self, t, s: s.x + s.y, restitution=0.0)


class Ball(hy.Automaton):
    """A ball that has a lid above it: an edge that turns it round, and one that does nothing."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.v, -10.0

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)

    @hy.edge(flight, to=flight, guard=lambda self, t, s: 1.5 - s.x)
    def lid(self, t, s):
        return s.replace(v=-s.v)


class Late(hy.Automaton):
    """A bead pressed down by what it was: the load is its own past."""

    x = hy.state()
    v = hy.state()
    z = hy.state()

    @hy.mode
    def flight(self, t, s, past):
        return s.v, -past(1.0).z, 1.0

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.0)


START = {"x": 0.0, "v": 2.0}


def on_table(solver):
    return hy.simulate(Table(), START, (0.0, 3.0), mode="flight.rest(impact)", **solver)


def test_a_body_presses_on_a_moving_table(solver):
    """m (g + table''), at a time and at many: at any place, as it does not depend on the state."""
    run, times = on_table(solver), np.linspace(0.0, 3.0, 12).reshape(3, 4)
    found = run.force("impact", times)
    exact = 2.0 * (10.0 - 4.0 * np.sin(2.0 * times))
    np.testing.assert_allclose(found, exact, rtol=2e-15)  # some roundings
    assert run.force("impact", 1.0) == pytest.approx(2.0 * (10.0 - 4.0 * np.sin(2.0)), rel=2e-15)


def test_what_is_not_touched_bears_nothing(solver):
    """0 in flight, NaN at the impact, the whole weight at rest behind it."""
    run = hy.simulate(Table(a=0.0), {"x": 0.8, "v": 0.0}, (0.0, 1.0), **solver)
    t = run.jumps.t[0]
    assert t == pytest.approx(0.4, abs=1e-7)  # tolerances of 1e-8
    found = run.force("impact", np.array([0.1, t, 0.9]))
    np.testing.assert_allclose(found, [0.0, np.nan, 20.0], rtol=2e-15)
    assert run.jumps.impulse[0] == pytest.approx(2.0 * 4.0, rel=1e-7)  # m |u|, of those tolerances


def test_a_force_stays_where_impacts_accumulate():
    """At the limit of impacts, which are weaker there than any force, it is that of the rest."""
    run = hy.simulate(Ball(), {"x": 1.0, "v": 0.0}, (0.0, 3.0), solver="taylor")
    t = run.zeno[0].t
    np.testing.assert_array_equal(run.force("impact", np.array([t, 2.9])), [10.0, 10.0])


def test_two_contacts_share_what_is_pressed(solver):
    """On a floor and a slope the forces solve both: 7 - t and 3 of a pull of (-3, -10 + t)."""
    start = {"x": 0.0, "y": 0.0, "u": 0.0, "v": 0.0}
    run = hy.simulate(Corner(), start, (0.0, 2.0), mode="flight.rest(floor, slope)", **solver)
    times = np.array([0.0, 1.0, 1.5])
    np.testing.assert_allclose(run.force("slope", times), 3.0, rtol=1e-15)
    np.testing.assert_allclose(run.force("floor", times), 7.0 - times, rtol=1e-15)


def test_an_impulse_is_the_change_of_momentum(solver):
    """Of each impact (1 + r) |u|; NaN where the jump is that of an edge, or a release."""
    run = hy.simulate(Ball(), {"x": 1.0, "v": 4.0}, (0.0, 1.5), **solver)
    jumps = run.jumps
    assert jumps.edge[0] == "lid"
    assert np.isnan(jumps.impulse[0])
    struck = jumps.edge == "impact"
    assert np.count_nonzero(struck) > 1
    exact = (jumps.after.v - jumps.before.v)[struck]
    np.testing.assert_allclose(jumps.impulse[struck], exact, rtol=4e-16)  # another order of sums
    released = hy.simulate(Table(w=4.0), START | {"v": 4.0}, (0.0, 0.5), **solver, mode=REST).jumps
    assert released.edge[0] == "impact.release"
    assert np.isnan(released.impulse[0])


REST = "flight.rest(impact)"


def test_impulses_of_a_series_add_up_to_the_weight_borne():
    """All impacts of a ball give g times the time from its first fall to their limit."""
    run = hy.simulate(Ball(), {"x": 1.0, "v": 0.0}, (0.0, 3.0), solver="taylor")
    borne = 10.0 * run.zeno[0].t
    assert run.jumps.impulse.sum() == pytest.approx(borne, rel=1e-13)  # a hundred roundings


def test_forces_see_the_past(solver):
    """The load of a flow with a lag is what was: z(t - 1) = t - 1, or as before the start, 1."""
    start = {"x": 0.0, "v": 0.0, "z": 1.0}
    run = hy.simulate(Late(), start, (0.0, 2.0), mode=REST, **solver)
    times = np.array([0.5, 1.5])
    np.testing.assert_allclose(run.force("impact", times), [1.0, 1.5], rtol=1e-7)  # tolerances


def test_a_run_from_a_file_needs_its_model(tmp_path):
    """Forces and impulses of a saved run are those of the run, with its model; else an error."""
    run, path = on_table({"solver": "taylor"}), tmp_path / "run.nc"
    run.save(path)
    assert hy.load(path, Table).force("impact", 1.0) == run.force("impact", 1.0)
    again = pickle.loads(pickle.dumps(run))
    assert again.force("impact", 1.0) == run.force("impact", 1.0)
    bare = hy.load(path)
    with pytest.raises(hy.OptionError, match=r"hy.load\(path, Table\)"):
        bare.force("impact", 1.0)


def test_jumps_keep_their_impulses(tmp_path):
    """Pickled, and from a file with its model."""
    run, path = hy.simulate(Ball(), {"x": 1.0, "v": 0.0}, (0.0, 1.0)), tmp_path / "run.nc"
    run.save(path)
    for jumps in (pickle.loads(pickle.dumps(run.jumps)), hy.load(path, Ball).jumps):
        np.testing.assert_array_equal(jumps.impulse, run.jumps.impulse)
    with pytest.raises(hy.OptionError, match=r"hy.load\(path, Ball\)"):
        _ = hy.load(path).jumps.impulse


def test_wrong_use_is_told():
    """Names that are no contact, times outside, and states that were not kept."""
    run = hy.simulate(Ball(), {"x": 1.0, "v": 0.0}, (0.0, 1.0), save="jumps")
    with pytest.raises(hy.OptionError, match="Ball has no contact 'lid'; there are: impact"):
        run.force("lid", 0.5)
    with pytest.raises(hy.OptionError, match=r"t = 2\.0 is outside the run"):
        run.force("impact", 2.0)
    with pytest.raises(hy.OptionError, match="no dense output"):
        run.force("impact", 0.3)
