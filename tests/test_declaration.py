"""A class body becomes one spec; its faults are reported together."""

from abc import ABC

import attrs
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from models.bead_on_table import BeadOnTable

NARROW = jnp.float32(9.81)


def test_parameters_are_checked_with_name_value_and_bound():
    """The message says all three."""
    with pytest.raises(hy.ParameterError, match=r"BeadOnTable.r = 1.5: must lie in \[0, 1\]"):
        BeadOnTable(r=1.5)
    with pytest.raises(hy.ParameterError, match=r"BeadOnTable.g = -1: must be positive"):
        BeadOnTable(g=-1)
    with pytest.raises(hy.ParameterError, match="no parameter 'rr'; there are: g, r"):
        BeadOnTable(rr=0.5)
    with pytest.raises(hy.ParameterError, match="must be finite"):
        BeadOnTable(omega=float("nan"))


def test_evolve_checks_too_and_models_are_frozen():
    """attrs.evolve runs the validators; nothing can be assigned."""
    model = attrs.evolve(BeadOnTable(), r=0.5)
    assert model == BeadOnTable(r=0.5)
    with pytest.raises(hy.ParameterError):
        attrs.evolve(model, r=2.0)
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        model.r = 0.1


def test_a_model_is_a_pytree_rebuilt_without_validators():
    """Leaves are the parameters; values out of bounds (or tracers) pass through."""
    moved = jax.tree.map(lambda value: value + 10.0, BeadOnTable())
    assert moved.r == 10.9
    slope = jax.grad(lambda model: model.table(1.0))(BeadOnTable())
    assert float(slope.amplitude) == pytest.approx(np.sin(0.29), rel=1e-6)


def test_all_faults_are_reported_together():
    """Names the class, the mode or edge, and what would do instead."""
    with pytest.raises(hy.DeclarationError) as caught:

        class Bad(hy.Automaton):
            x = hy.state()
            v = hy.state()

            @hy.mode
            def one(self, t, s):
                return s.v

            @hy.mode
            def two(self, t, s):
                return s.v, s.speed

            @hy.edge(one, to="three", guard=lambda self, t: 1.0)
            def over(self, t, s):
                return s

            impact = hy.contact(two, gap=lambda self, t, s: s.x, restitution="e")

    text = str(caught.value)
    assert len(caught.value.faults) == 6
    assert "Bad has 6 faults" in text
    for part in (
        "edge over: to='three' is no mode of this class; there are: one, two",
        "edge over, guard: takes (self, t) where (self, t, s) is due",
        "contact impact: restitution='e' is no parameter",
        "one mode must be initial=True",
        "mode one: ",
        "mode two: AttributeError: no state named 'speed'; there are: x, v",
    ):
        assert part in text


def test_a_wrong_shape_is_a_fault():
    """A state of shape (2,) needs a derivative of that shape."""
    with pytest.raises(hy.DeclarationError, match=r"q: shape \(\) where \(2,\) is due"):

        class Bad(hy.Automaton):
            q = hy.state(shape=(2,))

            @hy.mode
            def flow(self, t, s):
                return (1.0,)


@pytest.mark.parametrize(
    ("flow", "words"),
    [
        (lambda s: s.v, r"mode fall: one value for 2 states \(x, v\)"),
        (lambda s: None, r"mode fall: None for 2 states \(x, v\)"),
        (lambda s: (s.v, 0.0, 0.0), r"mode fall: 3 values for 2 states \(x, v\)"),
    ],
)
def test_too_few_or_too_many_derivatives_are_counted(flow, words):
    """One for each state; nothing of JAX in what is said."""
    with pytest.raises(hy.DeclarationError, match=words):

        class Bad(hy.Automaton):
            x = hy.state()
            v = hy.state()

            @hy.mode
            def fall(self, t, s):
                return flow(s)


def test_a_captured_constant_of_32_bits_is_named():
    """It was made before it could be widened: its digits are lost."""
    with pytest.raises(hy.DeclarationError, match="the constant 'NARROW' has only 32 bits"):

        class Bad(hy.Automaton):
            x = hy.state()

            @hy.mode
            def fall(self, t, s):
                return -NARROW * s.x


