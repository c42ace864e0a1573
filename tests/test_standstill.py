"""Flows that come to a standstill in finite time, where they have no Taylor series."""

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy

from .contract.ways import SOLVERS

#: One method of each mechanism, and those that are implicit.
METHODS = ["taylor", "DOP853", "Tsit5", "LSODA", "Radau"]


def power(z, exponent):
    return jnp.sign(z) * jnp.abs(z) ** exponent


class Brake(hy.Automaton):
    """``v' = -sign(v) |v|^p``: from 1 at rest after ``1 / (1 - p)``, at ``x = 1 / (2 - p)``."""

    x = hy.state()
    v = hy.state()
    n = hy.state()
    p = hy.parameter(0.5)

    @hy.mode(initial=True)
    def moves(self, t, s):
        return s.v, -power(s.v, self.p), 0.0

    @hy.edge(moves, to=moves, guard=lambda self, t, s: 4.0 - t)
    def kick(self, t, s):
        return s.replace(v=-1.0, n=s.n + 1)


class Vessels(hy.Automaton):
    """Two vessels, one twice as wide, that level out through a hole."""

    a = hy.state()
    b = hy.state()

    @hy.mode
    def flow(self, t, s):
        q = power(s.a - s.b, 0.5)
        return -q, 2.0 * q


class FiniteTime(hy.Automaton):
    """A double integrator under a finite-time controller (Bhat and Bernstein 1998)."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def moves(self, t, s):
        return s.v, -power(s.x, 1 / 3) - power(s.v, 0.5)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("p", [0.3, 0.5])
def test_a_brake_holds_and_lets_go_again(method, p):
    """Kicked at 4, it is at rest again, where it began. Steps lose some 1e-7."""
    run = hy.simulate(Brake(p=p), [0.0, 1.0, 0.0], (0.0, 8.0), **SOLVERS[method])
    assert run(3.5).v == run(7.9).v == run.final.v == 0.0
    assert run(3.5).x == pytest.approx(1.0 / (2.0 - p), abs=1e-6)
    assert run.final.x == pytest.approx(0.0, abs=2e-6)
    assert list(run.jumps.t) == [4.0]
    assert len(run.arcs) == 2


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("start", [(2.0, 1.0), (0.3, 7.1)])
def test_vessels_stay_level(method, start):
    """Their content ``2 a + b`` stays."""
    run = hy.simulate(Vessels(), start, (0.0, 8.0), **SOLVERS[method])
    level = (2.0 * start[0] + start[1]) / 3.0
    assert run.final.a == run.final.b == pytest.approx(level, rel=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_a_finite_time_controller_stays_at_its_target(method):
    run = hy.simulate(FiniteTime(), [1.0, 0.0], (0.0, 8.0), **SOLVERS[method])
    assert tuple(run.final) == (0.0, 0.0)
    # its last turns are below the tolerances
    assert abs(run(5.2).x) > 5e-5
    assert abs(run(5.45).x) < 1e-6


def test_lanes_come_to_a_standstill():
    lanes = hy.ensemble(Vessels(), {"a": np.array([2.0, 0.3]), "b": np.array([1.0, 7.1])}, (0, 8))
    np.testing.assert_allclose(lanes.a, [5.0 / 3.0, 7.7 / 3.0], rtol=1e-9)
    np.testing.assert_array_equal(lanes.a, lanes.b)


@pytest.mark.parametrize("method", METHODS)
def test_a_run_may_begin_at_a_standstill(method):
    run = hy.simulate(Vessels(), [1.0, 1.0], (0.0, 8.0), **SOLVERS[method])
    assert tuple(run.final) == (1.0, 1.0)


class Leaves(hy.Automaton):
    """It may leave zero at any time."""

    x = hy.state()

    @hy.mode
    def flow(self, t, s):
        return power(s.x, 0.5)


class Pushed(hy.Automaton):
    """It is pushed again, for an instant at 4."""

    x = hy.state()

    @hy.mode
    def flow(self, t, s):
        return 100.0 * jnp.exp(-(((t - 4.0) / 0.01) ** 2)) - power(s.x, 0.5)


class Relay(hy.Automaton):
    """A jump, for which switching is declared."""

    x = hy.state()

    @hy.mode
    def flow(self, t, s):
        return -jnp.sign(s.x) * (1.0 + jnp.sqrt(jnp.abs(s.x)))


@pytest.mark.parametrize(("cls", "x"), [(Leaves, 0.0), (Pushed, 1.0), (Relay, 1.0)])
def test_what_may_not_stay_is_not_held(cls, x):
    with pytest.raises(hy.FlowError):
        hy.simulate(cls(), [x], (0.0, 5.0), solver="taylor")


@pytest.mark.parametrize("method", ["DOP853", "Tsit5"])
@pytest.mark.parametrize("cls", [Pushed, Relay])
def test_other_steps_do_not_hold_it_either(cls, method):
    with pytest.raises(hy.FlowError):
        hy.simulate(cls(), [1.0], (0.0, 5.0), **SOLVERS[method])
