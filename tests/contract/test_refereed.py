"""Scenes drawn at random, against the referee: ends, jumps and their times, accumulations."""

from functools import cache

import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

import hybrid as hy

from .. import referee
from ..referee import Cycle, Edge, Mode
from .ways import MECHANISMS, spread
from .ways import WAYS as EVERY

#: Scenes of each kind.
COUNT = 8

#: Tolerances of the ways, and what is left of them after some impacts; LSODA restarts at order one.
OPTIONS = {"rtol": 1e-10, "atol": 1e-12}
KEPT = {"LSODA": 1e-4}

#: Ways whose methods do not look for the places at which a force begins: the run does.
BLIND = ["DOP853", "Radau", "LSODA", "Dopri8"]

#: A guard that comes this near to zero without reaching it could be taken for a touch.
CLEAR = 1e-3

#: Jumps that follow the one before by less than this are left to ``t_inf``.
APART = 1e-2


class Shaken(hy.Automaton):
    """A ball on a shaking table, under a force that changes its sign."""

    x = hy.state()
    v = hy.state()
    g: float = hy.parameter(10.0)
    r: float = hy.parameter(0.5)
    size: float = hy.parameter(0.1)
    omega: float = hy.parameter(3.0)
    push: float = hy.parameter(2.0)
    pace: float = hy.parameter(1.0)

    @hy.mode
    def flight(self, t, s):
        push = jnp.where(jnp.sin(self.pace * t) > 0, self.push, -self.push)
        return s.v, push - self.g

    impact = hy.contact(
        flight,
        gap=lambda self, t, s: s.x - self.size * jnp.sin(self.omega * t),
        restitution="r",
    )


class Hysteresis(hy.Automaton):
    """A damped oscillator pushed to and fro; each switch takes a share of the speed."""

    x = hy.state()
    v = hy.state()
    stiff: float = hy.parameter(1.0)
    damp: float = hy.parameter(0.1)
    push: float = hy.parameter(3.0)
    edge: float = hy.parameter(1.0)
    share: float = hy.parameter(0.8)

    @hy.mode(initial=True)
    def up(self, t, s):
        return s.v, self.push - self.stiff * s.x - self.damp * s.v

    @hy.mode
    def down(self, t, s):
        return s.v, -self.push - self.stiff * s.x - self.damp * s.v

    @hy.edge(up, to=down, guard=lambda self, t, s: self.edge - s.x)
    def over(self, t, s):
        return s.replace(v=self.share * s.v)

    @hy.edge(down, to=up, guard=lambda self, t, s: s.x + self.edge)
    def under(self, t, s):
        return s.replace(v=self.share * s.v)


class Neuron(hy.Automaton):
    """It charges, and discharges at a threshold that moves; resets are counted."""

    x = hy.state()
    n = hy.state()
    drive: float = hy.parameter(2.0)
    sway: float = hy.parameter(0.5)
    omega: float = hy.parameter(2.0)
    rim: float = hy.parameter(0.1)
    drop: float = hy.parameter(0.9)

    @hy.mode
    def charge(self, t, s):
        return self.drive + self.sway * jnp.cos(self.omega * t) - s.x, 0.0

    @hy.edge(charge, to=charge, guard=lambda self, t, s: 1.0 + self.rim * jnp.sin(3.0 * t) - s.x)
    def fire(self, t, s):
        return s.replace(x=s.x - self.drop, n=s.n + 1)


class Gust(hy.Automaton):
    """A ball falls through a layer of wind onto a floor."""

    x = hy.state()
    v = hy.state()
    g: float = hy.parameter(10.0)
    r: float = hy.parameter(0.5)
    wind: float = hy.parameter(5.0)
    low: float = hy.parameter(0.4)
    wide: float = hy.parameter(0.2)

    @hy.mode
    def flight(self, t, s):
        inside = (s.x > self.low) & (s.x < self.low + self.wide)
        return s.v, jnp.where(inside, self.wind, 0.0) - self.g

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")


def falling(a):
    """Motion under an acceleration."""

    def motion(t0, x0, t):
        s = t - t0
        return [x0[0] + s * (x0[1] + a * s / 2), x0[1] + a * s]

    return motion


