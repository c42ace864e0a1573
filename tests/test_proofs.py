"""Proofs from an impact on: where they hold, what they enclose, and that none is false."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid import gallery
from hybrid.lowering import scene_of
from hybrid.zeno.enclose import prove
from models.ball_on_circle import BallOnCircle
from models.bouncing_ball import BouncingBall
from models.hard_spring import HardSpring

from . import systems

pytest.importorskip("flint")

CHATTERING = [
    *("ball_on_circle", "bead_on_table", "bouncing_ball", "bowl"),
    *("coupled", "hard_spring", "hills", "moon_holmes", "steady_push"),
]

BORDER = 0.150562297509349608672127586612455896897636764


@pytest.mark.parametrize("solver", ["scipy", "taylor", "diffrax"])
@pytest.mark.parametrize("name", CHATTERING)
def test_the_gallery_is_certified(name, solver):
    """Every contact that chatters is proved to; the known limit lies in the enclosure."""
    entry = gallery.find(name)
    run = hy.simulate(entry.cls(), entry.start, entry.until, rtol=1e-11, solver=solver)
    known = [value for label, _, value, _ in entry.module.oracle(run) if label == "t_inf"]
    point = run.zeno[0]
    assert point.verdict == "certified"
    low, high = point.enclosure
    assert high - low < 2.1 * point.t_error + 1e-12  # the proof's own width, some roundings
    assert all(low <= value <= high for value in known)
    assert "It is proved from the impact at" in run.explain()


def test_the_enclosure_of_example_1():
    """Narrower than 1e-9, and from the proof alone narrower than 1e-13."""
    run = hy.simulate(HardSpring(), {"x": 2.1, "v": 0.0}, (0, 2), rtol=1e-12, atol=1e-13)
    low, high = run.zeno[0].enclosure
    assert low <= 1.32961738383844857732 <= high
    assert high - low < 1e-9
    best = min(run.zeno[0].proofs, key=lambda proof: proof.high - proof.low)
    assert best.high - best.low < 1e-13


@pytest.mark.parametrize("r", [0.99, 0.999])
def test_long_series_are_proved_from_late_impacts(r):
    """Speeds that hardly fall add up to wide boxes; late impacts give narrow ones."""
    run = hy.simulate(HardSpring(r=r), [2.1, 0.0], (0, 400), zeno="stop", solver="taylor")
    best = run.zeno[0].narrowest
    assert best.high - best.low < 1e-12
    assert best.low - 1e-8 < run.zeno[0].t < best.high + 1e-8


@pytest.mark.parametrize("v", [1e-6, 1e-2, 2.0, 40.0])
@pytest.mark.parametrize("r", [0.1, 0.7, 0.999])
def test_a_ball_is_proved_from_any_impact(v, r):
    """Constant gravity: the bounds are the closed form, up to rounding, however strong."""
    model = BouncingBall(r=r)
    field = scene_of(model).field("flight")
    proof = prove(field, "impact", 0.25, np.array([0.0, v]), v)
    exact = 0.25 + 2 * v / 9.81 / (1 - r)
    assert proof.low <= exact <= proof.high
    assert proof.high - proof.low < 1e-13 * (1 + exact)  # a hundred roundings
    assert proof.rho == pytest.approx(r, rel=1e-12)
    assert np.all(proof.x_low <= 0.0)
    assert np.all(proof.x_high >= 0.0)


@pytest.mark.parametrize("share", [1e-2, 1e-6, 1e-9])
def test_what_escapes_is_never_proved(share):
    """Weakening gravity above the threshold: no proof from any of the impacts; below it, one."""
    tight = {"rtol": 1e-13, "atol": 1e-15, "zeno": "truncate", "max_jumps": 60}
    for sign in (1, -1):
        start = {"y": 0.0, "v": BORDER * (1 + sign * share)}
        run = hy.simulate(systems.WeakeningGravity(), start, (0, 2), **tight)
        field = scene_of(systems.WeakeningGravity()).field("flight")
        proofs = [
            prove(field, "impact", jump.t, np.array([0.0, jump.after.v]), jump.after.v)
            for jump in run.jumps
            if jump.edge == "impact"
        ]
        assert any(proof is not None for proof in proofs) == (sign < 0)


def test_the_border_of_the_circle_by_bisection():
    """The start beyond which the ball no longer comes to rest, by the certificate alone."""
    inside, outside = 0.19, 0.193
    while outside - inside > 2e-14:
        middle = 0.5 * (inside + outside)
        start = {"q": [middle, 1.2], "p": [0.0, 0.0]}
        run = hy.simulate(BallOnCircle(), start, (0, 6), solver="taylor", save="jumps")
        if run.zeno and run.zeno[0].verdict == "certified":
            inside = middle
        else:
            outside = middle
    assert inside == pytest.approx(0.1913325241911, abs=1e-13)  # as many digits as are known


def test_nothing_is_proved_with_another_guard_in_the_way():
    """A ceiling in the box, restitution 1, an obstacle that lets go: each is turned down."""
    scene = scene_of(systems.DippingCeiling(c=0.8))
    assert prove(scene.field("flight"), "floor", 0.0, np.array([0.0, 3.0]), 3.0) is None
    elastic = scene_of(BouncingBall(r=1.0)).field("flight")
    assert prove(elastic, "impact", 0.0, np.array([0.0, 1.0]), 1.0) is None
    late = scene_of(systems.WeakeningGravity()).field("flight")
    assert prove(late, "impact", 0.999, np.array([0.0, 0.1]), 0.1) is None


class Stepped(hy.Automaton):
    """A floor that steps up by 0.1 at t = 1."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.v, -10.0

    impact = hy.contact(
        flight, gap=lambda self, t, s: s.x - jnp.where(t < 1.0, 0.0, 0.1), restitution=0.5
    )


