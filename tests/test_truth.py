"""Systems whose truth is known, and what a run says of them: no false alarm, none missed."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from models.ball_on_circle import BallOnCircle
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall
from models.coupled import Coupled
from models.hard_spring import HardSpring
from models.moon_holmes import MoonHolmes
from models.two_tanks import TwoTanks

from . import systems
from .contract.ways import later
from .test_cycles import Box, LateInflow, PowerLaw, Rocking

BORDER = 0.150562297509349608672127586612455896897636764


class Kicked(systems.LawBall):
    """``v+ = 0.5 |v| + 0.1``: the wall gives back; impacts settle at a speed of 0.2."""

    impact = hy.contact(
        "flight",
        gap=lambda self, t, s: s.x,
        restitution=lambda self, t, s, u: 0.5 + 0.1 / jnp.maximum(jnp.abs(u), 1e-9),
    )


class Gaining(systems.LawBall):
    """``v+ = 1.01 |v|``."""

    impact = hy.contact(
        "flight", gap=lambda self, t, s: s.x, restitution=lambda self, t, s, u: 1.01 + 0.0 * u
    )


class Fading(systems.LawBall):
    """``v+ = |v| / (1 + |v|^1.5)``: the n-th flight lasts like n^(-2/3), which has no sum."""

    impact = hy.contact(
        "flight",
        gap=lambda self, t, s: s.x,
        restitution=lambda self, t, s, u: 1.0 / (1.0 + jnp.abs(u) ** 1.5),
    )


class DroppedTable(hy.Automaton):
    """The table falls away at t = 2.5, faster than the ball; it would have rested at 2.5586."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.v, -9.81

    def table(self, t):
        late = jnp.maximum(t - 2.5, 0.0)
        return -20.0 * late**3 - 10.0 * late**2

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - self.table(t), restitution=0.7)


class Settling(hy.Automaton):
    """A thermostat whose heater weakens towards a value that it keeps: gaps shrink, to a limit."""

    T = hy.state()

    @hy.mode(initial=True)
    def off(self, t, s):
        return (-1.0 - jnp.tanh(t),)

    @hy.mode
    def on(self, t, s):
        return (1.0 + jnp.tanh(t),)

    @hy.edge(off, to=on, guard=lambda self, t, s: s.T - 19.0)
    def heats(self, t, s):
        return s

    @hy.edge(on, to=off, guard=lambda self, t, s: 21.0 - s.T)
    def cools(self, t, s):
        return s


def drop(r, g=9.81):
    return math.sqrt(2 / g) * (1 + r) / (1 - r)


def rocked(r):
    return math.fsum(np.arctanh(r ** np.arange(5000) * 0.4 / 0.5))


def softened():
    """Sum of the flights of ``v+ = 0.7 v / (1 + 0.1 v)``, g = 2, from v = 1."""
    v, t = 1.0, 0.0
    for _ in range(500):
        t, v = t + v, 0.7 * v / (1 + 0.1 * v)
    return t


class Soft(systems.LawBall):
    """``v+ = 0.7 |v| / (1 + 0.1 |v|)``."""

    impact = hy.contact(
        "flight",
        gap=lambda self, t, s: s.x,
        restitution=lambda self, t, s, u: 0.7 / (1 + 0.1 * jnp.abs(u)),
    )


#: The paper begins Example 2 after one period of the table.
PERIOD = (2 * math.pi / 0.29, 45.0)

#: Name: (model, start, last time or both, when the jumps accumulate).
ZENO = {
    "a ball": (BouncingBall(), [1.0, 0.0], 3, drop(0.7)),
    "a ball, r = 0.1": (BouncingBall(r=0.1), [1.0, 0.0], 1, drop(0.1)),
    "a ball, r = 0.999": (BouncingBall(r=0.999), [1.0, 0.0], 1000, drop(0.999)),
    "a hard spring": (HardSpring(), [2.1, 0.0], 2, 1.32961738383844857732),
    "a bead on a table": (BeadOnTable(), [1.9, 0.0], PERIOD, 33.51986976147157350465),
    "coupled bodies": (Coupled(), [6, 0, 10, -1000], 20, 19.19289834649200423373720411427447),
    "weakening gravity, -1e-2": (
        systems.WeakeningGravity(),
        [0.0, 0.14905667453425611],
        2,
        0.93777856546121584478589917023539381,
    ),
    "weakening gravity, -1e-8": (
        systems.WeakeningGravity(),
        [0.0, 0.1505621469470521],
        2,
        0.99975911435253431946527278325739448,
    ),
    "a soft wall": (Soft(), [0.0, 1.0], 5, softened()),
    "two tanks": (TwoTanks(), [8.0, 6.0], 30, 20.0),
    "a rocking block": (Rocking(), [0.0, 0.4], 60, rocked(0.9)),
    "flights like 1/n^2": (PowerLaw(), [0.0, 1.0], 3, math.pi**2 / 6),
    "a corner": (Box(), [1.0, 1.0, 0.0, 0.0], 9, drop(0.6, 1.0)),
    "a corner, two series": (Box(r2=7 / 9), [1.0, 0.25, 0.0, 0.0], 9, drop(0.6, 1.0)),
}

