"""When the rest ends that an accumulation has led to."""

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.result import joining
from models.relief_valve import ReliefValve


class Watched(ReliefValve):
    """The relief valve, and an event wherever it turns."""

    @hy.edge("open", to="open", guard=lambda self, t, s: s.y2)
    def turn(self, t, s):
        return s


START = {"y1": 2.0, "y2": 0.0, "y3": 12.0}


def exact(point, q):
    """On the seat pressure grows by ``20 q`` a unit of time, up to the spring's force, 10."""
    return point.t + (10.0 - point.state.y3) / (20.0 * q)


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize("model", [ReliefValve, Watched])
def test_a_valve_is_released_by_pressure(model, solver):
    """Whether its impacts accumulate alone, or in a cycle with events between them."""
    run = hy.simulate(model(q=0.2), START, (0.0, 8.0), solver=solver)
    (point,) = run.zeno
    assert point.mode == "open.rest(seat)"
    assert len(point.edges) == (2 if model is Watched else 1)
    # pressure is linear at rest: what the solvers' tolerances of 1e-8 leave
    assert point.t_release == pytest.approx(exact(point, 0.2), abs=1e-7)


def test_a_release_in_a_run_that_goes_on():
    """Is that of the accumulation before, of a cycle too."""
    first = hy.simulate(Watched(q=0.2), START, (0.0, 4.0), solver="taylor")
    (point,) = first.zeno
    assert point.t_release is None
    begun = {"y1": 0.0, "y2": 0.0, "y3": first.final.y3}
    more = hy.simulate(
        ReliefValve(q=0.2), begun, (4.0, 8.0), solver="taylor", mode="open.rest(seat)"
    )
    (known,) = joining._released([point], more)
    assert known.t_release == pytest.approx(exact(point, 0.2), abs=1e-12)


class Dragged(hy.Automaton):
    """A bead with drag by the square of its speed, on a table whose phase is 0 at a time ``t0``."""

    x = hy.state()
    v = hy.state()
    a: float = hy.parameter(0.1)
    t0: float = hy.parameter(0.0)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -9.4 - 0.2 * s.v * jnp.abs(s.v)

    hit = hy.contact(
        flight,
        gap=lambda self, t, s: s.x - self.a * jnp.cos(5.34 * (t - self.t0)),
        restitution=0.3,
    )


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
@pytest.mark.parametrize("t0", [0.0, 1e-6, 0.3])
def test_a_bead_stays_where_its_drag_changes_sides(solver, t0):
    """The drag changes its formula where the table is highest, at ``t0``; the table's acceleration
    is less than gravity by far. Near t = 0 the time is known no better than where the arc began."""
    for a in np.linspace(0.05, 0.2, 10).tolist():
        span = (t0 - 1.5, t0 + 0.5)
        run = hy.simulate(Dragged(a=a, t0=t0), [0.7, 0.0], span, solver=solver)
        assert run.mode == "flight.rest(hit)"
        assert not any("release" in edge for edge in run.jumps.edge)
