"""Guards that are zero at one time, and such as change their formula, with the loop and without."""

import attrs
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.rules.load import Library
from hybrid.rules.places import END, FULL, LOOK
from hybrid.run import machine

from .systems import without_loop
from .test_advance import calls, same, taylor


class Marks(hy.Automaton):
    """Three points between marks that they reach at one time; guards in units of their own."""

    x = hy.state()
    y = hy.state()
    z = hy.state()
    u = hy.state()
    v = hy.state()
    w = hy.state()
    n = hy.state()
    m = hy.state()
    a = hy.parameter(1.0)
    b = hy.parameter(1.0)
    c = hy.parameter(1.0)
    units = hy.parameter(1.0)
    others = hy.parameter(1.0)

    @hy.mode(initial=True)
    def fly(self, t, s):
        return s.u, s.v, s.w, 0.0, 0.0, 0.0, 0.0, 0.0

    @hy.edge(fly, to=fly, guard=lambda self, t, s: self.units * (self.a - s.x))
    def right(self, t, s):
        return s.replace(u=-s.u, n=s.n + 1.0)

    @hy.edge(fly, to=fly, guard=lambda self, t, s: self.others * (s.y - self.b), crossing=hy.RISING)
    def up(self, t, s):
        return s.replace(v=-s.v, n=2.0 * s.n)

    @hy.edge(fly, to=fly, guard=lambda self, t, s: self.units * (s.z - self.c), crossing=hy.EITHER)
    def passes(self, t, s):
        return s.replace(m=s.m + 1.0 + s.n)

    @hy.edge(fly, to=fly, guard=lambda self, t, s: self.units * (s.x + self.a))
    def left(self, t, s):
        return s.replace(u=-s.u, n=s.n + 3.0)

    @hy.edge(fly, to=fly, guard=lambda self, t, s: s.y + self.b)
    def down(self, t, s):
        return s.replace(v=-s.v, n=s.n + 5.0)

    @hy.edge(fly, to=fly, guard=lambda self, t, s: s.z - 0.2 * s.x, crossing=hy.RISING)
    def count(self, t, s):
        return s.replace(m=s.m + 0.5)


class Walls(hy.Automaton):
    """A forced oscillator between walls that are one guard with ``abs``, and guards with
    ``minimum`` and ``where``, which bound nothing."""

    x = hy.state()
    v = hy.state()
    n = hy.state()
    a = hy.parameter(1.0)
    r = hy.parameter(0.9)
    f = hy.parameter(1.0)
    d = hy.parameter(0.3)
    q = hy.parameter(0.7)

    @hy.mode(initial=True)
    def fly(self, t, s):
        return s.v, -s.x + self.f * jnp.cos(1.3 * t), 0.0

    @hy.edge(fly, to=fly, guard=lambda self, t, s: self.a - jnp.abs(s.x))
    def wall(self, t, s):
        return s.replace(v=-self.r * s.v)

    @hy.edge(
        fly,
        to=fly,
        guard=lambda self, t, s: jnp.minimum(s.x - self.d, s.v + 0.1),
        crossing=hy.EITHER,
    )
    def low(self, t, s):
        return s.replace(n=s.n + 1.0)

    @hy.edge(
        fly,
        to=fly,
        guard=lambda self, t, s: jnp.where(s.v > self.q, s.x - 0.2, 0.5 * s.x + 0.3),
        crossing=hy.RISING,
    )
    def switches(self, t, s):
        return s.replace(n=s.n + 100.0)


def marks(seed):
    """Points whose times are equal but for rounding, in units of any size."""
    rng = np.random.default_rng(seed)
    u, a, t0 = rng.uniform(0.3, 2.0), rng.uniform(0.5, 2.0), rng.choice([0.0, 1e3])
    b, c = rng.choice([0.5, 1.0, 2.0, 3.0]), rng.choice([1.0, 2.0])
    units = {"units": 10.0 ** rng.choice([-3, 0, 200]), "others": 10.0 ** rng.choice([-3, 0, 5])}
    speeds = {"u": u, "v": u * b, "w": u * c * rng.choice([-1.0, 1.0])}
    start = {"x": 0.0, "y": 0.0, "z": 0.0, **speeds, "n": 0.0, "m": 0.0}
    return Marks(a=a, b=a * b, c=0.5 * a * c, **units), start, (t0, t0 + 11.7 * a / u)


def walls(seed):
    """Walls and a force by chance."""
    rng = np.random.default_rng(seed)
    model = Walls(
        a=rng.uniform(0.2, 1.2),
        r=rng.uniform(0.6, 1.0),
        f=rng.uniform(0.0, 2.0),
        d=rng.uniform(-0.3, 0.3),
        q=rng.uniform(-0.5, 0.9),
    )
    return model, {"x": 0.0, "v": rng.uniform(-1.0, 1.5), "n": 0.0}, (0.0, 15.0)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("drawn", [marks, walls])
def test_ties_and_kinked_guards_are_those_of_the_rules_one_by_one(drawn, seed, monkeypatch):
    """With the loop and without it: which fires first, what follows at once, and where."""
    scene = drawn(seed)
    run = taylor(scene)
    without_loop(monkeypatch)
    same(run, taylor(scene), scene[2])


@pytest.mark.parametrize("seed", range(6))
def test_ties_are_judged_in_the_loop(seed, monkeypatch):
    """It comes back at the end alone: of guards that are zero at one time the first declared
    fires, the others before any flow."""
    scene = marks(seed)
    taylor(scene)
    found = calls(monkeypatch)
    run = taylor(scene)
    assert 0.0 in np.diff(run.jumps.t)
    assert set(found) <= {FULL, END}


@pytest.mark.parametrize("seed", range(6))
def test_kinked_guards_are_searched_in_the_loop(seed, monkeypatch):
    """It comes back where a guard that may jump has fired; where none jumps over zero, never to
    look at an arc once more."""
    model, start, span = walls(seed)
    scene = attrs.evolve(model, q=10.0), start, span
    taylor(scene)
    found = calls(monkeypatch)
    run = taylor(scene)
    assert {"wall", "low"} <= set(run.jumps.edge)
    assert LOOK not in found


@pytest.mark.parametrize("drawn", [marks, walls])
def test_ties_and_kinked_guards_as_plain_python_agree(drawn, monkeypatch):
    """No index is below zero."""
    model, start, (t0, t1) = drawn(1)
    scene = model, start, (t0, t0 + 0.3 * (t1 - t0))
    run = taylor(scene, save="jumps")
    monkeypatch.setenv("HYBRID_RULES", "checked")
    monkeypatch.setattr(machine, "unit", Library("hybrid.rules").unit)
    same(run, taylor(scene, save="jumps"), scene[2])
