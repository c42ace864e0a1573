"""Runs inside the user's own JAX program: the same results, bounded, and differentiable."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.functions.function import REASONS
from models.ball_on_circle import BallOnCircle
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall
from models.hard_spring import HardSpring
from models.two_tanks import TwoTanks
from tests import gradients
from tests.contract.ways import spread
from tests.gradients import Rubbed
from tests.systems import ForcedOscillator as Forced
from tests.systems import Oscillator


@pytest.fixture(autouse=True)
def _wide():
    """The user's own setting, for these tests only."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def fall():
    """A dropped ball as a function of its model and start."""
    with jax.enable_x64(True):
        return hy.as_function(BouncingBall(), t=(0.0, 3.0), max_jumps=8, max_steps=256)


def test_the_outcome_is_the_runs(fall):
    """Final state, jumps, the accumulation, as hy.simulate has them."""
    out = jax.jit(fall)(BouncingBall(), {"x": 1.0, "v": 0.0})
    run = hy.simulate(BouncingBall(), {"x": 1.0, "v": 0.0}, (0, 3), solver="taylor")
    count = int(out.jumps.count)
    assert float(out.zeno.t) == pytest.approx(run.zeno[0].t, rel=1e-12)
    np.testing.assert_allclose(out.jumps.t[:count], run.jumps.t[:count], rtol=1e-12)
    np.testing.assert_allclose(out.jumps.after["v"][:count], run.jumps.after.v[:count], rtol=1e-11)
    assert [fall.edges[i] for i in out.jumps.edge[:count]] == ["impact"] * count
    assert np.all(np.isnan(out.jumps.t[count:]))
    assert np.all(out.jumps.edge[count:] == -1)
    assert (float(out.final["x"]), float(out.t), int(out.status)) == (0.0, 3.0, 1)
    assert not out.overflow


def test_too_small_bounds_are_told():
    """A cut is never silent: jumps, then steps."""
    start = {"x": 1.0, "v": 0.0}
    few = hy.as_function(BouncingBall(), t=(0, 3), max_jumps=3, max_steps=256, zeno="ignore")
    out = few(BouncingBall(), start)
    assert bool(out.overflow)
    assert int(out.jumps.count) == 3
    few = hy.as_function(Forced(), t=(0.0, 1e6), max_jumps=4096, max_steps=1000)
    out = few(Forced(), {"x": -0.5, "v": 0.0})
    assert bool(out.overflow)
    assert REASONS[int(out.status)][0] == "max_steps"
    assert float(out.t) < 1e6


def test_only_what_is_asked_for_is_returned():
    only = hy.as_function(BouncingBall(), t=(0, 3), max_jumps=8, max_steps=64, outputs=("zeno",))
    out = only(BouncingBall(), {"x": 1.0, "v": 0.0})
    assert out.final is None
    assert out.jumps is None
    with pytest.raises(hy.OptionError, match="some of final, jumps, zeno"):
        hy.as_function(BouncingBall(), t=(0, 3), max_jumps=8, outputs=("all",))


def test_32_bits_are_refused(fall):
    """In the user's own program the setting is the user's; the error says what to write."""
    with jax.enable_x64(False), pytest.raises(hy.OptionError, match="jax_enable_x64"):
        fall(BouncingBall(), {"x": 1.0, "v": 0.0})


def test_another_model_is_refused(fall):
    with pytest.raises(hy.OptionError, match="made for BouncingBall, not for HardSpring"):
        fall(HardSpring(), {"x": 2.1, "v": 0.0})


def test_under_vmap_each_has_its_own_fate():
    """Lanes that chatter and lanes that leave the circle, against the closed run of each."""
    slide = hy.as_function(BallOnCircle(), t=(0, 4), max_jumps=16, max_steps=512)
    q = jnp.stack([jnp.array([0.1, 0.15, 0.3, 0.4]), jnp.full(4, 1.2)], axis=1)
    out = jax.jit(jax.vmap(lambda q: slide(BallOnCircle(), {"q": q, "p": jnp.zeros(2)})))(q)
    for i in range(4):
        run = hy.simulate(BallOnCircle(), {"q": q[i], "p": [0, 0]}, (0, 4), solver="taylor")
        np.testing.assert_allclose(out.final["q"][i], run.final.q, atol=1e-8)
        assert bool(jnp.isnan(out.zeno.t[i])) == (not run.zeno)


