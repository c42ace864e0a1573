"""Certificates before the run: the paper's examples, refutations with repair, the lemma."""

import math
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.certificates import relative
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall
from models.coupled import Coupled
from models.hard_spring import HardSpring
from models.moon_holmes import MoonHolmes
from models.pyragas import Pyragas
from tests.contract.ways import later
from tests.systems import Thermostat
from tests.test_readers import EXPRESSIONS

#: ``16.625 sqrt(2 (2.5 - 2) / 7)`` and ``1.875 sqrt(2 (1.5 - 1.1) / 0.231)``, 24 and 15 digits.
LEFT_OF_EXAMPLE_1 = 6.283659363778402652441337
LEFT_OF_THE_BEAM = 3.48931578899427

SPRING = {"x": (2.0, 2.5), "v": (-7.0, 7.0)}
BEAM = {"x": (1.1, 1.5), "v": (-3.0, 3.0)}


def fall(force, gap=None, restitution=0.5, rate=None):
    """A class whose only contact is an obstacle before x, under a force(t, x, v)."""

    class Fall(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def flight(self, t, s):
            velocity = s.v if rate is None else rate(t, s)
            return velocity, force(t, s.x, s.v)

        impact = hy.contact(flight, gap=gap or (lambda self, t, s: s.x), restitution=restitution)

    return Fall()


def box(h=1.0, c=10.0):
    return {"x": (0.0, h), "v": (-c, c)}


# -- Theorem 1 --------------------------------------------------------------------------


def test_example_1_is_certified():
    """sup f = -7 at (2, +-pi), M = 16.625; m from 5.640625 to 7, which is excluded."""
    proof = hy.certify(HardSpring(), SPRING)
    assert proof.verdict == "certified"
    assert proof.left == pytest.approx(LEFT_OF_EXAMPLE_1, rel=1e-12)
    assert proof.left > LEFT_OF_EXAMPLE_1
    assert proof.right == 7.0
    assert proof.margin == pytest.approx(7.0 - 6.283659363778402, rel=1e-11)
    assert proof.m < 7.0 == pytest.approx(proof.m, rel=1e-12)
    assert proof.M >= 16.625 == pytest.approx(proof.M, rel=1e-12)
    assert proof.m_at["x"] == 2.0
    assert abs(proof.m_at["v"]) == pytest.approx(math.pi, abs=1e-5)  # a flat maximum
    assert proof.m_range == pytest.approx((5.640625, 7.0), rel=1e-11)
    assert proof.m_range[0] >= 5.640625
    assert proof.initial_set == {"x": (2.0, 2.5), "v": 0.0}
    assert proof.repair == ""


def test_moon_holmes_is_refuted_as_printed():
    """sup f is -0.231, not -0.331: the left side is 3.489 > 3."""
    proof = hy.certify(MoonHolmes(delta=0.0, gamma=0.0), BEAM)
    smallest = LEFT_OF_THE_BEAM
    assert proof.verdict == "refuted"
    assert "the inequality fails" in proof.reason
    assert proof.m == pytest.approx(0.231, rel=1e-12)
    assert proof.m_at == {"x": 1.1}
    assert proof.left == pytest.approx(smallest, rel=1e-13)
    assert proof.margin == pytest.approx(3.0 - smallest, rel=1e-12)
    assert f"|v| up to more than {proof.left!r}" in proof.repair
    text = str(proof)
    assert text.startswith("refuted: MoonHolmes, contact impact")
    assert "-0.231" in text


@pytest.mark.parametrize(
    ("model", "asked"),
    [(MoonHolmes(delta=0.0, gamma=0.0), BEAM), (HardSpring(), {"x": (2, 2.5), "v": (-6, 6)})],
)
def test_repairs_are_repairs(model, asked):
    """The speed named, slightly more, certifies; so does the smaller height."""
    proof = hy.certify(model, asked)
    assert proof.verdict == "refuted"
    speed = float(proof.repair.split("more than ")[1].split(",")[0]) * (1 + 1e-9)
    assert hy.certify(model, {**asked, "v": (-speed, speed)}).verdict == "certified"
    low, high = proof.initial_set["x"]
    assert hy.certify(model, {**asked, "x": (low, high)}).verdict == "certified"
    # The largest height: a bisection of 20 halvings, so a little more is refused.
    more = high + 1e-4 * (asked["x"][1] - low)
    assert hy.certify(model, {**asked, "x": (low, more)}).verdict == "refuted"


def test_a_ball_is_certified_with_m_just_below_g():
    """(C1) is strict: at m = g it does not apply by the letter."""
    proof = hy.certify(BouncingBall(), {"x": (0, 1), "v": (-5, 5)})
    assert proof.verdict == "certified"
    assert proof.m == math.nextafter(9.81, 0.0)
    assert proof.M == 9.81
    assert proof.left == pytest.approx(math.sqrt(2 * 9.81), rel=1e-14)
    refuted = hy.certify(BouncingBall(), {"x": (0, 1), "v": (-4.4, 4.4)})
    assert refuted.verdict == "refuted"
    assert refuted.initial_set["x"][1] == pytest.approx(4.4**2 / (2 * 9.81), rel=1e-5)


def test_every_motion_of_the_set_chatters():
    """Runs from the whole set of initial data accumulate; a proof is more than that."""
    proof = hy.certify(HardSpring(), SPRING)
    low, high = proof.initial_set["x"]
    for share in (0.01, 0.5, 0.99):
        run = hy.simulate(HardSpring(), {"x": low + share * (high - low), "v": 0.0}, (0.0, 9.0))
        assert len(run.zeno) == 1


def test_a_force_that_turns_over_refutes_c1():
    """f = x - 1 pushes away from the wall above 1; below, the theorem holds again."""
    proof = hy.certify(fall(lambda t, x, v: x - 1.0), box(2.0, 3.0))
    assert proof.verdict == "refuted"
    assert "(C1) fails: the gap's acceleration is 1 at x = 2" in proof.reason
    assert proof.m is None
    assert 0.5 < proof.initial_set["x"][1] < 1.0
    assert "x only as far as" in proof.repair


def test_damping_refutes_c2_at_a_point():
    """With the point, and the way on."""
    proof = hy.certify(MoonHolmes(gamma=0.0), {"x": (1.1, 1.5), "v": (-9.0, 9.0)})
    model = fall(lambda t, x, v: -1.0 - 0.05 * v)
    assert hy.certify(model, box()).verdict == "refuted"
    assert "(C2) fails" in hy.certify(model, box()).reason
    assert proof.verdict == "refuted"
    assert "relative coordinates" in proof.repair


def test_an_even_force_that_is_not_recognised_is_undecided():
    """No counterexample and no proof: said so."""
    model = fall(lambda t, x, v: -3.0 - jnp.cosh(v) + 0.5 * jnp.exp(v) - 0.5 * jnp.sinh(v))
    proof = hy.certify(model, {"x": (0.0, 0.1), "v": (-3.0, 3.0)})
    assert proof.verdict == "undecided"
    assert "(C2) could not be decided" in proof.reason


@pytest.mark.parametrize(
    ("model", "sentence"),
    [
        (BeadOnTable(), "this gap depends on the time"),
        (MoonHolmes(delta=0.0), "these depend on the time too"),
        (fall(lambda t, x, v: -1.0, gap=lambda self, t, s: s.x * (s.x + 1)), "not affine"),
        (fall(lambda t, x, v: -1.0, gap=lambda self, t, s: s.x + jnp.floor(s.x)), "not affine"),
        (fall(lambda t, x, v: -1.0, rate=lambda t, s: s.v + s.x), "another function"),
        (fall(lambda t, x, v: -1.0, gap=lambda self, t, s: s.x - t), "depends on the time"),
        (fall(lambda t, x, v: jnp.where(jnp.abs(v) > 1, -1.0, -2.0)), "locally Lipschitz"),
        (fall(lambda t, x, v: -1.0 - jnp.sqrt(x)), "locally Lipschitz"),
        (fall(lambda t, x, v: -1.0, restitution=lambda self, t, s, u: 0.5 + 0 * t), None),
        (
            fall(lambda t, x, v: -1.0, restitution=lambda self, t, s, u: 0.5 + 0.1 * jnp.sin(t)),
            "the restitution depends on the time",
        ),
    ],
)
def test_what_the_theorem_does_not_cover_is_undecided(model, sentence):
    """The sentence says which hypothesis is not met."""
    proof = hy.certify(
        model, {"x": (0.0, 1.0) if model.spec.model == "Fall" else (1.1, 1.5), "v": (-9.0, 9.0)}
    )
    if sentence is None:
        assert proof.verdict == "certified"
    else:
        assert proof.verdict == "undecided"
        assert sentence in proof.reason
        assert proof.repair


@pytest.mark.parametrize(
    ("restitution", "verdict"),
    [
        (0.5, "certified"),
        (1.0, "refuted"),
        (0.0, "refuted"),
        (lambda self, t, s, u: 1.0 - 0.1 * u**2 / (1 + u**2), "undecided"),
        (lambda self, t, s, u: 0.5 + 0.01 * u, "certified"),
        (lambda self, t, s, u: 1.2 + 0.5 * u, "refuted"),
    ],
)
def test_the_restitution_is_checked(restitution, verdict):
    """Strictly between 0 and 1 on the box: the supremum 1, at rest, cannot be excluded."""
    proof = hy.certify(fall(lambda t, x, v: -1.0, restitution=restitution), box())
    assert proof.verdict == verdict


def test_a_ceiling_is_a_mirrored_floor():
    """The gap 3 - 2 x: numbers are the gap's own, positions the state's."""
    model = fall(lambda t, x, v: 1.0 + x * x, gap=lambda self, t, s: 3.0 - 2.0 * s.x)
    proof = hy.certify(model, {"x": (1.0, 1.5), "v": (-4.0, 4.0)})
    assert proof.verdict == "certified"
    assert (proof.m, proof.M) == pytest.approx((4.0, 6.5), rel=1e-12)
    assert proof.left == pytest.approx(6.5 * math.sqrt(2 * 1.0 / 4.0), rel=1e-12)
    assert proof.right == 8.0
    assert proof.initial_set == {"x": (1.0, 1.5), "v": 0.0}


def test_other_states_that_do_not_act_need_no_bounds():
    """The coupled oscillator is driven by the ball, not the other way round."""
    assert hy.certify(Coupled(), {"x1": (1.0, 2.0), "x2": (-9.0, 9.0)}).verdict == "certified"


def test_another_edge_inside_the_box_is_noticed():
    """A ceiling that the motion might reach; below it the floor is certified."""

    class Room(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def flight(self, t, s):
            return s.v, -1.0

        floor = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)
        ceiling = hy.contact(flight, gap=lambda self, t, s: 2.0 - s.x, restitution=0.5)

    assert hy.certify(Room(), box(1.9, 5.0), contact="floor").verdict == "certified"
    proof = hy.certify(Room(), box(2.5, 5.0), contact="floor")
    assert proof.verdict == "undecided"
    assert "may leave by ceiling" in proof.reason
    with pytest.raises(hy.OptionError, match=r"several contacts, floor .*name one: contact="):
        hy.certify(Room(), box())


# -- the lemma --------------------------------------------------------------------------


def test_the_table_is_certified_over_a_time():
    """What Theorem 1 does not cover; L_f^2 gap = -g + A w^2 sin(w t)."""
    asked = {"gap": (0.0, 1.0), "speed": (0.0, 1.0), "t": (20.0, 30.0)}
    proof = hy.certify(BeadOnTable(), asked)
    assert proof.verdict == "certified"
    assert proof.m == pytest.approx(9.8 - 0.29**2, rel=1e-11)
    assert pytest.approx(9.8 - 0.29**2 * math.sin(0.29 * 20), rel=1e-11) == proof.M
    assert proof.left == pytest.approx(0.9 * math.sqrt(proof.M / proof.m), rel=1e-12)
    v, (first, last) = proof.initial_set["speed"][1], proof.initial_set["t"]
    assert v * math.sqrt(proof.M / proof.m) == pytest.approx(1.0, rel=1e-12)
    assert first == 20.0
    assert last == pytest.approx(30.0 - proof.remaining[1], rel=1e-12)


@pytest.mark.parametrize(("t", "share"), [(20.0, 1.0), (23.0, 0.4), (27.0, 0.01)])
def test_runs_arrive_inside_the_enclosure(t, share):
    """From the table with a speed of the set: t_inf - t in proportion to the speed."""
    asked = {"gap": (0.0, 1.0), "speed": (0.0, 1.0), "t": (20.0, 30.0)}
    proof = hy.certify(BeadOnTable(), asked)
    v = share * proof.initial_set["speed"][1]
    start = {"x": math.sin(0.29 * t), "v": 0.29 * math.cos(0.29 * t) + v}
    run = hy.simulate(BeadOnTable(), start, (t, t + 5.0), rtol=1e-11, atol=1e-13)
    low, high = (share * bound for bound in proof.remaining)
    assert low <= run.zeno[0].t - t <= high


def test_the_lemma_needs_no_symmetry():
    """Damping and forcing: a box short enough in time and speed is certified."""
    proof = hy.certify(MoonHolmes(r=0.7), {"gap": (0, 0.01), "speed": (0, 0.05), "t": (0, 2)})
    assert proof.verdict == "certified"
    assert proof.remaining[0] < proof.remaining[1] <= 1.0


def test_a_box_too_wide_is_refuted_with_a_smaller_one():
    """rho > 1 for Example 1 on the box of the paper: 1.2328828 at r = 0.8."""
    proof = hy.certify(HardSpring(), {"gap": (0.0, 0.5), "speed": (0.0, 7.0)})
    assert proof.verdict == "refuted"
    assert proof.left == pytest.approx(1.2328828005937952901, rel=1e-12)
    assert "is not below 1" in proof.reason
    assert "a smaller box: gap in (0, " in proof.repair
    v = proof.initial_set["speed"][1]
    assert hy.certify(HardSpring(), {"gap": (0, v * v), "speed": (0, 2 * v)}).initial_set


def test_a_table_that_falls_faster_than_the_bead_is_refuted():
    """With the time at which it does; while the table rises it pushes, and the lemma holds."""
    model = BeadOnTable(omega=3.5)
    proof = hy.certify(model, {"gap": (0, 0.1), "speed": (0, 1), "t": (0, 3)})
    assert proof.verdict == "refuted"
    assert proof.m_at["t"] == pytest.approx(math.pi / 7, abs=1e-5)  # a flat maximum
    quiet = {"gap": (0, 0.1), "speed": (0, 0.1), "t": (0.9, 1.7)}
    assert hy.certify(BeadOnTable(omega=3.5, r=0.5), quiet).verdict == "certified"


def test_drifting_states_keep_their_room():
    """A charge that decays changes the force: the set of starts shrinks by its drift."""

    class Decay(hy.Automaton):
        x = hy.state()
        v = hy.state()
        q = hy.state()

        @hy.mode
        def flight(self, t, s):
            return s.v, -1.0 - 0.1 * s.q - 0.01 * s.v, -0.5 * s.q

        impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)

    asked = {"gap": (0.0, 1.0), "speed": (0.0, 1.0), "q": (0.0, 2.0)}
    proof = hy.certify(Decay(), asked)
    assert proof.verdict == "certified"
    low, high = proof.initial_set["q"]
    assert low == pytest.approx(proof.remaining[1], rel=1e-6)  # the rate is 0.5 * 2
    assert high == pytest.approx(2.0 - proof.remaining[1], rel=1e-6)
    with pytest.raises(hy.OptionError, match="no bounds for 'q', on which the proof depends"):
        hy.certify(Decay(), {"gap": (0.0, 1.0), "speed": (0.0, 1.0)})