def shaken(p, x, t):
    """The referee's modes: the two signs of the force, in flight and at rest."""

    def table(t):
        return p.size * mp.sin(p.omega * t), p.size * p.omega * mp.cos(p.omega * t)

    def strike(t, x):
        place, speed = table(t)
        return [place, speed - p.r * (x[1] - speed)]

    def load(push):
        return lambda t, x: p.g - push - p.size * p.omega**2 * mp.sin(p.omega * t)

    modes = {}
    for name, other, push in (("plus", "minus", p.push), ("minus", "plus", -p.push)):
        turn = lambda t, x: mp.sin(p.pace * t)  # noqa: E731
        hit = Edge("impact", name, lambda t, x: x[0] - table(t)[0], strike)
        turns = Edge("", other, turn, either=True, silent=True)
        modes[name] = Mode([turns, hit], motion=falling(push - p.g))
        off = Edge("impact.release", name, load(push))
        turns = Edge("", f"{other}.rest", turn, either=True, silent=True)
        still = lambda t0, x0, t: [*table(t)]  # noqa: E731
        modes[f"{name}.rest"] = Mode([turns, off], motion=still)
    ends = Cycle(("impact",), {n: f"{n}.rest" for n in ("plus", "minus")}, lambda t, x: [*table(t)])
    first = "plus" if mp.sin(p.pace * mp.mpf("1e-9")) > 0 else "minus"
    return referee.simulate(modes, first, x, t, 1 / 128, [ends])


def hysteresis(p, x, t):
    """The closed form is left to small steps."""

    def moves(push):
        return lambda t, x: [x[1], push - p.stiff * x[0] - p.damp * x[1]]

    slow = lambda t, x: [x[0], p.share * x[1]]  # noqa: E731
    over = Edge("over", "down", lambda t, x: p.edge - x[0], slow)
    under = Edge("under", "up", lambda t, x: x[0] + p.edge, slow)
    modes = {"up": Mode([over], flow=moves(p.push)), "down": Mode([under], flow=moves(-p.push))}
    return referee.simulate(modes, "up", x, t, 1 / 8)


def neuron(p, x, t):
    """Charging in closed form, to a threshold that moves."""

    def forced(t):
        wave = mp.cos(p.omega * t) + p.omega * mp.sin(p.omega * t)
        return p.drive + p.sway * wave / (1 + p.omega**2)

    charge = lambda t0, x0, t: [forced(t) + (x0[0] - forced(t0)) * mp.exp(t0 - t), x0[1]]  # noqa: E731
    limit = lambda t, x: 1 + p.rim * mp.sin(3 * t) - x[0]  # noqa: E731
    fire = Edge("fire", "charge", limit, lambda t, x: [x[0] - p.drop, x[1] + 1])
    return referee.simulate({"charge": Mode([fire], motion=charge)}, "charge", x, t, 1 / 32)


def gust(p, x, t):
    """Three layers, each with its parabola; none of their borders is a jump."""
    top = p.low + p.wide
    border = lambda to, guard: Edge("", to, guard, silent=True)  # noqa: E731
    hit = Edge("impact", "below", lambda t, x: x[0], lambda t, x: [mp.mpf(0), -p.r * x[1]])
    modes = {
        "above": Mode([border("in", lambda t, x: x[0] - top)], motion=falling(-p.g)),
        "in": Mode(
            [
                border("below", lambda t, x: x[0] - p.low),
                border("above", lambda t, x: top - x[0]),
            ],
            motion=falling(p.wind - p.g),
        ),
        "below": Mode([hit, border("in", lambda t, x: p.low - x[0])], motion=falling(-p.g)),
        "below.rest": Mode(motion=lambda t0, x0, t: x0),
    }
    ends = Cycle(("impact",), {"below": "below.rest"}, lambda t, x: [mp.mpf(0), mp.mpf(0)])
    return referee.simulate(modes, "above", x, t, 1 / 256, [ends])