# ---------------------------------------------------------------------------------------
# derivatives


def t_inf_of(**options):
    """The accumulation time of a ball by restitution and height."""
    fall = hy.as_function(BouncingBall(), t=(0.0, 3.0), max_jumps=8, **options)
    return lambda e, h: fall(BouncingBall(r=e), {"x": h, "v": 0.0}).zeno.t


#: ``dt_inf/de`` and ``dt_inf/dh`` for g = 9.81, e = 0.7, h = 1.
BY_E, BY_H = 10.0338586885718, 1.27931698279290


@pytest.mark.parametrize(
    ("solver", "derivative"),
    spread(["taylor", "scipy", "diffrax"], [jax.jacfwd, jax.jacrev, jax.grad]),
)
def test_derivatives_of_the_accumulation_time(solver, derivative):
    """Closed forms, in both modes and with every solver's steps."""
    tight = {} if solver == "taylor" else {"rtol": 1e-11, "atol": 1e-12}
    by_e, by_h = derivative(t_inf_of(solver=solver, **tight), (0, 1))(0.7, 1.0)
    assert float(by_e) == pytest.approx(BY_E, rel=1e-10)
    assert float(by_h) == pytest.approx(BY_H, rel=1e-10)


def test_all_of_an_accumulation_is_differentiated():
    """By gravity, restitution, height and the start's time: time, ratio, and where it is."""
    fall = hy.as_function(BouncingBall(), t=(0.0, 3.0), max_jumps=8)
    limit = lambda g, e, h: fall(BouncingBall(g=g, r=e), {"x": h, "v": 0.0}).zeno  # noqa: E731
    g, e, h = 9.81, 0.7, 1.0
    slopes = jax.jacfwd(limit, (0, 1, 2))(g, e, h)
    t = np.sqrt(2 * h / g) * (1 + e) / (1 - e)
    np.testing.assert_allclose(slopes.t, [-t / (2 * g), BY_E, t / (2 * h)], rtol=1e-12)
    assert [float(v) for v in slopes.ratio] == [0.0, 1.0, 0.0]
    np.testing.assert_allclose(slopes.state["x"], 0.0, atol=1e-13)
    np.testing.assert_allclose(slopes.state["v"], 0.0, atol=1e-13)
    later = lambda t0: hy.as_function(BouncingBall(), t=(t0, 4.0), max_jumps=8)  # noqa: E731
    slope = jax.grad(lambda t0: later(t0)(BouncingBall(), {"x": h, "v": 0.0}).zeno.t)(0.5)
    assert float(slope) == pytest.approx(1.0, rel=1e-12)


def test_jumps_and_states_are_differentiated():
    """The first two impacts: times, and speeds before and after."""
    fall = hy.as_function(BouncingBall(), t=(0.0, 3.0), max_jumps=8)
    g, e, h = 9.81, 0.7, 1.0
    table = lambda e, h: fall(BouncingBall(r=e), {"x": h, "v": 0.0}).jumps  # noqa: E731
    by_e, by_h = jax.jacfwd(lambda e, h: table(e, h)._replace(edge=0, count=0), (0, 1))(e, h).t
    drop = np.sqrt(2 * h / g)
    np.testing.assert_allclose(by_e[:2], [0.0, 2 * drop], atol=1e-13)
    np.testing.assert_allclose(by_h[:2], [drop / (2 * h), (1 + 2 * e) * drop / (2 * h)], rtol=1e-13)
    slope = jax.grad(lambda e: table(e, h).after["v"][1])(e)
    assert float(slope) == pytest.approx(2 * e * np.sqrt(2 * g * h), rel=1e-12)


#: Central differences of fourth order of runs to rounding: their own error is taken off.
OFF = 1e-7


#: The second of "rubbed" ends in an arc of no length, along a flow that changes its formula.
SEEDED = [
    *((name, 0) for name in gradients.SCENES),
    ("rubbed", 1),
    *(
        pytest.param(name, 1, marks=pytest.mark.every_way)
        for name in gradients.SCENES
        if name != "rubbed"
    ),
]


@pytest.mark.parametrize(("name", "seed"), SEEDED)
def test_derivatives_against_differences(name, seed):
    """Impacts, sums, rest, releases, sliding, resets, forces that begin at once: all numbers that a
    run gives by all that it is given."""
    found = gradients.compared(name, seed)
    assert found.off < OFF, found
    assert not found.none, found
    assert found.judged > 50, found


