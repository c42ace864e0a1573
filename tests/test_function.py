"""Runs inside the user's own JAX program: the same results, bounded, and differentiable."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from models.ball_on_circle import BallOnCircle
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall
from models.hard_spring import HardSpring

TIGHT = {"rtol": 1e-11, "atol": 1e-12}


@pytest.fixture(autouse=True)
def _wide():
    """The user's own setting, for these tests only."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def fall():
    """A dropped ball as a function of its model and start."""
    with jax.enable_x64(True):
        return hy.as_function(BouncingBall(), t=(0.0, 3.0), max_jumps=8, max_steps=256, **TIGHT)


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
    assert hy.as_function(BouncingBall(), t=(0, 3), max_jumps=8, max_steps=5)(
        BouncingBall(), start
    ).overflow


def test_only_what_is_asked_for_is_returned():
    only = hy.as_function(BouncingBall(), t=(0, 3), max_jumps=8, max_steps=64, outputs=("zeno",))
    out = only(BouncingBall(), {"x": 1.0, "v": 0.0})
    assert out.final is None
    assert out.jumps is None
    with pytest.raises(hy.OptionError, match="'all' is none of final, jumps, zeno"):
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
    slide = hy.as_function(BallOnCircle(), t=(0, 4), max_jumps=16, max_steps=512, **TIGHT)
    q = jnp.stack([jnp.array([0.1, 0.15, 0.3, 0.4]), jnp.full(4, 1.2)], axis=1)
    out = jax.jit(jax.vmap(lambda q: slide(BallOnCircle(), {"q": q, "p": jnp.zeros(2)})))(q)
    for i in range(4):
        run = hy.simulate(BallOnCircle(), {"q": q[i], "p": [0, 0]}, (0, 4), solver="taylor")
        np.testing.assert_allclose(out.final["q"][i], run.final.q, atol=1e-8)
        assert bool(jnp.isnan(out.zeno.t[i])) == (not run.zeno)


# ---------------------------------------------------------------------------------------
# derivatives


@pytest.mark.parametrize(
    ("derivative", "method"),
    [(jax.jacfwd, "Dopri8"), (jax.jacrev, "Dopri8"), (jax.jacrev, "Taylor")],
)
def test_derivatives_of_the_accumulation_time(derivative, method):
    """Closed forms: dt_inf/de = 10.03..., dt_inf/dh = 1.279... for g = 9.81, e = 0.7, h = 1."""
    bounds = {"max_jumps": 8, "max_steps": 64, **TIGHT}
    fall = hy.as_function(BouncingBall(), t=(0.0, 3.0), method=method, **bounds)

    def t_inf(e, h):
        return fall(BouncingBall(r=e), {"x": h, "v": 0.0}).zeno.t

    by_e, by_h = jax.jit(derivative(t_inf, (0, 1)))(0.7, 1.0)
    assert float(by_e) == pytest.approx(10.0338586885718, rel=1e-10)
    assert float(by_h) == pytest.approx(1.27931698279290, rel=1e-10)


def quantities(model, start, t, **bounds):
    """Two jumps (a release, if there is one), the limit, the final state, of named numbers."""
    run = hy.as_function(type(model)(), t=t, method="Dopri8", **bounds, **TIGHT)
    names = [p.name for p in type(model).spec.parameters]

    def function(numbers):
        given = {k: v for k, v in numbers.items() if k in names}
        first = {k: numbers.get(f"{k}0", v) for k, v in start.items()}
        out = run(type(model)(**given), first)
        releases = out.jumps.edge == run.edges.index("impact.release")
        row = jnp.where(releases.any(), jnp.argmax(releases), 1)
        return jnp.stack([out.jumps.t[0], out.zeno.t, out.jumps.t[row], *out.final.values()])

    return jax.jit(function), function


CASES = {
    "through impacts and a sum": (
        HardSpring(),
        {"x": 2.1, "v": 0.0},
        (0.0, 3.0),
        {"r": 0.6, "wall": 2.0, "x0": 2.1},
    ),
    "through a release": (
        BeadOnTable(),
        {"x": 1.5, "v": 0.0},
        (0.0, 3.0),
        {"r": 0.3, "omega": 4.0, "amplitude": 1.0, "x0": 1.5},
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_derivatives_against_differences(case):
    """Every quantity by every number, forward; central differences err by 1e-7 here."""
    model, start, t, numbers = CASES[case]
    compiled, function = quantities(model, start, t, max_jumps=32, max_steps=512)
    exact = jax.jit(jax.jacfwd(function))(numbers)
    for name, value in numbers.items():
        d = 1e-5 * max(1.0, abs(value))
        up, down = (compiled({**numbers, name: value + s * d}) for s in (1, -1))
        np.testing.assert_allclose(exact[name], (up - down) / (2 * d), rtol=1e-5, atol=1e-6)


def test_reverse_mode_is_forward_mode():
    """Through impacts, a sum, rest and a release: the two agree to rounding."""
    model, start, t, numbers = CASES["through a release"]
    _, function = quantities(model, start, t, max_jumps=32, max_steps=256)
    weights = jnp.array([1.0, -0.5, 2.0, 0.3, 0.7])
    scalar = lambda numbers: weights @ function(numbers)  # noqa: E731
    forward = jax.jit(jax.jacfwd(scalar))(numbers)
    reverse = jax.jit(jax.grad(scalar))(numbers)
    for name in numbers:
        assert float(reverse[name]) == pytest.approx(float(forward[name]), rel=1e-9)


class Field(hy.Automaton):
    """A force that begins at a place."""

    edge: float = hy.parameter(1.0)
    x = hy.state()
    v = hy.state()

    @hy.mode
    def fly(self, t, s):
        return s.v, jnp.where(s.x > self.edge, -2.0, 0.0)


def test_derivatives_pass_a_force_that_begins_at_once():
    """x = a + v s - s^2, with s = 2 - a / v the time in the field."""
    bounds = {"max_jumps": 1, "max_steps": 32, **TIGHT}
    fly = hy.as_function(Field(), t=(0.0, 2.0), method="Taylor", **bounds)
    slope = jax.jacrev(lambda a, v: fly(Field(edge=a), {"x": 0.0, "v": v}).final["x"], (0, 1))
    a, v = 1.0, 1.5
    s = 2.0 - a / v
    assert float(slope(a, v)[0]) == pytest.approx(2.0 * s / v, rel=1e-9)
    assert float(slope(a, v)[1]) == pytest.approx(s + a / v - 2.0 * s * a / v**2, rel=1e-9)


def test_derivatives_of_a_state_in_flight():
    """The run ends in the air: x = v s - g s^2 / 2, s the time since the first impact."""
    g, r, h = 9.81, 0.7, 3.0
    fly = hy.as_function(BouncingBall(), t=(0.0, 1.5), max_jumps=4, max_steps=64, **TIGHT)
    slope = jax.jacfwd(lambda h: fly(BouncingBall(), {"x": h, "v": 0.0}).final["x"])(h)
    drop = np.sqrt(2 * h / g)
    v, s = r * np.sqrt(2 * g * h), 1.5 - drop
    dv, ds = 0.5 * v / h, -0.5 * drop / h
    assert float(slope) == pytest.approx(dv * s + v * ds - g * s * ds, rel=1e-9)