def test_a_gap_that_jumps_is_undecided():
    """Its speed has no bound there, whatever the derivatives say."""
    model = fall(lambda t, x, v: -1.0, gap=lambda self, t, s: s.x - 0.1 * jnp.floor(t))
    asked = {"gap": (0, 1), "speed": (0, 1), "t": (0.5, 1.5)}
    assert hy.certify(model, asked).verdict == "undecided"
    assert hy.certify(model, {**asked, "t": (1.1, 1.9)}).verdict == "certified"


def test_a_curved_gap_is_bounded_over_the_states():
    """And what that leaves open is said."""
    model = fall(lambda t, x, v: -1.0, gap=lambda self, t, s: s.x + s.x**2)
    asked = {"gap": (0, 0.1), "speed": (0, 0.1), "x": (0.0, 0.1), "v": (-0.1, 0.1)}
    proof = hy.certify(model, asked)
    assert proof.verdict == "undecided"
    assert "that the motion stays in it is not proved" in proof.reason
    assert proof.m == pytest.approx(0.98, rel=1e-9)  # -(1 + 2 x) + 2 v^2 at x = 0, v = 0.1


# -- questions that cannot be asked -----------------------------------------------------


@pytest.mark.parametrize(
    ("model", "asked", "options", "message"),
    [
        (HardSpring(), {"y": (0, 1)}, {}, "HardSpring: box has 'y', which is no state; there are"),
        (HardSpring(), {"x": (2, 2.5)}, {}, "no bounds for 'v'; add 'v': \\(low, high\\)"),
        (HardSpring(), {"x": (2.5, 2), "v": (-1, 1)}, {}, "box x=\\(2.5, 2.0\\); two finite"),
        (HardSpring(), {"x": (2, math.inf), "v": (-1, 1)}, {}, "two finite bounds"),
        (HardSpring(), {"x": 2, "v": (-1, 1)}, {}, "box x=2; give \\(low, high\\)"),
        (HardSpring(), {"x": (2.2, 2.5), "v": (-1, 1)}, {}, "obstacle at 2 inward; give 'x'"),
        (HardSpring(), {"x": (1, 2), "v": (-1, 1)}, {}, "obstacle at 2 inward"),
        (HardSpring(), {"x": (2, 2.5), "v": (0, 1)}, {}, "speeds of both signs"),
        (HardSpring(), {}, {}, "give bounds by name"),
        (HardSpring(), SPRING, {"mode": "swim"}, "mode='swim'; there are flight"),
        (HardSpring(), SPRING, {"contact": "floor"}, "no such contact; there are impact"),
        (Thermostat(), {"T": (0, 1)}, {}, "Thermostat: there is no contact to certify"),
        (HardSpring(), {"gap": (0, 1)}, {}, "no bounds for 'speed'"),
        (HardSpring(), {"gap": (0.1, 1), "speed": (0, 1)}, {}, "a contact is at 0"),
        (BeadOnTable(), {"gap": (0, 1), "speed": (0, 1)}, {}, "no bounds for 't'"),
        (HardSpring, SPRING, {}, "give an instance"),
    ],
)
def test_slips_are_named(model, asked, options, message):
    """Model, value and remedy in one sentence."""
    with pytest.raises(hy.OptionError, match=message):
        hy.certify(model, asked, **options)