@pytest.mark.parametrize(
    "name", ["relay", "belt", "pool", "corner", "rubbed", "sampled", "table", "heavy"]
)
def test_machine_code_carries_derivatives_as_the_walk_does(name):
    """Through switchings and sliding, jumps beside contacts held and at one instant, forces that
    turn, clocks, sums and rests: without Python, and the same numbers."""
    alone, apart = gradients.carried(name, 0)
    assert alone
    assert apart < 1e-9  # both resolve limits to 1e-11 of their size


def test_reverse_mode_is_forward_mode():
    """Through impacts, a sum, rest and a release: the same matrix, read the other way."""
    table = hy.as_function(BeadOnTable(), t=(0.0, 3.0), max_jumps=32)

    def quantities(r, omega, x):
        out = table(BeadOnTable(r=r, omega=omega), {"x": x, "v": 0.0})
        release = jnp.argmax(out.jumps.edge == table.edges.index("impact.release"))
        return jnp.stack([out.jumps.t[0], out.zeno.t, out.jumps.t[release], *out.final])

    at, which = (0.3, 4.0, 1.5), (0, 1, 2)
    forward = jnp.stack(jax.jacfwd(quantities, which)(*at))
    np.testing.assert_allclose(jnp.stack(jax.jacrev(quantities, which)(*at)), forward, rtol=1e-14)
    compiled = jax.jit(jax.jacrev(quantities, which))(*at)
    np.testing.assert_allclose(jnp.stack(compiled), forward, rtol=1e-14)
    assert np.all(np.isfinite(forward))


def test_many_at_once_are_each_by_itself():
    """Values and gradients under vmap, to the last bit."""
    slope, each = jax.value_and_grad(t_inf_of()), np.linspace(0.5, 0.7, 7)
    values, slopes = jax.jit(jax.vmap(slope, (0, None)))(each, 1.0)
    for e, value, by_e in zip(each, values, slopes, strict=True):
        assert (float(value), float(by_e)) == tuple(float(v) for v in slope(e, 1.0))


def test_a_restitution_is_found_by_its_gradient():
    """Descent in a scan, compiled as a whole: the e of t_inf = 2 is (2 - d) / (2 + d)."""
    t_inf = t_inf_of(outputs=("zeno",))
    loss = lambda e: (t_inf(e, 1.0) - 2.0) ** 2  # noqa: E731

    def step(e, _):
        return e - 0.01 * jax.grad(loss)(e), None

    found, _ = jax.jit(lambda e: jax.lax.scan(step, e, length=60))(0.55)
    drop = np.sqrt(2 / 9.81)
    assert float(found) == pytest.approx((2 - drop) / (2 + drop), rel=1e-9)


class Field(hy.Automaton):
    """A force that begins at a place."""

    edge: float = hy.parameter(1.0)
    x = hy.state()
    v = hy.state()

    @hy.mode
    def fly(self, t, s):
        return s.v, jnp.where(s.x > self.edge, -2.0, 0.0)


@pytest.mark.parametrize("options", [{}, {"solver": "scipy", "rtol": 1e-11, "atol": 1e-12}])
def test_derivatives_pass_a_force_that_begins_at_once(options):
    """x = a + v s - s^2, with s = 2 - a / v the time in the field."""
    fly = hy.as_function(Field(), t=(0.0, 2.0), max_jumps=1, **options)
    slope = jax.jacrev(lambda a, v: fly(Field(edge=a), {"x": 0.0, "v": v}).final["x"], (0, 1))
    a, v = 1.0, 1.5
    s = 2.0 - a / v
    assert float(slope(a, v)[0]) == pytest.approx(2.0 * s / v, rel=1e-9)
    assert float(slope(a, v)[1]) == pytest.approx(s + a / v - 2.0 * s * a / v**2, rel=1e-9)


def test_derivatives_of_a_state_in_flight():
    """The run ends in the air: x = v s - g s^2 / 2, s the time since the first impact."""
    g, r, h = 9.81, 0.7, 3.0
    fly = lambda t1: hy.as_function(BouncingBall(), t=(0.0, t1), max_jumps=4)  # noqa: E731
    end = lambda h, t1: fly(t1)(BouncingBall(), {"x": h, "v": 0.0}).final["x"]  # noqa: E731
    by_h, by_t = jax.jacfwd(end, (0, 1))(h, 1.5)
    drop = np.sqrt(2 * h / g)
    v, s = r * np.sqrt(2 * g * h), 1.5 - drop
    dv, ds = 0.5 * v / h, -0.5 * drop / h
    assert float(by_h) == pytest.approx(dv * s + v * ds - g * s * ds, rel=1e-12)
    assert float(by_t) == pytest.approx(v - g * s, rel=1e-12)