def test_the_users_precision_setting_is_left_alone():
    """64 bits inside, the global flag as it was."""
    assert not jax.config.jax_enable_x64
    hy.simulate(BeadOnTable(), {"x": 1.9, "v": 0.0}, (0, 1))
    assert not jax.config.jax_enable_x64
    assert jnp.ones(1).dtype == jnp.float32


def test_a_subclass_overrides_in_place():
    """A subclass changes a parameter's default and keeps the rest."""

    class Slow(BeadOnTable):
        omega: float = hy.parameter(0.1)

    assert [p.name for p in Slow.spec.parameters] == ["g", "r", "amplitude", "omega"]
    assert Slow().omega == 0.1
    assert Slow.spec.names == ("x", "v")


def test_a_name_declared_twice_is_a_fault():
    """Of two modes, or a state and a method, of one name the first would be gone without a word."""
    with pytest.raises(hy.DeclarationError) as caught:

        class Twice(hy.Automaton):
            x = hy.state()
            g: float = hy.parameter(1.0)

            @hy.mode(initial=True)
            def flow(self, t, s):
                return 1.0

            @hy.mode
            def flow(self, t, s):  # noqa: F811
                return 2.0

            @hy.edge("flow", every=1.0)
            def tick(self, t, s):
                return s

            tick = hy.edge("flow", guard=lambda self, t, s: s.x)  # noqa: F811

            def g(self, t):  # noqa: F811
                return t

            y = z = hy.state()

    said = str(caught.value)
    for words in (
        "flow: declared twice, as a mode and then as a mode",
        "tick: declared twice, as an edge and then as an edge",
        "g: declared twice, as a parameter and then as something else",
        "z: the same declaration as y",
    ):
        assert words in " ".join(said.split())


@pytest.mark.parametrize(
    ("guard", "of"),
    [
        (lambda self, t, s: -1.0, "nothing"),
        (lambda self, t, s: self.a - 2.0, "parameters and discrete variables alone"),
        (lambda self, t, s: 3 - s.count, "parameters and discrete variables alone"),
    ],
)
def test_a_guard_that_no_flow_changes_is_a_fault(guard, of):
    """It would never fire; an urgent edge does, where its mode is entered beyond zero."""

    def declared(urgent):
        class Still(hy.Automaton):
            x = hy.state()
            count = hy.discrete(5)
            a: float = hy.parameter(1.0)

            @hy.mode(initial=True)
            def flow(self, t, s):
                return 1.0

            @hy.edge(flow, to=hy.TERMINATE, guard=guard, urgent=urgent)
            def stop(self, t, s):
                return s

        return Still

    with pytest.raises(hy.DeclarationError, match=f"stop, guard: it depends on {of}"):
        declared(False)
    assert hy.simulate(declared(True)(), {"x": 0.0}, (0.0, 1.0), solver="taylor").t1 == 0.0


def test_a_subclass_may_mix_in_an_abstract_class_and_declare_a_name_again():
    class Base(hy.Automaton, ABC):
        x = hy.state()

        @hy.mode(initial=True)
        def flow(self, t, s):
            return self.rate(t)

        def rate(self, t):
            return 1.0

    class Fast(Base):
        @hy.mode(initial=True)
        def flow(self, t, s):
            return 2.0

    assert hy.simulate(Fast(), {"x": 0.0}, (0.0, 1.0), solver="taylor").final.x == 2.0


def test_a_contact_without_velocities_is_refused():
    """A first-order flow has no impacts; the message says what to write instead."""

    class First(hy.Automaton):
        x = hy.state()

        @hy.mode
        def drift(self, t, s):
            return -1.0

        wall = hy.contact(drift, gap=lambda self, t, s: s.x, restitution=0.5)

    with pytest.raises(hy.DeclarationError, match="for a first-order flow write an edge"):
        hy.simulate(First(), {"x": 1.0}, (0, 2))


def test_a_record_unpacks_and_replaces():
    """``s.x``, ``x, v = s``, ``s.replace(v=...)``."""
    record = BeadOnTable.spec.record(np.array([1.0, 2.0]))
    x, v = record
    assert (x, v, record.x, record["v"], len(record)) == (1.0, 2.0, 1.0, 2.0, 2)
    assert record.replace(v=5.0).v == 5.0
    with pytest.raises(AttributeError, match="no state named 'z'; there are: x, v"):
        _ = record.z
    with pytest.raises(AttributeError, match="does not change"):
        record.x = 1.0