def test_a_contact_of_first_order_is_refused():
    """Its gap's speed is no state."""

    class Sink(hy.Automaton):
        x = hy.state()
        y = hy.state()

        @hy.mode
        def flow(self, t, s):
            return -1.0, s.x

        hit = hy.contact(flow, gap=lambda self, t, s: s.x, restitution=0.5)

    with pytest.raises(hy.OptionError, match="contact of second order"):
        hy.certify(Sink(), {"x": (0, 1), "y": (-1, 1)})


def test_a_hidden_derivative_is_refused():
    """Bounds by monotonicity would rest on a slope that is not the function's."""
    model = fall(lambda t, x, v: -2.0 + jax.lax.stop_gradient(jnp.sin(x)))
    with pytest.raises(hy.OptionError, match="stop_gradient hides a derivative"):
        hy.certify(model, box())


def test_without_flint_the_remedy_is_named(monkeypatch):
    """An extra, as for the others."""
    monkeypatch.setitem(sys.modules, "flint", None)
    with pytest.raises(hy.OptionError, match="a proof needs python-flint: pip install"):
        hy.certify(HardSpring(), SPRING)


def test_parameters_count_as_the_floats_they_are():
    """m is below 0.1 + 0.2 in exact arithmetic, not below its rounded sum."""
    model = fall(lambda t, x, v: -(jnp.float64(0.1) * np.float64(3.0)) + 0.0 * v)
    proof = hy.certify(model, box())
    assert proof.m < 0.1 * 3.0