# ---------------------------------------------------------------------------------------
# where there is no derivative


def test_after_a_tangency_there_is_none():
    """``x = h cos t`` touches a wall at -1 at h = 1: NaN from there on, by what moves the touch."""
    swing = hy.as_function(Oscillator(), t=(0.0, 5.0), max_jumps=4)

    def end(h, wall):
        return swing(Oscillator(wall=wall), {"x": h, "v": 0.0}).final["x"]

    assert float(jax.grad(end)(0.9, -1.0)) == pytest.approx(np.cos(5.0), rel=1e-12)
    assert np.isnan(jax.grad(end)(1.0, -1.0))
    assert np.isnan(jax.jacfwd(end, 1)(1.0, -1.0))


def test_a_start_where_the_force_turns():
    """At rest in the air: what it is thrown with turns the drag at once or later, and has no
    derivative; all else has, the time at which it is let go among them."""
    run = lambda t0: hy.as_function(Rubbed(), t=(t0, 0.9), max_jumps=4)  # noqa: E731

    def end(c, v, t0):
        return run(t0)(Rubbed(c=c), {"x": 1.0, "v": v}).final["x"]

    by_c, by_v, by_t0 = jax.grad(end, (0, 1, 2))(2.0, 0.0, 0.0)
    assert np.isnan(by_v)
    step = 1e-4
    for slope, ends in (
        (by_c, [end(2.0 + s, 0.0, 0.0) for s in (-step, step)]),
        (by_t0, [end(2.0, 0.0, s) for s in (-step, step)]),
    ):
        assert float(slope) == pytest.approx(float(ends[1] - ends[0]) / (2 * step), rel=1e-6)


def test_the_steps_of_a_method_close_in_on_a_force_that_turns():
    """DOP853's, a million millionth long, are differentiated as Taylor's are."""
    slopes = [
        jax.grad(lambda c, f=f: f(Rubbed(c=c), {"x": 1.0, "v": 0.5}).final["x"])(2.0)
        for f in (
            hy.as_function(Rubbed(), t=(0.0, 1.0), max_jumps=4, **options)
            for options in ({}, {"solver": "scipy", "rtol": 1e-12, "atol": 1e-13})
        )
    ]
    assert float(slopes[1]) == pytest.approx(float(slopes[0]), rel=1e-9)


def test_what_has_a_derivative_is_not_spoilt_by_what_has_none():
    """The ratio of a cycle's limit has none, and the jumps before it do."""
    tanks = hy.as_function(TwoTanks(), t=(0.0, 30.0), max_jumps=200)

    def parts(x2, weight):
        out = tanks(TwoTanks(), {"x1": 8.0, "x2": x2})
        return out.jumps.t[0] + weight * out.zeno.t

    assert float(jax.grad(parts)(6.0, 0.0)) == pytest.approx(1.0, rel=1e-12)
    assert np.isnan(jax.grad(parts)(6.0, 1.0))
    assert np.isnan(jax.jit(jax.grad(parts))(6.0, 1.0))


class Pair(hy.Automaton):
    """Two balls that know nothing of each other."""

    x = hy.state()
    y = hy.state()
    u = hy.state()
    w = hy.state()
    g = hy.parameter(9.81)

    @hy.mode
    def fall(self, t, s):
        return s.u, s.w, -self.g, -self.g

    one = hy.contact(fall, gap=lambda self, t, s: s.x, restitution=0.5)
    other = hy.contact(fall, gap=lambda self, t, s: s.y, restitution=0.5)


def test_jumps_at_one_instant_of_which_neighbours_have_one_first():
    """Two balls from one height: what one start moves apart has no derivative here; gravity, which
    does not, has."""
    fall = hy.as_function(Pair(), t=(0.0, 0.6), max_jumps=8)

    def end(x, y, g):
        return fall(Pair(g=g), {"x": x, "y": y, "u": 0.0, "w": 0.0}).final["y"]

    by_x, by_y, by_g = jax.grad(end, (0, 1, 2))(1.0, 1.0, 9.81)
    assert np.isnan(by_x)
    assert np.isnan(by_y)
    alone = hy.as_function(BouncingBall(), t=(0.0, 0.6), max_jumps=8)
    exact = jax.grad(lambda g: alone(BouncingBall(g=g, r=0.5), {"x": 1.0, "v": 0.0}).final["x"])
    assert float(by_g) == pytest.approx(float(exact(9.81)), rel=1e-12)