#: Kind: (model, the referee's run, last time, ranges of the start, ranges of the parameters).
KINDS = {
    "calm": (Shaken, shaken, 4.0, {"x": (0.5, 1.5), "v": (-1, 1)},
             {"r": (0.1, 0.7), "size": (0.02, 0.15), "omega": (2, 5), "push": (0, 3),
              "pace": (1, 4)}),
    "thrown by the table": (Shaken, shaken, 3.0, {"x": (0.8, 1.5), "v": (-1, 1)},
                            {"r": (0.1, 0.4), "size": (0.3, 0.5), "omega": (6, 8),
                             "push": (0, 1), "pace": (1, 4)}),
    "thrown by the force": (Shaken, shaken, 4.0, {"x": (0.3, 0.6), "v": (-1, 1)},
                            {"r": (0.1, 0.4), "size": (0.02, 0.05), "omega": (2, 4),
                             "push": (11, 15), "pace": (1.5, 3)}),
    "hysteresis": (Hysteresis, hysteresis, 6.0, {"x": (-0.5, 0.5), "v": (-1, 1)},
                   {"stiff": (0.5, 2), "damp": (0, 0.3), "push": (2.5, 5), "edge": (0.8, 1.2),
                    "share": (0.3, 1.2)}),
    "neuron": (Neuron, neuron, 4.0, {"x": (-0.5, 0.5), "n": (0, 0)},
               {"drive": (1.8, 4), "sway": (0, 0.6), "omega": (1, 9), "rim": (0, 0.3),
                "drop": (0.5, 1.5)}),
    "gust": (Gust, gust, 4.0, {"x": (1.0, 2.0), "v": (-1, 0)},
             {"r": (0.2, 0.7), "wind": (-20, 20), "low": (0.2, 0.5), "wide": (0.01, 0.3)}),
}  # fmt: skip


class Named(dict):
    """Parameters by attribute, in the referee's digits."""

    def __getattr__(self, name):
        return mp.mpf(self[name])


@cache
def scenes(kind):
    """Starts, parameters and the referee's outcomes; a scene that comes too close is drawn anew."""
    model, run, last, ranges, numbers = KINDS[kind]
    random = np.random.default_rng(sum(map(ord, kind)))
    found = []
    while len(found) < COUNT:
        start = {name: random.uniform(*ends) for name, ends in ranges.items()}
        given = {name: random.uniform(*ends) for name, ends in numbers.items()}
        values = Named({p.name: p.default for p in model.spec.parameters} | given)
        out = run(values, list(start.values()), (0.0, last))
        if out.nearest > CLEAR:
            found.append((start, given, out))
    return found


@cache
def results(name, kind):
    """All scenes of a kind on one way."""
    model, _, last, _, numbers = KINDS[kind]
    starts, given, _ = zip(*scenes(kind), strict=True)
    columns = {n: [row[n] for row in given] for n in numbers}
    return EVERY[name].many(model(), starts, (0.0, last), columns, **OPTIONS)


@pytest.mark.parametrize("scene", range(COUNT))
@pytest.mark.parametrize(("way", "kind"), spread(MECHANISMS, [*KINDS]), indirect=["way"])
def test_the_referee_agrees(way, kind, scene):
    """End, mode, number and times of jumps, accumulations."""
    result, (_, _, out) = results(way.name, kind)[scene], scenes(kind)[scene]
    kept = KEPT.get(way.name, 1e-6)
    assert result.status == "reached_end"
    times = np.array([float(t) for t, *_ in out.jumps])
    apart = times if not out.limits else times[: 1 + np.argmax(np.diff(times) < APART)]
    if out.limits and not way.tells("all zeno"):  # lanes sum early, and list what was not summed
        apart = apart[: max(np.sum(result.times < result.t_inf), 1)]
    np.testing.assert_allclose(result.times[: len(apart)], apart, atol=kept)
    if not out.limits:
        assert result.jumps == len(times)
    if way.tells("edges"):
        assert result.edges[: len(apart)] == [edge for _, edge, *_ in out.jumps[: len(apart)]]
    if way.tells("accumulations"):
        assert result.accumulations == len(out.limits)
    limit = float(out.limits[0][0]) if out.limits else np.nan
    assert result.t_inf == pytest.approx(limit, abs=kept, nan_ok=True)
    final = [float(v) for v in out.x]
    np.testing.assert_allclose(list(result.final), final, atol=100 * kept)
    if way.tells("mode"):
        assert ("rest" in result.mode) == ("rest" in out.mode)


@pytest.mark.parametrize("way", BLIND, indirect=True)
@pytest.mark.parametrize("scene", range(COUNT))
def test_the_bound_holds_behind_a_gust(way, scene):
    """The second run, in Taylor series, ends steps at its borders by another rule."""
    result, (_, _, out) = results(way.name, "gust")[scene], scenes("gust")[scene]
    assert abs(result.t_inf - float(out.limits[0][0])) <= result.t_error
