"""One graph of a mode: derivatives on it are JAX's, and any contacts of it may be held."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.automaton import trace
from hybrid.lowering.contact import lie
from hybrid.lowering.jit import jit
from hybrid.lowering.lowered import ORDER
from hybrid.lowering.scene import rest_name, scene_of
from models.ball_on_circle import BallOnCircle
from models.coupled import Coupled
from models.relay import Relay

from . import recurrences
from .contract.ways import later, spread
from .systems import Drag, Pile, Rubbed
from .test_readers import EXPRESSIONS, automaton
from .test_tape import PLAIN


class Watched(hy.Automaton):
    """A guard that is made of many operations, along a flow that is."""

    x = hy.state()
    y = hy.state()
    p = hy.parameter(0.7)

    @hy.mode
    def flow(self, t, s):
        return self.p * jnp.sin(s.y) + jnp.tanh(t), jnp.sqrt(4 + s.x) - s.x**self.p * s.y

    @hy.edge(
        flow,
        to="flow",
        guard=lambda self, t, s: (
            jnp.maximum(jnp.abs(s.x), s.y)
            + jnp.arctan2(s.x, s.y + 4)
            + jnp.where(s.x > 0, jnp.cbrt(s.x + 3), jnp.cos(s.x) / (2 + t))
        ),
    )
    def over(self, t, s):
        return s


class Wedged(hy.Automaton):
    """A particle outside a ball and above a sheet that moves: their normals feel each other."""

    q = hy.state(shape=(3,))
    v = hy.state(shape=(3,))
    m = hy.parameter(1.3)

    @hy.mode
    def fly(self, t, s):
        return s.v, jnp.array([0.1 * jnp.sin(t), -0.2 * s.v[0], -9.81]) - 0.1 * s.q

    ball = hy.contact(
        fly,
        gap=lambda self, t, s: jnp.sum((s.q - 0.4) ** 2) - 1.0,
        restitution=0.5,
        inverse_mass=lambda self, t, s: self.m,
    )
    sheet = hy.contact(
        fly,
        gap=lambda self, t, s: s.q[2] - 0.3 * jnp.sin(t) + 0.2 * s.q[0] * s.q[1],
        restitution=0.5,
        inverse_mass=lambda self, t, s: self.m * jnp.ones(3),
    )


def sizes(g, f):
    """Sums of absolute terms, by JAX."""

    def terms(h, rates, *at):
        by_t, by_x = jax.grad(h, argnums=(1, 2))(*at)
        return jnp.abs(by_t) * rates[0] + jnp.abs(by_x) @ rates[1]

    def made(p, t, x):
        moving, here, first = (1.0, jnp.abs(f(p, t, x))), (jnp.abs(t), jnp.abs(x)), lie(g, f)
        offset = jnp.abs(g(p, t, jnp.zeros_like(x)))
        own = terms(g, here, p, t, x) + jnp.where(jnp.isfinite(offset), offset, 0.0)
        rows = [lambda *at, i=i: f(*at)[i] for i in range(len(x))]
        flows = (0.0, jnp.stack([terms(row, here, p, t, x) for row in rows]))
        bend = terms(first, moving, p, t, x) + terms(first, flows, p, t, x)
        return jnp.stack([own, terms(g, moving, p, t, x), bend])

    return made


def derived(g, f):
    """A guard with two derivatives along a flow, and its sums of absolute terms, by JAX."""
    first = lie(g, f)
    second = lie(first, f)
    return jit(lambda *at: ((g(*at), first(*at), second(*at)), sizes(g, f)(*at)))


FIELDS = [
    (Watched, "flow"),
    (Drag, "flight"),
    (Rubbed, "fall.rest(impact)"),
    (BallOnCircle, None),
    (Coupled, None),
    (Relay, None),
    (Wedged, "fly.rest(ball, sheet)"),
    *later((Pile, "falls.rest(floor, between)")),
]


@pytest.mark.parametrize(("cls", "name"), FIELDS, ids=lambda v: getattr(v, "__name__", v))
def test_flows_guards_and_their_derivatives_are_those_of_jax(cls, name):
    """At random states, to the rounding of a few hundred operations; loads, rests and sliding."""
    scene, draw = scene_of(cls()), np.random.default_rng(0)
    field = scene.field(name or scene.modes[-1])
    flow = trace.again(field.closed)
    close = {"rtol": 1e-11, "atol": 1e-12}
    expected = [derived(trace.again(guard.closed), flow) for guard in field.guards]
    for _ in range(2):
        t, x = float(draw.uniform(0, 2)), draw.uniform(0.1, 1.5, scene.spec.dimension)
        with trace.wide():
            at = scene.parameters, np.float64(t), x
            np.testing.assert_allclose(field.rhs(t, x.tolist()), flow(*at), **close)
            for guard, known in zip(field.guards, expected, strict=True):
                rates, terms = known(*at)
                np.testing.assert_allclose(guard.lie(t, x.tolist()), rates, **close)
                np.testing.assert_allclose(guard.value(t, x.tolist()), rates[0], **close)
                found = scene.rounding(guard, field)(t, x.tolist())
                np.testing.assert_allclose(found, terms, **close)
            if field.held:
                onto = scene.code.held(field.held).project(*at)
                np.testing.assert_allclose(field.project(t, x.tolist()), onto, **close)


@pytest.mark.parametrize("held", [("ball",), ("sheet",), ("ball", "sheet")], ids=str)
def test_series_along_contacts_are_those_of_their_equations_written_out(held):
    """Of states and loads, where the equations move; whichever of the contacts are held."""
    scene, draw = scene_of(Wedged()), np.random.default_rng(5)
    field = scene.field(rest_name("fly", held))
    loads = [trace.again(guard.closed) for guard in field.guards]
    stacked = scene.code.trace(lambda *at: jnp.stack([load(*at) for load in (*loads, *loads)]))
    written = recurrences.written(scene.code, field.closed, stacked, ORDER, PLAIN).bind([1.3])
    for _ in range(3):
        t, x = float(draw.uniform(0, 2)), draw.uniform(0.3, 1.0, 6).tolist()
        states, guards, _ = field.expand(t, x, [0] * field.kinks)
        expected = written(t, x)
        for ours, theirs in zip([*states, *guards], [*expected[0], *expected[1]], strict=False):
            size = np.abs(theirs).max()
            np.testing.assert_allclose(ours, theirs, rtol=1e-10, atol=1e-13 * size)


@pytest.mark.parametrize("name", ["roots", "inverse hyperbolic", "clipping", "piecewise", "angles"])
def test_derivatives_of_operations_are_those_of_jax(name):
    """The second derivative along the flow, of a guard that is the flow itself; ties too."""
    expression = EXPRESSIONS[name]

    class Guarded(automaton(expression)):
        @hy.edge("flow", to="flow", guard=lambda self, t, s: expression(t, s.x, s.y))
        def edge(self, t, s):
            return s

    scene, draw = scene_of(Guarded()), np.random.default_rng(3)
    field = scene.field("flow")
    flow, g = trace.again(field.closed), trace.again(field.guards[0].closed)
    ties = [np.array([0.0, 0.0]), np.array([0.2, 0.2]), np.array([0.5, 0.0])]
    for x in [*draw.uniform(-1, 1, (5, 2)), *ties]:
        t = float(draw.uniform(-1, 1))
        with trace.wide():
            at = scene.parameters, np.float64(t), x
            first = lie(g, flow)
            expected = [g(*at), first(*at), lie(first, flow)(*at)]
        np.testing.assert_allclose(field.guards[0].lie(t, x.tolist()), expected, rtol=1e-11)


def column(n, e):
    """Beads above each other, the lowest above a floor."""

    class Column(hy.Automaton):
        q = hy.state(shape=(n,))
        v = hy.state(shape=(n,))

        @hy.mode
        def falls(self, t, s):
            return s.v, -9.81 + 0.0 * s.q

        floor = hy.contact(falls, gap=lambda self, t, s: s.q[0], restitution=e)
        for i in range(1, n):
            vars()[f"c{i}"] = hy.contact(
                falls, gap=lambda self, t, s, i=i: s.q[i] - s.q[i - 1], restitution=e
            )
        del i

    return Column


@pytest.mark.parametrize(
    ("n", "options"), spread([3, 10], [{"solver": "scipy"}, {"solver": "taylor"}], of=2), ids=str
)
def test_touching_beads_that_lose_nothing_strike_each_once_and_fly_up_together(n, options):
    """n (n + 1) / 2 impacts at one instant turn all speeds about: energy is kept."""
    run = hy.simulate(column(n, 1.0)(), {"q": [0.05] * n, "v": [0.0] * n}, (0.0, 0.15), **options)
    assert len(run.jumps) == n * (n + 1) // 2
    fall = (2 * 0.05 / 9.81) ** 0.5
    assert all(jump.t == pytest.approx(fall, rel=1e-14) for jump in run.jumps)
    s = 0.15 - fall
    speed = 9.81 * fall - 9.81 * s
    np.testing.assert_allclose(run.final.v, speed, rtol=1e-9)
    np.testing.assert_allclose(run.final.q, 9.81 * fall * s - 9.81 * s * s / 2, rtol=1e-9)


def test_touching_beads_that_lose_half_come_to_rest():
    """Five of them: on the floor and on each other, before the second fall would have ended."""
    start = {"q": [0.05] * 5, "v": [0.0] * 5}
    run = hy.simulate(column(5, 0.5)(), start, (0.0, 0.15), solver="taylor")
    np.testing.assert_allclose(run.final.q, 0.0, atol=1e-12)
    np.testing.assert_allclose(run.final.v, 0.0, atol=1e-12)
    assert run.arcs[-1].mode == rest_name("falls", ("floor", "c1", "c2", "c3", "c4"))


def test_the_graph_of_a_mode_grows_as_a_power_of_its_contacts():
    """Three times the beads: less than nine times the nodes of flow, loads and their rates."""

    def nodes(n):
        graph = scene_of(column(n, 0.5)()).code.mode("falls")
        for name in graph.watched(True):
            graph.lie(name, True)
        return len(graph.graph.nodes)

    assert nodes(12) < 9 * nodes(4)


def test_any_contacts_of_a_mode_are_held_by_the_same_tape_and_code():
    """The beads held stay on each other, the others fall; nothing is made for a subset."""
    n = 6
    scene = scene_of(column(n, 0.5)())
    code = scene.code
    scene.field("falls.rest(floor)").expand(0.0, [0.0] * 2 * n, [])
    made = dict(code._programs)
    names = [edge.name for edge in scene.spec.leaving("falls")]
    for held in (names[:1], names[1:3], names[::2], names):
        field = scene.field(rest_name("falls", tuple(held)))
        x = [0.1 * i for i in range(n)] + [0.0] * n
        series, guards, _ = field.expand(0.0, x, [])
        speeds = [row[1] for row in series[n:]]
        assert list(field.rhs(0.0, x)[n:]) == pytest.approx(speeds, abs=1e-13)
        for i, name in enumerate(names):
            below = speeds[i - 1] if i else 0.0
            if name in held:
                assert speeds[i] == pytest.approx(below, abs=1e-13)
        loads = guards[n - len(held) :]
        assert all(load[0] >= -1e-12 for load in loads)
    kinds = {key[0] for key in code._programs if key not in made}
    assert not kinds & {"tape", "rest closed", "load closed", "lie closed", "field"}