#: Those that divide by their last argument, or by the size of both, in a branch not taken at 0.
DIVIDE = ("trigonometric", "angles")


def pushed(name, beside=0.0):
    """A fall under one of the expressions, its state ``beside`` it; and the box that is asked."""
    force = lambda t, x, v: 0.7 * EXPRESSIONS[name](t, x + beside, v + beside) - 9.0  # noqa: E731
    return force, fall(force, restitution=0.2), {"gap": (0, 0.5), "speed": (0, 0.6), "t": (0, 1)}


#: Those whose bounds take longest; the operations in them are in others too.
SLOW = ["clipping", "reductions", "derivatives"]


@pytest.mark.parametrize(
    "name", [*(name for name in EXPRESSIONS if name not in SLOW), *later(*SLOW)]
)
def test_bounds_hold_for_what_models_use(name):
    """Random values of every kind of force lie within the m and M that are reported."""
    force, model, asked = pushed(name, 0.7 if name in DIVIDE else 0.0)
    proof = hy.certify(model, asked)
    points = np.random.default_rng(7).uniform(
        [[0.0], [0.0], [-0.6]], [[1.0], [0.5], [0.6]], (3, 40)
    )
    values = jax.vmap(force)(*points).tolist()
    assert min(values) >= -proof.M - 1e-6  # values in single precision
    assert max(values) <= -proof.m + 1e-6


@pytest.mark.parametrize("name", [DIVIDE[1], *later(DIVIDE[0])])
def test_no_bound_is_told_where_a_branch_not_taken_divides_by_zero(name, monkeypatch):
    """On the box as it is: smaller ones are looked for in the same way."""
    monkeypatch.setattr(relative, "TRIALS", 1)
    _, model, asked = pushed(name)
    proof = hy.certify(model, asked)
    assert proof.verdict == "undecided"
    assert proof.m is None


def test_models_with_delays_are_refused():
    """By all that takes the present state for everything: in one sentence."""
    with pytest.raises(hy.OptionError, match=r"looks into the past \(lag tau\)"):
        hy.certify(Pyragas(), {"x1": (2.0, 2.5), "x2": (-7.0, 7.0)})
    with pytest.raises(hy.OrbitError, match="looks into the past"):
        hy.lyapunov(Pyragas(), {"x1": 2.0, "x2": 5.7}, (0.0, 8.0))
