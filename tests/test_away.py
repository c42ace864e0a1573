"""Guards that are bounded where a step is longer than their series."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.lowering.lowered import ORDER
from hybrid.lowering.scene import scene_of
from hybrid.rules.load import Library
from models.bead_on_table import BeadOnTable

#: Of ``t``, ``x`` and ``y``: what is bounded of them, and what is not.
BOUNDED = [
    lambda t, x, y: x * y - 3.0 * t,
    lambda t, x, y: x**2 - y / (2.0 + x**2),
    lambda t, x, y: jnp.sin(3.0 * x + t) * jnp.cos(y),
    lambda t, x, y: jnp.exp(-x) + jnp.sqrt(4.0 + y),
    lambda t, x, y: 1.0 / (1.0 + ((t - 0.3) / 0.01) ** 2) - x,
    lambda t, x, y: jnp.sin(1e7 * x) + 0.1 * y,
    lambda t, x, y: jnp.dot(jnp.array([x, y, t]), jnp.array([y, y, x])) + x + y + t,
]
UNKNOWN = [
    lambda t, x, y: jnp.tanh(x) + y,
    lambda t, x, y: abs(x) * y,
    lambda t, x, y: y / (x - 0.1),
    lambda t, x, y: jnp.sqrt(x - 0.1),
]


@pytest.fixture(params=["machine", "checked"])
def unit(request, monkeypatch):
    monkeypatch.setenv("HYBRID_RULES", request.param)
    return Library("hybrid.rules").unit


def program(expression):
    """The flow ``x' = expression(t, x, y)``, ``y' = 0``, as a program."""

    class Flow(hy.Automaton):
        x = hy.state()
        y = hy.state()

        @hy.mode
        def flow(self, t, s):
            return expression(t, s.x, s.y), 0.0

    return scene_of(Flow()).field("flow").jets


def bounds(unit, jets, box):
    """Bounds of the expression over a box of x, y and t."""
    room = jets.room(ORDER)
    room.aside[: len(box), :2] = box
    unit("away").follow(jets.alone, 0, room.aside)
    return room.aside[jets.alone.flow[0], :2]


@pytest.mark.parametrize("number", range(len(BOUNDED)))
def test_bounds_hold_all_values(unit, number):
    jets, rng = program(BOUNDED[number]), np.random.default_rng(number)
    for size in (1e-8, 1e-3, 0.5):
        middle = rng.uniform(-0.9, 0.9, 3)
        box = np.column_stack([middle - size, middle + size])
        low, high = bounds(unit, jets, box)
        points = [box[:, 0], box[:, 1], *rng.uniform(*box.T, (30, 3))]
        values = [float(BOUNDED[number](t, x, y)) for x, y, t in points]
        assert low <= min(values)
        assert max(values) <= high
    assert high < math.inf


@pytest.mark.parametrize("number", range(len(UNKNOWN)))
def test_what_is_not_known_is_not_bounded(unit, number):
    low, high = bounds(unit, program(UNKNOWN[number]), np.array([[-1.0, 1.0]] * 3))
    assert math.isnan(low)
    assert math.isnan(high)


def test_where_a_table_is_far_its_series_do_not_shorten_the_steps():
    """A bead that is thrown over some ten turns of the table: its own series is exact all along."""
    model, until = BeadOnTable(r=0.85, omega=7.0), (0.0, 40.0)
    run = hy.simulate(model, [5.0, 0.0], until, solver="taylor")
    assert len(run.jumps) > 10
    assert run.stats.steps < 4.5 * len(run.jumps)  # 12 where they do
    other = hy.simulate(model, [5.0, 0.0], until, solver="taylor", max_step=0.1)
    assert other.stats.steps > 10 * len(run.jumps)
    few = slice(0, 5)  # an error grows sixfold from impact to impact
    np.testing.assert_allclose(run.jumps.t[few], other.jumps.t[few], rtol=1e-12)


class Spiked(hy.Automaton):
    """A body thrown up at speed 20 from 1 over a floor from which a spike rises for an instant."""

    x = hy.state()
    v = hy.state()
    due = hy.parameter(2.0)
    width = hy.parameter(1e-3)
    height = hy.parameter(30.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -10.0

    spike = hy.contact(
        flight,
        gap=lambda self, t, s: s.x - self.height / (1.0 + ((t - self.due) / self.width) ** 2),
        restitution=0.5,
    )


@pytest.mark.parametrize("width", [1e-1, 1e-3, 1e-6])
@pytest.mark.parametrize("due", [0.9, 1.9, 3.5])
def test_a_spike_in_a_long_step_is_struck(width, due):
    """It has the flight's height, before it is due, where ``((t - due) / width)^2 = height/x - 1``;
    a lower one is passed."""

    def above(t):
        return 1.0 + 20.0 * t - 5.0 * t**2

    run = hy.simulate(
        Spiked(due=due, width=width), [1.0, 20.0], (0.0, due), solver="taylor", max_jumps=1
    )
    t = run.jumps.t[0]
    assert t == pytest.approx(due - width * math.sqrt(30.0 / above(t) - 1.0), rel=1e-12)
    low = Spiked(due=due, width=width, height=0.9 * above(due))
    run = hy.simulate(low, [1.0, 20.0], (0.0, due + 0.3), solver="taylor")
    assert len(run.jumps) == 0