#: Name: (model, start, last time).
DECOYS = {
    "elastic": (BouncingBall(r=1.0), [1.0, 0.0], 20),
    "plastic": (BouncingBall(r=0.0), [1.0, 0.0], 3),
    "harmonic": (systems.HarmonicBall(), [0.0, 1.0], 6),
    "flights like n^(-2/3)": (Fading(), [0.0, 1.0], 30),
    "v+ = r|v| + c": (Kicked(), [0.0, 1.0], 20),
    "a wall that gives": (Gaining(), [0.0, 1.0], 40),
    "weakening gravity, +1e-2": (systems.WeakeningGravity(), [0.0, BORDER * (1 + 1e-2)], 2),
    "weakening gravity, +1e-6": (systems.WeakeningGravity(), [0.0, BORDER * (1 + 1e-6)], 2),
    "Budd and Dux": (systems.ForcedOscillator(), [0.0, -0.05], 2),
    "a table that falls away": (DroppedTable(), [1.0, 0.0], 2.7),
    "tanks in balance": (TwoTanks(w=2.0), [8.0, 6.0], 60),
    "tanks saved late": (LateInflow(at=19.999), [8.0, 6.0], 22),
    "gaps to a limit": (Settling(), [20.0], 40),
}

SOLVERS = pytest.mark.parametrize("solver", ["scipy", "taylor", *later("diffrax")])


@SOLVERS
@pytest.mark.parametrize("name", ZENO)
def test_what_accumulates_is_found(name, solver):
    """The first accumulation is there; its bound holds, and is no more than a thousand too wide."""
    model, start, end, exact = ZENO[name]
    span = end if isinstance(end, tuple) else (0, end)
    run = hy.simulate(model, start, span, rtol=1e-9, atol=1e-11, solver=solver)
    point = run.zeno[0]
    error = abs(point.t - exact)
    assert error <= point.t_error
    # below some hundred roundings of t, an error is small by luck
    assert point.t_error <= 1e3 * max(error, 500 * np.spacing(exact))


@SOLVERS
@pytest.mark.parametrize("name", DECOYS)
def test_what_does_not_accumulate_is_not_said_to(name, solver):
    """Shrinking gaps or none: no accumulation, and the run reaches its end."""
    model, start, end = DECOYS[name]
    run = hy.simulate(model, start, (0, end), rtol=1e-9, atol=1e-11, solver=solver)
    assert not run.zeno
    assert run.status is hy.Status.REACHED_END
    assert len(run.jumps) > 0


@SOLVERS
@pytest.mark.parametrize("share", [1e-6, 1e-9, 1e-12])
def test_on_both_sides_of_the_border(share, solver):
    """Weakening gravity down to 1e-12 from the speed that parts escape from accumulation."""
    tight = {"rtol": 1e-13, "atol": 1e-15, "solver": solver}
    for sign, count in ((-1, 1), (1, 0)):
        start = [0.0, BORDER * (1 + sign * share)]
        run = hy.simulate(systems.WeakeningGravity(), start, (0, 2), **tight)
        assert len(run.zeno) == count


def test_moon_and_holmes_and_the_circle(reference):
    """Two accumulations without a closed form: the references, inside the bounds."""
    model = MoonHolmes(delta=0.0, gamma=0.0)
    case = reference["moon_holmes delta=0,gamma=0,w=0.1"]
    run = hy.simulate(model, [1.3, 0.0], (0, 60), rtol=1e-9)
    assert abs(run.zeno[0].t - float(case["t_inf"])) <= run.zeno[0].t_error
    far = hy.simulate(BallOnCircle(), {"q": [0.192, 1.2], "p": [0, 0]}, (0, 6), rtol=1e-9)
    assert not far.zeno
