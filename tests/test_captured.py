"""What a model's functions see besides their arguments is part of the model, or refused."""

import random
import time
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.numpy import mod

import hybrid as hy
from hybrid.automaton.captured import captured, may_vary

GRAVITY = 9.81
SETTINGS = {"drag": 0.1}
CONFIG = SimpleNamespace(wind=np.array([0.0, 1.0]))
DRAW = np.random.default_rng(0)
COUNT = [0]
x = 1.0  # has the name of a state, and is read by no function


def pull(v):
    return GRAVITY + SETTINGS["drag"] * v + CONFIG.wind[0]


@jax.jit
def push(v):
    return pull(v)


def ball(flow=None, reset=None):
    """A ball whose flow and reset are given."""

    class Ball(hy.Automaton):
        x = hy.state()
        v = hy.state()
        floor = 0.0

        def height(self, s):
            return s.x - self.floor

        @hy.mode
        def flight(self, t, s):
            return s.v, -GRAVITY if flow is None else flow(s)

        @hy.edge(flight, to=flight, guard=lambda self, t, s: self.height(s))
        def bounce(self, t, s):
            return s.replace(v=-0.5 * s.v if reset is None else reset(s))

    return Ball


def counted(s):
    COUNT[0] += 1
    return s.v + COUNT[0]


@pytest.mark.parametrize(
    ("reset", "name"),
    [
        (lambda s: np.random.rand(), "np"),  # noqa: NPY002
        (lambda s: -s.v * random.random(), "random"),
        (lambda s: DRAW.normal(), "DRAW"),
        (lambda s: time.time(), "time"),
        (counted, "COUNT"),
    ],
    ids=["numpy", "random", "generator", "clock", "counter"],
)
def test_functions_that_answer_differently_each_time_are_refused(reset, name):
    """When the class is made, naming the function, and what it reads."""
    with pytest.raises(hy.DeclarationError, match=f"edge bounce, reset: asked twice.*by {name} "):
        ball(reset=reset)


@pytest.mark.parametrize(
    "reset",
    [
        lambda s: np.random.default_rng(3).normal(),
        lambda s: -jnp.abs(s.v) * np.cos(0.3),
    ],
    ids=["seeded", "plain"],
)
def test_functions_that_answer_the_same_are_taken(reset):
    """A fixed seed is a constant, here as in plain Python."""
    assert run(ball(reset=reset)).status.name == "REACHED_END"


def test_a_random_key_is_refused_when_the_class_is_made():
    """No graph can be made of what JAX does with it; what may be drawn instead is said."""
    said = "edge bounce, reset: a random key .*draw.uniform"
    with pytest.raises(hy.DeclarationError, match=said):
        ball(reset=lambda s: jax.random.uniform(jax.random.key(0), dtype=float))


def run(model):
    return hy.simulate(model(), {"x": 1.0, "v": 0.0}, (0.0, 0.1), solver="taylor")


@pytest.mark.parametrize("flow", [None, lambda s: -pull(s.v), lambda s: -push(s.v)])
def test_a_changed_global_is_named(monkeypatch, flow):
    """Also where it is read by a function that the flow calls, or that is compiled."""
    model = ball(flow)
    run(model)
    monkeypatch.setitem(globals(), "GRAVITY", 1.62)
    with pytest.raises(hy.DeclarationError, match=r"mode flight: GRAVITY was 9.81 .* is 1.62 now"):
        run(model)
    monkeypatch.undo()
    run(model)


def test_changes_within_captured_objects_are_named(monkeypatch):
    """Entries of a mapping, arrays of an object."""
    model = ball(lambda s: -pull(s.v))
    monkeypatch.setitem(SETTINGS, "drag", 0.2)
    with pytest.raises(hy.DeclarationError, match="SETTINGS was"):
        run(model)
    monkeypatch.undo()
    monkeypatch.setattr(CONFIG, "wind", np.array([3.0, 1.0]))
    with pytest.raises(hy.DeclarationError, match="CONFIG"):
        run(model)


def test_a_changed_class_attribute_or_method_is_named():
    """``Model.floor = 1`` after the class was made would change nothing."""
    model = ball()
    model.floor = 1.0
    with pytest.raises(hy.DeclarationError, match=r"floor was 0.0 .* 1.0 now"):
        run(model)
    model.floor = 0.0
    run(model)
    model.height = lambda self, s: s.x - 0.3
    with pytest.raises(hy.DeclarationError, match="height has changed"):
        run(model)


def test_a_changed_variable_of_an_outer_function_is_named():
    """A class made in a function, or a notebook's cell."""
    weight = 2.0
    model = ball(lambda s: -weight)
    weight = 3.0
    with pytest.raises(hy.DeclarationError, match=r"weight was 2.0 .* 3.0 now"):
        run(model)


def test_every_way_in_asks(monkeypatch):
    """Ensembles, functions, certificates and orbits, not runs only."""
    model = ball()
    monkeypatch.setitem(globals(), "GRAVITY", 1.62)
    start = {"x": 1.0, "v": 0.0}
    for way in (
        lambda: hy.ensemble(model(), start, (0.0, 1.0)),
        lambda: hy.as_function(model(), t=(0.0, 1.0), max_jumps=3),
        lambda: hy.return_map(model(), section="bounce"),
        lambda: hy.lyapunov(model(), start, (0.0, 1.0)),
        lambda: hy.periodic_orbit(model(), start),
    ):
        with pytest.raises(hy.DeclarationError, match="GRAVITY"):
            way()


def test_what_is_not_read_does_not_matter(monkeypatch):
    """A global that has the name of a state is no global of the flow."""
    model = ball()
    monkeypatch.setitem(globals(), "x", 5.0)
    monkeypatch.setitem(globals(), "COUNT", [7])
    run(model)


def test_a_helper_that_is_defined_again_as_it_was_is_the_same():
    """A notebook's cell that is run twice."""
    first, second = {}, {}
    text = "def help_out(v):\n    return 2.0 * v\ndef flow(s):\n    return -help_out(s.v)\n"
    exec(text, first)
    model = ball(first["flow"])
    exec("\n\n" + text, second)
    first["help_out"] = second["help_out"]
    run(model)
    exec(text.replace("2.0", "3.0"), first)
    first["flow"] = None
    with pytest.raises(hy.DeclarationError, match="help_out has changed"):
        run(model)


def test_only_what_may_vary_is_traced_twice():
    """Plain models pay nothing: constants, numpy and jax are known to repeat."""
    model = ball(lambda s: -jnp.sqrt(s.v**2 + np.pi))
    assert not may_vary(model, model.spec.modes[0].flow)
    assert {found.name for found in captured(model, model.spec.modes[0].flow)} >= {"flow", "jnp"}


def test_what_a_function_of_jax_reads_is_no_part_of_a_model():
    """One that is imported by its own name is jitted, and JAX keeps state that changes with use."""
    run = lambda **options: hy.simulate(Driven(), {"x": 1.0}, (0.0, 1.0), **options)  # noqa: E731
    first = run().final.x
    assert run(solver="diffrax").final.x == pytest.approx(first, rel=1e-7)  # its own tolerance
    assert run().final.x == first


class Driven(hy.Automaton):
    x = hy.state()
    period = hy.parameter(0.4)

    @hy.mode
    def flow(self, t, s):
        return (mod(t, self.period) - s.x,)
