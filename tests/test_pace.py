"""Steps that do not get to the end are told apart from those that are many."""

from contextlib import nullcontext
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.lowering import scene_of
from hybrid.run.losses import Losses
from hybrid.run.pace import COUNTED, Pace

from .contract.ways import spread

SOLVERS = [
    {"solver": "taylor"},
    {"solver": "scipy", "method": "DOP853"},
    {"solver": "scipy", "method": "LSODA"},
    {"solver": "diffrax", "method": "Tsit5"},
]


class Stuck(hy.Automaton):
    """Dry friction written as a flow that jumps: from both sides it leads back to ``v = 0``."""

    x = hy.state()
    v = hy.state()
    scale = hy.parameter(1.0)

    @hy.mode(initial=True)
    def moving(self, t, s):
        return s.v, -s.x - 0.1 * self.scale * jnp.sign(s.v)

    wall = hy.contact(moving, gap=lambda self, t, s: s.x + 5.0 * self.scale, restitution=0.5)


class Stiff(hy.Automaton):
    """A stop as a stiff spring, whose force begins at zero, and a flow that jumps on."""

    x = hy.state()
    v = hy.state()

    @hy.mode(initial=True)
    def moving(self, t, s):
        return s.v, -1.0 + 1e12 * jnp.maximum(-s.x, 0.0) + 0.5 * jnp.sign(s.v)


@pytest.mark.parametrize(
    ("options", "save", "scale"), spread(SOLVERS, ["dense", "jumps"], [1e-9, 1.0, 1e9]), ids=str
)
def test_a_flow_that_leads_back_to_its_jump_ends_in_an_error(options, save, scale):
    """No solver goes on for ever in steps as short as its tolerance; the remedy is named."""
    start, options = {"x": scale, "v": 0.0}, {**options, "atol": 1e-10 * scale, "save": save}
    with pytest.raises(hy.FlowError, match=r"Stuck, mode moving, t = 15\.7.*declare hy\.switching"):
        hy.simulate(Stuck(scale=scale), start, (0.0, 1e3), rtol=1e-8, **options)


class Swinging(hy.Automaton):
    """A force that swings ever faster on the way to ``x = 0``."""

    x = hy.state()

    @hy.mode(initial=True)
    def falls(self, t, s):
        return -1.0 + 0.5 * jnp.sin(1.0 / s.x)

    @hy.edge(falls, to=falls, guard=lambda self, t, s: s.x + 1.0)
    def back(self, t, s):
        return 1.0


@pytest.mark.parametrize("options", SOLVERS, ids=lambda o: o.get("method", o["solver"]))
def test_steps_that_become_ever_shorter_end_in_an_error(options):
    """Long before the time of a force ``sin(1/x)`` at zero is reached."""
    with pytest.raises(hy.FlowError, match=r"Swinging, mode falls, t = .*ever shorter"):
        hy.simulate(Swinging(), {"x": 1.0}, (0.0, 1e3), rtol=1e-8, **options)


class Spiral(hy.Automaton):
    """A body that two forces of constant size, one of them friction, stop in a finite time."""

    x = hy.state()
    v = hy.state()
    friction = hy.parameter(0.5)

    @hy.mode
    def moves(self, t, s):
        return s.v, -jnp.sign(s.x) - self.friction * jnp.sign(s.v)


@pytest.mark.parametrize("friction", [0.3, 0.5, 0.7])
def test_steps_as_short_as_the_spacing_of_the_time_end_in_an_error(friction):
    """Where the state changes no more, but in its sign."""
    told = r"Spiral, mode moves, t = .*(ever shorter|became zero|steps the last are of)"
    with pytest.raises(hy.FlowError, match=told):
        hy.simulate(Spiral(friction=friction), {"x": 1.0, "v": 0.0}, (0.0, 30.0), solver="taylor")


@pytest.mark.parametrize(("model", "stuck"), [(Stuck(), True), (Stiff(), False)])
def test_short_steps_alone_are_no_error(model, stuck):
    """Next to a corner of a force, or over a jump to which one side does not lead, all is well."""
    field = scene_of(model).field("moving")
    losses = Losses(SimpleNamespace(limit=0.0, rtol=0.0), True, np.zeros(2))
    for v in (-1e-12, 0.0, 1e-12):
        pace = Pace(field, 0.0, 1.0, losses)
        with pytest.raises(hy.FlowError) if stuck else nullcontext():
            for k in range(4 * COUNTED):
                pace.steps(1e-10 * (k + 1), np.array([1e-12, v]))


class SuperTwistingAtOnce(hy.Automaton):
    """A super-twisting controller written as a flow that jumps: at its limit the jumps go on."""

    x = hy.state()
    z = hy.state()

    @hy.mode
    def moves(self, t, s):
        side = jnp.sign(s.x)
        return s.z - 1.5 * jnp.sqrt(jnp.abs(s.x)) * side, -1.1 * side


@pytest.mark.parametrize(("solver", "method"), [("scipy", "DOP853"), ("diffrax", "Tsit5")])
def test_jumps_of_a_flow_that_go_on_in_noise_end_in_an_error(solver, method):
    """Their steps no longer shrink: 1e14 of them would have led to the end."""
    told = r"SuperTwistingAtOnce, mode moves, t = 1\.71.*(ever shorter|steps the last are of)"
    model, start = SuperTwistingAtOnce(), {"x": 1.0, "z": 0.5}
    with pytest.raises(hy.FlowError, match=told):
        hy.simulate(model, start, (0.0, 30.0), solver=solver, method=method)
