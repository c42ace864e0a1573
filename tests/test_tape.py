"""The model as a tape, read into Taylor jets: right, on machine code and in plain Python."""

import importlib
import math
import pkgutil
from functools import partial

import jax.numpy as jnp
import jax.scipy.special
import numpy as np
import pytest

import hybrid as hy
import models
from hybrid.automaton import trace
from hybrid.errors import OptionError, TraceError
from hybrid.lowering import recorder
from hybrid.lowering import tape as reader
from hybrid.lowering.arithmetic import OPERATIONS
from hybrid.lowering.graph import Graph
from hybrid.lowering.jaxpr import read
from hybrid.lowering.lowered import ORDER
from hybrid.lowering.scene import rest_name, scene_of
from hybrid.lowering.taylor import flat, polynomial
from hybrid.rules.load import Library

from . import recurrences, systems
from .test_readers import EXPRESSIONS, automaton


def _declared(module):
    return [
        v for v in vars(module).values() if isinstance(v, type) and v.__module__ == module.__name__
    ]


MODULES = [
    importlib.import_module(f"models.{m.name}") for m in pkgutil.iter_modules(models.__path__)
]
CLASSES = [
    cls
    for module in (*MODULES, systems)
    for cls in _declared(module)
    if issubclass(cls, hy.Automaton)
]

#: The written-out recurrences by value, on plain numbers: they share no line with the rule.
PLAIN = {
    **OPERATIONS,
    "select": lambda c, a, b: a if c else b,
    "barrier": lambda names: names,
}


@pytest.fixture(params=["machine", "checked"])
def rules(request, monkeypatch):
    """The rules as machine code, and as plain Python that refuses indices below zero."""
    monkeypatch.setenv("HYBRID_RULES", request.param)
    monkeypatch.setattr(reader, "unit", Library("hybrid.rules").unit)


def _modes(scene):
    """Modes, rests of one contact, and of two at once."""
    names = list(scene.modes)
    for mode in scene.spec.modes:
        held = [e.name for e in scene.spec.leaving(mode.name) if getattr(e, "rests", False)]
        names += [rest_name(mode.name, tuple(held[:2]))] * (len(held) > 1)
    return names


def _recorded(scene, name, where="here"):
    """The tape of a field of a scene, and the graph that it was made from."""
    field, graph = scene.field(name), Graph(long=True)
    inputs = scene.code.inputs(graph)
    (states,) = read(graph, field.closed, inputs)
    guards = [int(read(graph, g.closed, inputs)[0].reshape(())) for g in field.guards]
    return recorder.tape(graph, scene.spec.dimension, states, guards, where)


def _stacked(functions, p, t, x):
    return jnp.stack([jnp.zeros(()), *(function(p, t, x) for function in functions)])


def _close(a, b):
    """To the rounding of a few hundred operations, against the largest of a row."""
    a, b = np.array(a), np.array(b)
    assert a.shape == b.shape
    for one, other in zip(a, b, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-14 * np.abs(one).max())


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_the_jets_of_every_mode_are_those_of_the_recurrences_written_out(cls, rules):
    """Contacts held and sliding included, at random states; windows of the past show noise."""
    scene, draw = scene_of(cls()), np.random.default_rng(0)
    for name in _modes(scene):
        field = scene.field(name)
        watched = [trace.again(guard.closed) for guard in field.guards]
        guards = scene.code.trace(partial(_stacked, watched))
        written = recurrences.written(scene.code, field.closed, guards, ORDER, PLAIN)
        shown = [p if np.isfinite(p).all() else draw.normal(size=p.shape) for p in scene.parameters]
        read, written = _recorded(scene, name).bind(flat(shown)), written.bind(flat(shown))
        for _ in range(3):
            t, x = float(draw.uniform(-1, 2)), draw.normal(size=scene.spec.dimension).tolist()
            sides = [0] * len(read.watched)
            try:
                expected = written(t, x)
            except (ZeroDivisionError, ValueError):
                # two walls that face each other hold one position; a root of a pressure below 0
                with pytest.raises(ValueError, match="no Taylor series here"):
                    read(t, x, sides, ORDER)
                continue
            states, values, watched = read(t, x, sides, ORDER)
            kinks = zip(read.watched, watched, strict=True)
            _close(expected[0], states)
            _close(expected[1][1:], values)
            _close(expected[2], [c for what, c in kinks if what.kind == "kink"])