class Stacked(hy.Automaton):
    """Two bodies on a floor at the height ``h``, one above the other; pulled up from t = ``up`` on,
    and what goes by them."""

    x = hy.state()
    y = hy.state()
    u = hy.state()
    w = hy.state()
    far = hy.state()
    r = hy.parameter(0.3)
    h = hy.parameter(0.1)
    up = hy.parameter(4.0)

    @hy.mode
    def fall(self, t, s):
        force = jnp.where(t > self.up, 3.0, -2.0)
        return s.u, s.w, force, force + 0.5 * (t > self.up), -s.far

    floor = hy.contact(fall, gap=lambda self, t, s: s.x - self.h, restitution="r")
    other = hy.contact(fall, gap=lambda self, t, s: s.y - s.x - 0.5, restitution="r")


@pytest.mark.parametrize(("solver", "y"), spread(["taylor", "scipy"], [1.8, 1.1], of=2))
def test_a_rest_forgets_how_bodies_came_to_it(solver, y):
    """Impacts of one upon the other and on the floor end at one instant, as no sum and no limit, or
    as that of a cycle: how long they took has no derivative, where the bodies lie then has."""
    start = {"x": 0.6, "y": y, "u": 0.0, "w": 0.0, "far": 1.0}
    fall = hy.as_function(Stacked(), t=(0.0, 6.0), max_jumps=400, solver=solver)

    def end(model, start):
        final = fall(model, start).final
        return jnp.array([final.x, final.y, final.u, final.w])

    by_model, by_start = jax.jacfwd(end, (0, 1))(Stacked(), start)
    for each in (by_model.r, *(by_start[name] for name in "xyuw")):
        assert each.tolist() == [0.0] * 4
    np.testing.assert_allclose(by_model.h, [1.0, 1.0, 0.0, 0.0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(by_model.up, [-6.0, -7.0, -3.0, -3.5], rtol=1e-9)


class OnTable(hy.Automaton):
    """A bead that rests on a table while a ball comes to rest on the floor."""

    x = hy.state()
    v = hy.state()
    y = hy.state()
    u = hy.state()
    a: float = hy.parameter(0.05)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, 0.0 * s.x - 10.0, s.u, 0.0 * s.y - 10.0

    table = hy.contact(
        flight, gap=lambda self, t, s: s.x - self.a * jnp.sin(3.0 * t), restitution=0.2
    )
    floor = hy.contact(flight, gap=lambda self, t, s: s.y, restitution=0.5)


def test_derivatives_through_a_limit_while_something_moves_at_rest():
    """At the end ``x = a sin(3 t)``, and nothing is left of the start."""
    function = hy.as_function(OnTable(), t=(0.0, 4.0), max_jumps=8)

    def final(a, y):
        start = {"x": 0.1, "v": 0.0, "y": y, "u": 0.0}
        return jnp.stack(list(function(OnTable(a=a), start).final))

    by_a, by_y = jax.jacfwd(final, argnums=(0, 1))(0.05, 1.0)
    exact = [np.sin(12.0), 3.0 * np.cos(12.0), 0.0, 0.0]
    np.testing.assert_allclose(by_a, exact, atol=1e-9)  # the steps' tolerance, 1e-8
    np.testing.assert_allclose(by_y, np.zeros(4), atol=1e-9)


class Behind(hy.Automaton):
    """A ball whose floor is where something else was, and is not until something is seen."""

    x = hy.state()
    v = hy.state()
    w = hy.state()
    gain = hy.parameter(0.4)

    @hy.mode
    def fall(self, t, s, past):
        return s.v, -9.81, 2.0 * jnp.cos(3.0 * t) - s.w

    hit = hy.contact(
        fall, gap=lambda self, t, s, past: s.x - self.gain * past(0.3).w, restitution=0.3
    )


class Carried(hy.Automaton):
    """A ball on a floor, carried by what it saw: its speed is not the rate of its place."""

    x = hy.state()
    v = hy.state()
    w = hy.state()

    @hy.mode
    def fall(self, t, s, past):
        return s.v + 0.4 * past(0.3).w, -9.81, 2.0 * jnp.cos(3.0 * t) - s.w

    hit = hy.contact(fall, gap=lambda self, t, s: s.x, restitution=0.3)


class Followed(hy.Automaton):
    """Friction against what was, a while ago."""

    x = hy.state()
    v = hy.state()
    w = hy.state()

    @hy.mode(initial=True)
    def faster(self, t, s):
        return s.v, jnp.sin(t) - 1.0, s.x - s.w

    @hy.mode
    def slower(self, t, s):
        return s.v, jnp.sin(t) + 3.0, s.x - s.w

    slip = hy.switching(faster, slower, surface=lambda self, t, s, past: s.v - 0.5 * past(0.3).w)


@pytest.mark.parametrize(
    ("model", "start", "known"),
    [
        (Behind(), [1.0, 0.0, 0.5], 0.3),  # before the impact; its speed has the rate of the past
        (Carried(), [1.0, 0.0, 0.5], 0.6),  # behind an impact; the load of the rest has it
        (Followed(), [0.3, 1.0, 0.3], 0.4),  # before it slides
    ],
)
def test_what_depends_on_how_fast_the_past_changes_has_no_derivative(model, start, known):
    """Of what is seen the change is carried, not that of its rate. What needs that is not told;
    what comes before is, against differences that are exact to 1e-8."""

    def final(t1):
        run = hy.as_function(model, t=(0.0, t1), max_jumps=20, rtol=1e-12, atol=1e-13)
        return lambda x: jnp.array(list(run(model, list(x)).final))

    start = jnp.array(start)
    assert np.isnan(np.asarray(jax.jacfwd(final(3.0))(start))).any(axis=1).all()
    early, h = final(known), 1e-4
    numeric = [(early(start + h * unit) - early(start - h * unit)) / (2 * h) for unit in np.eye(3)]
    np.testing.assert_allclose(jax.jacfwd(early)(start), np.array(numeric).T, atol=1e-6)


def test_a_run_that_fails_is_a_status():
    """Below the floor, in a compiled program too: a number, and no exception."""
    fall = jax.jit(hy.as_function(BouncingBall(), t=(0.0, 1.0), max_jumps=8))
    out = fall(BouncingBall(), {"x": -1.0, "v": 0.0})
    assert REASONS[int(out.status)][0] == "outside"
    assert float(out.final["x"]) == -1.0
    out = fall(BouncingBall(), {"x": np.nan, "v": 0.0})
    assert REASONS[int(out.status)][0] in ("outside", "not_finite")


class InNanometres(hy.Automaton):
    """A ball whose restitution depends on the speed, in a small unit of length."""

    x = hy.state()
    v = hy.state()
    per_metre = hy.parameter(1e9)

    @hy.mode
    def fly(self, t, s):
        return s.v, -9.8 * self.per_metre

    impact = hy.contact(
        fly,
        gap=lambda self, t, s: s.x,
        restitution=lambda self, t, s, u: 0.6 * jnp.exp(0.2 * u / self.per_metre),
    )


def test_a_small_unit_of_length_makes_no_difference():
    """Threads of JAX flush denormal numbers to zero, as the quotient of the slowest speed that is
    looked at and one of 1e9 is."""
    fly = hy.as_function(InNanometres(), t=(0.0, 3.0), max_jumps=300)
    small, large = (
        float(fly(InNanometres(per_metre=n), {"x": n, "v": 0.0}).zeno.t) for n in (1e9, 1.0)
    )
    assert abs(small - large) < 1e-12  # rounding of some tens of flights


class Steep(hy.Automaton):
    """What is passed is flat to rounding on both sides of a narrow zone."""

    x = hy.state()
    y = hy.state()
    k = hy.parameter(100.0)

    @hy.mode
    def only(self, t, s):
        return 1.0, jnp.tanh(self.k * s.x)


class Gust(hy.Automaton):
    """A gust of wind that lasts ``w`` seconds, about t = 0.37."""

    v = hy.state()
    a = hy.parameter(1.0)
    w = hy.parameter(0.01)

    @hy.mode
    def only(self, t, s):
        return self.a / self.w * jnp.exp(-(((t - 0.37) / self.w) ** 2))


def test_derivatives_see_narrow_zones():
    """They are flat to rounding far from the zone, as is their series: steps end where the
    arguments of ``tanh`` and ``exp`` come to it. Allowed is what 1 - tanh^2 loses at its edge."""
    passes = hy.as_function(Steep(), t=(0.0, 0.75), max_jumps=1)
    blows = hy.as_function(Gust(), t=(0.0, 0.9), max_jumps=1)
    for k in (30.0, 100.0, 1e5):
        end = jax.grad(lambda x, k=k: passes(Steep(k=k), {"x": x, "y": 0.0}).final.y)
        assert abs(end(-0.4) - (np.tanh(0.35 * k) + np.tanh(0.4 * k))) < 1e-12
    for w in (0.03, 0.01, 1e-4):
        end = jax.grad(lambda a, w=w: blows(Gust(a=a, w=w), {"v": 0.0}).final.v)
        assert abs(end(1.0) - np.sqrt(np.pi)) < 1e-12


class Rooted(hy.Automaton):
    """A spring by a cube root, whose slope has no bound where the spring has its own length."""

    x = hy.state()
    v = hy.state()
    k = hy.parameter(1.0)

    @hy.mode
    def swing(self, t, s):
        return s.v, -self.k * jnp.cbrt(s.x)


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_a_slope_without_a_bound_has_no_derivative_that_is_off(solver):
    """The integral over it is finite, but steps do not resolve it: 1e-4 was lost."""
    fall = hy.as_function(Rooted(), t=(0.0, 5.0), max_jumps=1, solver=solver)
    assert np.isfinite(fall(Rooted(), {"x": 1.0, "v": 0.0}).final.x)
    slope = jax.grad(lambda k: fall(Rooted(k=k), {"x": 1.0, "v": 0.0}).final.x)(1.0)
    assert np.isnan(slope)


class Cornered(hy.Automaton):
    """A body that a spring draws to a wall, above a floor; an impact on the wall throws it off the
    floor."""

    x, y = hy.state(unit="m"), hy.state(unit="m")
    u, v = hy.state(unit="m/s"), hy.state(unit="m/s")

    A: float = hy.parameter(0.10149765350546407, unit="m", doc="the wall's amplitude")

    @hy.mode
    def flight(self, t, s):
        pull = -7.089792088105645 * s.x - 0.1 * s.u + 0.4 * s.v
        return s.u, s.v, pull, -8.066076165933605 + 9.27443070684343 * jnp.sin(2 * t)

    floor = hy.contact(
        flight, gap=lambda self, t, s: s.y - 0.1 * s.x, restitution=0.2335672108029552
    )
    wall = hy.contact(
        flight,
        gap=lambda self, t, s: s.x + self.A * jnp.cos(t) - 0.13246954098414138,
        restitution=0.21021048972265968,
    )


def test_impacts_that_set_off_series_of_others_have_their_derivatives():
    """Each impact on the wall sets off a series on the floor, of ever slower impacts."""
    start = {"x": 1.0256385870052693, "y": 0.7008288105213981}
    start |= {"u": 0.8727717342473571, "v": 0.4001965975894892}
    f = hy.as_function(Cornered(), t=(0.0, 3.0), max_jumps=36)

    def times(a):
        return f(Cornered(A=a), start).jumps.t

    a, h = Cornered().A, 1e-4
    found = jax.jacfwd(times)(a)
    apart = (times(a + h) - times(a - h)) / (2 * h)
    # differences of the last ones are good to 2e-6: their own change when h is halved
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found, apart, rtol=5e-6)


class Rocked(hy.Automaton):
    """A bead over a table that moves."""

    x, v = hy.state(unit="m"), hy.state(unit="m/s")

    r: float = hy.parameter(0.4, unit="1", doc="restitution")

    @hy.mode
    def flight(self, t, s):
        return s.v, -9.8

    table = hy.contact(
        flight, gap=lambda self, t, s: s.x - 0.11 * jnp.sin(3.8 * t), restitution="r"
    )


def test_derivatives_of_a_limit_far_from_the_origin_of_time():
    """There the rounding of the time hides the speed of slow impacts: what is left of it decides
    whether there is a derivative, and none is off."""
    draw, h, known = np.random.default_rng(0), 1e-4, 0
    f = jax.jit(
        lambda r, x, v, begin: (
            hy.as_function(Rocked(), t=(begin, begin + 2.0), max_jumps=80)(
                Rocked(r=r), {"x": x, "v": v}
            ).zeno.t
        )
    )
    found = jax.jit(jax.jacfwd(f))
    for begin in np.repeat([300.0, 1000.5, 1e4], 8):
        r, *rest = *draw.uniform([0.2, 0.2, -1.0], [0.7, 0.8, 1.0]), begin + draw.uniform(0, 2)
        one, two, four, five = (float(f(r + k * h, *rest)) for k in (-2, -1, 1, 2))
        apart = (one - 8 * two + 8 * four - five) / (12 * h)
        slope = float(found(r, *rest))
        if np.isfinite(slope):
            known += 1
            # USABLE, and a spacing of the time over the step
            assert slope == pytest.approx(apart, rel=4e-6, abs=4 * np.spacing(begin) / h)
    assert known >= 8


class Wedged(hy.Automaton):
    """A body between a wall and a floor, both of which move."""

    x, y = hy.state(unit="m"), hy.state(unit="m")
    u, v = hy.state(unit="m/s"), hy.state(unit="m/s")

    a: float = hy.parameter(0.04468046478508343, unit="m", doc="amplitude of both")

    @hy.mode
    def flight(self, t, s):
        return s.u, s.v, -3.0 + 0.5 * jnp.sin(t), -9.8 - s.x * 0.3

    wall = hy.contact(
        flight,
        gap=lambda self, t, s: s.x - self.a * jnp.sin(t) - 0.05 * s.y,
        restitution=0.5046303503067897,
    )
    floor = hy.contact(
        flight,
        gap=lambda self, t, s: s.y - self.a * jnp.sin(3.9891155668576372 * t) - 0.1 * s.x,
        restitution=0.7461110353632521,
    )


@pytest.mark.long
def test_a_rest_that_leaves_no_freedom_has_derivatives_whatever_was_before():
    """Before it is a limit whose derivative rounding hides."""
    start = {"x": 0.9867257024440133, "y": 0.7496810288958156}
    start |= {"u": 0.8818269596291157, "v": -0.21329275386032087}
    begin, end = 0.14406809190528086, 2.875260057784876
    f = hy.as_function(Wedged(), t=(begin, end), max_jumps=400)
    found = jax.jacfwd(lambda a: f(Wedged(a=a), start).final.x)(Wedged().a)
    wall, floor = np.sin(end), np.sin(3.9891155668576372 * end)
    np.testing.assert_allclose(found, (wall + 0.05 * floor) / 0.995, rtol=1e-12)


class Plastic(hy.Automaton):
    """A body that does not bounce off a table that shakes, but is thrown once."""

    x = hy.state()
    v = hy.state()
    g = hy.parameter(9.8)
    a = hy.parameter(0.5)
    r = hy.parameter(0.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -self.g

    table = hy.contact(
        flight, gap=lambda self, t, s: s.x - self.a * jnp.sin(5.0 * t), restitution="r"
    )


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize("until", [0.69, 1.0])
def test_derivatives_through_perfectly_plastic_impacts(solver, until):
    """The second rests at once: its limit is the impact itself. Had it any restitution the limit
    would be later, by more than nothing at first order: by that there is no derivative of it."""
    function = hy.as_function(Plastic(), t=(0.0, until), solver=solver, rtol=1e-12, max_jumps=4)

    def ends(h, g, a, r):
        got = function(Plastic(g=g, a=a, r=r), {"x": h, "v": 0.0})
        jumps = got.jumps
        rows = (jumps.t[:2], jumps.before["v"][:2], jumps.after["v"][:2])
        return jnp.concatenate([*rows, jnp.array([got.zeno.t, got.final["x"], got.final["v"]])])

    at, by = (0.8, 9.8, 0.5, 0.0), (0, 1, 2)
    forward, reverse = (d(ends, by)(*at) for d in (jax.jacfwd, jax.jacrev))
    for k in by:
        ahead, back = (ends(*(p + s * (i == k) for i, p in enumerate(at))) for s in (1e-6, -1e-6))
        differences = (ahead - back) / 2e-6
        for found in (forward[k], reverse[k]):
            np.testing.assert_allclose(found, differences, rtol=1e-7, atol=1e-8)
    if until == 1.0:
        assert np.isnan(jax.jacfwd(ends, 3)(*at)[6])
        told = hy.simulate(Plastic(), {"x": 0.8, "v": 0.0}, (0.0, until), solver=solver).explain()
        assert "gaps that fall by no one ratio" in told  # nothing is drawn