def test_code_that_cannot_be_traced_gets_its_remedy():
    """if, numpy and math on a state: each with what to write instead."""
    import math

    with pytest.raises(hy.DeclarationError) as caught:

        class Bad(hy.Automaton):
            x = hy.state()

            @hy.mode(initial=True)
            def one(self, t, s):
                return 1.0 if s.x > 0 else -1.0

            @hy.mode
            def two(self, t, s):
                return np.sin(s.x)

            @hy.mode
            def three(self, t, s):
                return math.sin(s.x)

    for part in ("write jnp.where", "use the one of jax.numpy"):
        assert part in str(caught.value)
    assert len(caught.value.faults) == 3


def test_a_default_outside_its_bounds_is_a_fault():
    """Found when the class is defined, not when a model is made."""
    with pytest.raises(hy.DeclarationError, match=r"default of Bad.r = 2.0: must lie in \[0, 1\]"):

        class Bad(hy.Automaton):
            x = hy.state()
            r = hy.parameter(2.0, between=(0, 1))

            @hy.mode
            def flow(self, t, s):
                return 0.0


def test_an_edge_without_a_reset_leaves_the_state():
    """``name = hy.edge(...)``: a transition and nothing else, at x = 1 after one second."""

    class Passing(hy.Automaton):
        x = hy.state()

        @hy.mode(initial=True)
        def near(self, t, s):
            return (1.0,)

        @hy.mode
        def far(self, t, s):
            return (2.0,)

        leaves = hy.edge(near, to=far, guard=lambda self, t, s: 1.0 - s.x)

    run = hy.simulate(Passing(), {"x": 0.0}, (0.0, 2.0))
    assert run.jumps.edge.tolist() == ["leaves"]
    assert (run.mode, run.final.x) == ("far", pytest.approx(3.0, rel=1e-13))


def test_a_fault_that_shows_in_a_run_shows_in_every_run():
    """A gap over a state whose derivative is no velocity, which the contact's law finds."""

    class Tilting(hy.Automaton):
        x = hy.state()
        v = hy.state()
        q = hy.state()

        @hy.mode
        def f(self, t, s):
            return s.v, -9.8, s.v**2

        hit = hy.contact(f, gap=lambda self, t, s: s.x - 0.05 * s.q, restitution=0.5)

    for solver in ("taylor", "taylor", "scipy", "scipy"):
        with pytest.raises(hy.DeclarationError, match="is not a velocity"):
            hy.simulate(Tilting(), {"x": 1.0, "v": 0.0, "q": 0.0}, (0.0, 1.0), solver=solver)


def test_a_velocity_is_one_for_all_parameters_and_states():
    """A momentum over a mass that is 1 if nothing else is said; a factor beyond some state. The
    impact gave the momentum the speed, and with another mass a wrong sign."""

    class Momentum(hy.Automaton):
        x = hy.state()
        p = hy.state()
        m: float = hy.parameter(1.0, positive=True)

        @hy.mode
        def f(self, t, s):
            return s.p / self.m, -9.8 * self.m

        hit = hy.contact(f, gap=lambda self, t, s: s.x, restitution=0.5)

    class Slowed(hy.Automaton):
        x = hy.state()
        v = hy.state()
        at: float = hy.parameter(2.0)

        @hy.mode
        def f(self, t, s):
            return jnp.where(s.x > self.at, 0.5, 1.0) * s.v, -9.8

        hit = hy.contact(f, gap=lambda self, t, s: s.x, restitution=0.5)

    class Geared(Slowed):
        @hy.mode
        def f(self, t, s):
            return jnp.where(self.at > 5.0, 0.5, 1.0) * s.v, -9.8

    models = (
        (Momentum(m=2.0), "p"),
        (Momentum(), "p"),
        (Slowed(), "v"),
        (Slowed(at=7e3), "v"),
        (Geared(), "v"),
    )
    for model, name in models:
        with pytest.raises(hy.DeclarationError, match="is not a velocity"):
            hy.simulate(model, {"x": 1.0, name: 0.0}, (0.0, 1.0))