def _at(jets, t, x):
    return jets(t, x, [0] * len(jets.watched), ORDER)


def _jets(expression):
    cls = automaton(expression)
    scene = scene_of(cls())
    return scene.field("flow").rhs, _recorded(scene, "flow").bind([0.7])


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_series_solve_the_equation(name, rules):
    """x'(s) from the series equals the flow at x(s), for a short s, on the start's branch."""
    rhs, jets = _jets(EXPRESSIONS[name])
    draw = np.random.default_rng(1)
    for _ in range(10):
        t, x = float(draw.uniform(-1, 1)), draw.uniform(-1, 1, 2).tolist()
        series, _, kinks = jets(t, x, [0] * len(jets.watched), ORDER)
        s = 1e-3
        if any(c[0] * polynomial(c, s) <= 0 for c in kinks):
            continue
        state = [polynomial(c, s) for c in series]
        slope = [sum(k * c[k] * s ** (k - 1) for k in range(1, ORDER + 1)) for c in series]
        np.testing.assert_allclose(slope, rhs(t + s, state), rtol=1e-11, atol=1e-12)


#: Functions that jump, of a number that grows: the value just below and just above 1.5, or 2.
JUMPS = {
    "floor": (jnp.floor, 2.0, 1.0, 2.0),
    "ceil": (jnp.ceil, 2.0, 2.0, 3.0),
    "round": (jnp.round, 1.5, 1.0, 2.0),
    "trunc": (jnp.trunc, 2.0, 1.0, 2.0),
    "mod": (lambda x: jnp.mod(x, 2.0), 2.0, 2.0, 0.0),
    "remainder": (lambda x: jnp.fmod(x, 2.0), 2.0, 2.0, 0.0),
    "divided": (lambda x: x // 0.75, 1.5, 1.0, 2.0),
    "sign": (lambda x: jnp.sign(x - 1.5), 1.5, -1.0, 1.0),
    "step": (lambda x: jnp.where(x >= 2.0, 5.0, 4.0), 2.0, 4.0, 5.0),
}


@pytest.mark.parametrize("name", JUMPS)
@pytest.mark.parametrize("up", [True, False])
def test_a_jump_is_a_kink_and_its_sides_are_told_apart(name, up, rules):
    """Before it the kink's zero is the jump's time; on it the branch is that of where x goes."""
    function, place, below, above = JUMPS[name]

    class Jumps(hy.Automaton):
        x = hy.state()
        y = hy.state()
        speed = hy.parameter(1.0)

        @hy.mode
        def flow(self, t, s):
            return self.speed, function(s.x)

    read = _recorded(scene_of(Jumps()), "flow").bind([1.0 if up else -1.0])
    way = 1 if up else -1
    before, after = (below, above) if up else (above, below)
    states, _, kinks = read(0.0, [place - 0.25 * way, 0.0], [0] * len(read.watched), ORDER)
    expected = before if name not in ("mod", "remainder") else before + (-0.25 if up else 0.25)
    assert states[1][1] == pytest.approx(expected, abs=1e-15)
    zeros = [abs(polynomial(c, 0.25)) < 1e-15 and polynomial(c, 0.2) != 0.0 for c in kinks]
    assert any(zeros)
    sides = [0] * len(read.watched)
    states, _, kinks = read(0.0, [place, 0.0], sides, ORDER)
    assert states[1][1] == pytest.approx(after, abs=1e-15)
    assert all(side for side, c in zip(sides, kinks, strict=True) if c[0] == 0.0)


def test_the_side_on_which_a_step_ended_decides_and_not_the_rounding_of_its_end(rules):
    """A step that ends on a jump lands beside it: its kink's sign is that with which it crossed."""
    _, jets = _jets(lambda t, x, y: jnp.floor(3.0 * t) + 0.0 * x)
    read, kinks = jets(0.1, [0.0, 0.0], [0], ORDER)[::2]
    assert read[0][1] == 0.0
    root = 1 / 3 - 0.1
    side = 1 if polynomial(kinks[0], root + 1e-3) > 0 else -1
    for t in (1 / 3 - 1e-16, 1 / 3, 1 / 3 + 1e-16):
        assert jets(t, [0.0, 0.0], [side], ORDER)[0][0][1] == 0.7


def test_a_point_at_which_a_formula_holds_alone_is_not_a_branch(rules):
    """Where x passes 0 it is not 0 along the flow; where it stays 0 it is."""
    _, passing = _jets(lambda t, x, y: jnp.where(y == 0.0, 5.0, 1.0))
    assert passing(0.0, [1.0, 0.0], [], ORDER)[0][0][1] == 0.7

    class Still(hy.Automaton):
        x = hy.state()
        n = hy.state()

        @hy.mode
        def flow(self, t, s):
            return jnp.where(s.n == 0.0, 5.0, 1.0), 0.0

    read = _recorded(scene_of(Still()), "flow").bind([])
    assert read(0.0, [1.0, 0.0], [], ORDER)[0][0][1] == 5.0
    assert read(0.0, [1.0, 2.0], [], ORDER)[0][0][1] == 1.0


class Raised(hy.Automaton):
    """``y' = x^p`` along ``x = t``."""

    x = hy.state()
    y = hy.state()
    p = hy.parameter(2.0)

    @hy.mode
    def flow(self, t, s):
        return 1.0, s.x**self.p


def test_a_change_of_a_parameter_needs_no_new_tape_and_powers_vanish(rules):
    """x^p at x = 0 is t^p where p is a whole number, and has no series where it is not."""
    recorded = _recorded(scene_of(Raised()), "flow")
    for p in (1.0, 2.0, 3.0, 7.0):
        series = _at(recorded.bind([p]), 0.0, [0.0, 0.0])[0][1]
        exact = [1 / (p + 1) if k == p + 1 else 0.0 for k in range(ORDER + 1)]
        np.testing.assert_allclose(series, exact, rtol=1e-15)
    with pytest.raises(ValueError, match="no Taylor series here"):
        _at(recorded.bind([1.5]), 0.0, [0.0, 0.0])
    x = _at(recorded.bind([1.5]), 0.0, [4.0, 0.0])[0][1]
    assert x[:3] == [0.0, 8.0, 1.5]


def test_a_branch_that_is_not_taken_may_be_undefined(rules):
    """log of a negative number, behind a where."""
    _, jets = _jets(lambda t, x, y: jnp.where(x > 0, jnp.log(x), y))
    assert _at(jets, 0.0, [-1.0, 2.0])[0][0][1] == 1.4
    with pytest.raises(ValueError, match="no Taylor series here"):
        _at(_jets(lambda t, x, y: jnp.log(x))[1], 0.0, [-1.0, 2.0])


def test_the_branch_cut_of_an_angle_is_a_kink(rules):
    """A turn through the left half-plane: the angle jumps from pi to -pi where y is 0."""
    _, jets = _jets(lambda t, x, y: jnp.arctan2(y, x) + 0.0 * t)
    for y in (1e-3, -1e-3):
        series, _, kinks = _at(jets, 0.0, [-1.0, y])
        assert series[0][1] == pytest.approx(0.7 * math.atan2(y, -1.0), rel=1e-15)
        assert kinks[0][0] == y
    assert _at(jets, 0.0, [-1.0, 0.0])[0][0][1] == -0.7 * math.pi  # y falls


def test_what_has_no_recurrence_is_refused_with_what_to_write_instead():
    """By the author's model and mode."""
    model = automaton(lambda t, x, y: jax.scipy.special.gammaln(x + 3))()
    with pytest.raises(TraceError, match=r"Here: the .*'lgamma'\) .* Stirling's series"):
        _recorded(scene_of(model), "flow", "Here")
    start = {"x": 1.0, "y": 1.0}
    with pytest.raises(OptionError, match=r"Model, mode flow: the .* Stirling's series"):
        hy.simulate(model, start, (0.0, 1.0), solver="taylor")
    assert hy.simulate(model, start, (0.0, 1.0)).final


def _chain(couple, n=200):
    class Chain(hy.Automaton):
        q = hy.state(shape=(n,))
        k = hy.parameter(2.0)

        @hy.mode
        def flow(self, t, s):
            return (couple(self.k, s.q),)

    return Chain


def _by_slices(k, q):
    inner = jnp.pad(q, 1)
    return k * (inner[2:] - 2.0 * q + inner[:-2]) - q**3


def _by_rolling(k, q):
    return k * (jnp.roll(q, 1) - 2.0 * q + jnp.roll(q, -1))


BANDED = np.diag(-2.0 * np.ones(200)) + np.diag(np.ones(199), 1) + np.diag(np.ones(199), -1)


@pytest.mark.parametrize("couple", [_by_slices, _by_rolling, lambda k, q: k * (BANDED @ q)])
def test_a_chain_is_linear_in_its_length(couple):
    """At most ten operations of three arguments a state, also by a banded matrix."""
    scene = scene_of(_chain(couple)())
    recorded = _recorded(scene, "flow")
    assert len(recorded.ops) + len(recorded.more) / 3 < 10 * 200


def test_a_product_with_a_matrix_is_one_operation_a_row(rules):
    """The matrix is constant, or a parameter: the series are those of its exponential."""
    n = 30
    draw = np.random.default_rng(2)
    matrix, q = draw.normal(size=(n, n)) / n, draw.normal(size=n)

    class Linear(hy.Automaton):
        q = hy.state(shape=(n,))
        a = hy.parameter(matrix)

        @hy.mode
        def flow(self, t, s):
            return (self.a @ s.q + matrix @ s.q,)

    recorded = _recorded(scene_of(Linear()), "flow")
    assert len(recorded.ops) == 3 * n
    series = np.array(recorded.bind(flat([matrix]))(0.0, q.tolist(), [], ORDER)[0]).T
    for k in range(ORDER):
        np.testing.assert_allclose(series[k + 1], 2 * matrix @ series[k] / (k + 1), atol=1e-14)


def test_what_does_not_move_is_computed_once():
    """Functions of parameters are no operations of a jet."""

    class Steady(hy.Automaton):
        x = hy.state()
        p = hy.parameter(2.0)

        @hy.mode
        def flow(self, t, s):
            return s.x * jnp.round(jnp.exp(self.p)) * jnp.sign(self.p) + jnp.abs(jnp.sin(self.p))

    recorded = _recorded(scene_of(Steady()), "flow")
    assert len(recorded.ops) <= 3
    series = _at(recorded.bind([2.5]), 0.0, [1.0])[0][0]
    assert series[1] == round(math.exp(2.5)) + math.sin(2.5)
    assert _at(recorded.bind([0.0]), 0.0, [1.0])[0][0][1] == 0.0


def test_programs_may_be_added_to_those_that_are_joined():
    """One after the other, or all at once; what was given out before stays as it is."""
    parts = [_jets(EXPRESSIONS[name])[1] for name in ("angles", "matrices", "special", "piecewise")]
    together = reader.Linked()
    assert [together.add(part) for part in parts[:2]] == [0, 1]
    before = together.programs()
    kept = [array.copy() for array in before]
    assert [together.add(part) for part in parts[2:]] == [2, 3]
    for grown, whole in zip(together.programs(), reader.linked(parts), strict=True):
        assert grown.dtype == whole.dtype
        np.testing.assert_array_equal(grown, whole)
    for array, copy in zip(before, kept, strict=True):
        np.testing.assert_array_equal(array, copy)