def test_a_gap_that_may_jump_proves_nothing():
    """Its derivatives along the flow are those of a floor at rest; a step is no derivative."""
    field = scene_of(Stepped()).field("flight")
    assert prove(field, "impact", 0.0, np.array([0.0, 1.0]), 1.0) is not None
    assert prove(field, "impact", 0.9, np.array([0.0, 1.0]), 1.0) is None


def test_the_bounds_are_those_of_the_lemma():
    """Weakening gravity from t = 0: bounds by hand, with g between 1 - T and 1."""
    field = scene_of(systems.WeakeningGravity()).field("flight")
    v = 1e-3
    proof = prove(field, "impact", 0.0, np.array([0.0, v]), v)
    assert pytest.approx(1.0, abs=1e-12) == proof.M
    assert proof.m < 1.0 - proof.high
    assert proof.rho == pytest.approx(0.5 * math.sqrt(proof.M / proof.m), rel=1e-12)
    assert proof.high == pytest.approx(2 * v / (proof.m * (1 - proof.rho)), rel=1e-12)
    # three further impacts, flown by hand, lie within
    t, speed = 0.0, v
    for _ in range(60):
        a, b, c = -1.0 / 6.0, 0.5 * (1.0 - t), -speed
        flight = -2 * c / (b + math.sqrt(b * b - 4 * a * c))
        t, speed = t + flight, 0.5 * abs(speed - (1.0 - t) * flight + 0.5 * flight**2)
    assert proof.low <= t <= proof.high


@pytest.mark.parametrize(
    ("name", "speed"),
    [("hard_spring", 0.4), ("moon_holmes", 0.02), ("bead_on_table", 2.9), ("pyragas", 1.0)],
)
def test_chattering_is_proved_early(name, speed):
    """From fast impacts on; and the whole motion after them stays within the bounds proved."""
    entry = gallery.find(name)
    run = hy.simulate(entry.cls(), entry.start, entry.until, rtol=1e-12, atol=1e-13)
    point = run.zeno[0]
    first = point.proofs[0]
    assert first.speed > speed
    assert all(proof.low <= point.t + 1e-9 for proof in point.proofs)
    assert all(proof.high >= point.t - 1e-9 for proof in point.proofs)
    times = np.linspace(first.t, point.t, 2001)[1:]
    states = np.array(run(times)).T
    assert np.all(states >= first.x_low - 1e-9)
    assert np.all(states <= first.x_high + 1e-9)


def test_a_file_keeps_the_bounds_of_a_proof_and_says_so(tmp_path):
    run = hy.simulate(BouncingBall(), {"x": 1.0, "v": 0.0}, (0.0, 3.0), solver="taylor")
    run.save(tmp_path / "run.nc")
    point = hy.load(tmp_path / "run.nc", BouncingBall).zeno[0]
    assert point.verdict == "certified"
    assert point.enclosure == run.zeno[0].enclosure
    assert "certified" in hy.load(tmp_path / "run.nc", BouncingBall).explain()
    with pytest.raises(ValueError, match="keeps its enclosure alone"):
        _ = point.narrowest
