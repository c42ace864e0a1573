"""Certificates: states beside the proof, restitutions of impacts, and reasons that are true."""

import jax.numpy as jnp
import pytest

import hybrid as hy

from .contract.ways import spread

FIXED = {"x": (0.0, 1.0), "v": (-5.0, 5.0)}
RELATIVE = {"gap": (0.0, 1.0), "speed": (0.0, 2.0)}

#: What asks for the theorem, and for the lemma.
BOXES = [FIXED, RELATIVE]


def beside(rate):
    """A ball with two states beside it that do not act on it; ``rate`` gives theirs."""

    class Beside(hy.Automaton):
        x = hy.state()
        v = hy.state()
        q = hy.state()
        p = hy.state()

        @hy.mode
        def flight(self, t, s):
            found = rate(t, s)
            return (s.v, -9.8, *found) if isinstance(found, tuple) else (s.v, -9.8, found, 0.0)

        hit = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)

    return Beside()


def fall(gap=lambda self, t, s: s.x, restitution=0.5, force=-9.8):
    """A ball under a constant force."""

    class Fall(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def flight(self, t, s):
            return s.v, force

        hit = hy.contact(flight, gap=gap, restitution=restitution)

    return Fall()


# -- states that the gap's acceleration does not use ---------------------------------------


#: Rates of a state beside the motion, and whose bounds are asked for.
ENDING = [
    (lambda t, s: s.q**2, "q"),
    (lambda t, s: -(s.q**2), "q"),
    (lambda t, s: 1e-12 * s.x * s.q**3, "q"),
    (lambda t, s: jnp.abs(s.q) ** 1.5, "q"),
    (lambda t, s: jnp.exp(s.q), "q"),
    (lambda t, s: jnp.where(s.q > 5.0, s.q**2, 0.0), "q"),
    (lambda t, s: -1.0 / (2.0 * s.q), "q"),
    (lambda t, s: jnp.sqrt(s.q) - 1.0, "q"),
    (lambda t, s: jnp.log(s.q), "q"),
    (lambda t, s: jnp.tan(s.q), "q"),
    (lambda t, s: 1.0 / (t - 1.0), "t"),
    (lambda t, s: (s.p, s.q**2), "q"),
    (lambda t, s: (s.p, s.q**3), "q"),
    (lambda t, s: (s.q * s.p, s.q * s.p), "q"),
    (lambda t, s: (jnp.exp(s.p) * s.q, s.q), "q"),
]


@pytest.mark.parametrize(("case", "box"), spread(ENDING, BOXES, of=2))
def test_a_state_that_may_end_the_motion_is_not_certified(case, box):
    """It blows up, or leaves the domain of its rate: undecided, with the state and the remedy."""
    rate, named = case
    proof = hy.certify(beside(rate), box)
    assert proof.verdict == "undecided"
    assert proof.reason.startswith("q")
    assert "may end the motion before the impacts accumulate" in proof.reason
    assert f"'{named}': (low, high)" in proof.repair
    assert proof.initial_set is None


LASTING = [
    lambda t, s: 0.0 * s.q,
    lambda t, s: 1.0,
    lambda t, s: 5.0 * s.q - 3.0 + s.x * s.v,
    lambda t, s: jnp.sin(s.q) * s.q + t,
    lambda t, s: -(s.q**3),
    lambda t, s: s.q * (1.0 - s.q**2),
    lambda t, s: s.q**4 / (1.0 + s.q**4) - s.q,
    lambda t, s: jnp.sqrt(1.0 + s.q**2) + jnp.log(1.0 + s.q**2) + jnp.tanh(s.q),
    lambda t, s: jnp.clip(s.q**3, -1.0, 1.0),
    lambda t, s: jnp.where(s.q > 0.0, -s.q, -2.0 * s.q),
    lambda t, s: jnp.exp(-(s.q**2)) * s.q,
    lambda t, s: (s.p, -s.q),
    lambda t, s: (s.p, -2.0 * s.q - 3.0 * s.p + 20.0 * s.v**2),
    lambda t, s: (s.p, s.q - s.q**3 - 0.1 * s.p + jnp.cos(t)),
    lambda t, s: (s.p, (1.0 - s.q**2) * s.p - s.q),
    lambda t, s: (jnp.exp(s.p) * s.q, -s.p),
    lambda t, s: (s.q * s.p, 1.0),
]


@pytest.mark.parametrize(("rate", "box"), spread(LASTING, BOXES, of=2))
def test_states_that_exist_for_ever_need_no_bounds(rate, box):
    """At most linear growth, dissipation, oscillators, clocks: nothing is asked of them."""
    assert hy.certify(beside(rate), box).verdict == "certified"


def test_bounds_of_a_state_that_blows_up_are_used():
    """They are not left within the time of the motion, from a set of starts that is smaller."""
    model = beside(lambda t, s: s.q**2)
    proof = hy.certify(model, {**FIXED, "q": (0.0, 0.1)})
    assert proof.verdict == "certified"
    low, high = proof.initial_set["q"]
    # the fall of 1, sqrt(2 / g), and flights whose lengths halve, from 2 r v / g on: together
    # sqrt(2 / g) (1 + 2 r / (1 - r)), at a rate of up to 0.1^2
    longest = (2.0 / 9.8) ** 0.5 * 3.0
    assert low == pytest.approx(0.01 * longest, rel=1e-6)
    assert high == pytest.approx(0.1 - 0.01 * longest, rel=1e-6)
    run = hy.simulate(model, {"x": 0.999, "v": 0.0, "q": high, "p": 0.0}, (0.0, 3.0))
    assert len(run.zeno) == 1
    wide = hy.certify(model, {**FIXED, "q": (0.0, 1e3)})
    assert wide.verdict == "undecided"
    assert "q may leave its bounds" in wide.reason


@pytest.mark.parametrize("box", [FIXED, RELATIVE], ids=["theorem", "lemma"])
def test_the_starts_of_a_certificate_by_bounds_keep_their_time(box):
    """``q' = q^2`` from the end of its set of starts exists longer than the motion lasts."""
    proof = hy.certify(beside(lambda t, s: s.q**2), {**box, "q": (-1.0, 1.0)})
    if proof.verdict == "certified":
        last = proof.initial_set["q"][1]
        lasts = proof.remaining[1] if proof.remaining else 1.36  # as above
        assert last + lasts * 1.0 <= 1.0  # the rate is at most 1 there
    else:
        assert "q may leave its bounds" in proof.reason


def test_a_pole_in_time_is_a_matter_of_bounds_of_time():
    """Before it or after it the motion is there; across it nothing is said."""
    model = beside(lambda t, s: 1.0 / (t - 1.0))
    for box in (FIXED, RELATIVE):
        proof = hy.certify(model, {**box, "t": (2.0, 10.0)})
        assert proof.verdict == "certified"
        assert proof.initial_set["t"][0] == 2.0
        assert proof.initial_set["t"][1] < 10.0
        assert hy.certify(model, {**box, "t": (0.0, 10.0)}).verdict == "undecided"


def test_a_state_whose_bounds_rest_on_anothers_asks_for_them():
    """``q' = q^2 p``: bounds of ``q`` alone bound nothing."""
    model = beside(lambda t, s: (s.q**2 * s.p, s.q))
    proof = hy.certify(model, {**FIXED, "q": (0.0, 0.1)})
    assert proof.verdict == "undecided"
    assert "'p': (low, high)" in proof.repair
    both = hy.certify(model, {**FIXED, "q": (0.0, 0.1), "p": (-1.0, 1.0)})
    assert both.verdict == "certified"
    assert set(both.initial_set) == {"x", "v", "q", "p"}


def test_a_repaired_box_does_not_forget_the_states_beside():
    """The smaller height of a refused box is no set of starts while ``q`` may blow up."""
    model = beside(lambda t, s: s.q**2)
    proof = hy.certify(model, {"x": (0.0, 1.0), "v": (-4.0, 4.0)})
    assert proof.verdict == "refuted"
    assert proof.initial_set is None
    assert "'q': (low, high)" in proof.repair


# -- the restitution of the impacts that there are -------------------------------------------


LAWS = [
    (lambda self, t, s, u: 0.8 + 0.05 * s.v, "certified"),
    (lambda self, t, s, u: 0.8 + 0.05 * u, "certified"),
    (lambda self, t, s, u: 0.5 + s.x, "certified"),
    (lambda self, t, s, u: 0.5 + 2.0 * s.x * s.v, "certified"),
    (lambda self, t, s, u: 0.5 - 0.1 * jnp.maximum(s.v, 0.0), "certified"),
    (lambda self, t, s, u: 0.5 + 0.1 * (u - s.v), "certified"),
    (lambda self, t, s, u: 1.2 + 0.05 * s.v, "refuted"),
    (lambda self, t, s, u: -0.1 - s.x, "refuted"),
    (lambda self, t, s, u: 0.9 - 0.2 * s.v, "refuted"),
    (lambda self, t, s, u: 1.0 + 0.1 * s.v, "undecided"),  # 1 at rest only: no impact
    (lambda self, t, s, u: jnp.where(s.v < 0.0, 0.5, 1.5), "undecided"),
    (lambda self, t, s, u: jnp.where(u < 0.0, 0.5, 0.0), "undecided"),
]


@pytest.mark.parametrize(("case", "box"), spread(LAWS, BOXES, of=2))
def test_only_impacts_have_a_restitution(case, box):
    """On the contact, moving into it: what the law says elsewhere decides nothing."""
    law, verdict = case
    proof = hy.certify(fall(restitution=law), box)
    assert proof.verdict == verdict, proof.reason


def test_a_ceiling_is_hit_by_rising_bodies():
    """Where the gap is ``1 - x``, impacts have ``v > 0``."""
    model = fall(
        gap=lambda self, t, s: 1.0 - s.x,
        restitution=lambda self, t, s, u: 0.8 - 0.05 * s.v,
        force=9.8,
    )
    assert hy.certify(model, {"x": (0.0, 1.0), "v": (-5.0, 5.0)}).verdict == "certified"


def test_a_moving_contact_has_its_impacts_where_it_is():
    """The law of ``x`` is asked where the table is, of ``v`` at speeds into it."""
    asked = {"gap": (0.0, 1.0), "speed": (0.0, 1.0), "t": (0.0, 2.0)}
    model = fall(
        gap=lambda self, t, s: s.x - 3.0 - 0.1 * t,
        restitution=lambda self, t, s, u: 0.5 + (s.x - 3.0 - 0.1 * t) + 0.2 * (s.v - 0.1),
    )
    proof = hy.certify(model, asked)
    assert proof.verdict == "certified"
    assert proof.restitution == pytest.approx((0.3, 0.5), abs=1e-9)


# -- reasons --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "moved",
    [
        lambda t: jnp.abs(t - 25.0),
        lambda t: jnp.sqrt(jnp.abs(t - 25.0)),
        lambda t: jnp.where(t > 25.0, 1.0, 0.0),
        lambda t: jnp.heaviside(t - 25.0, 0.5),
        lambda t: jnp.mod(t, 7.0),
        lambda t: jnp.arctan2(jnp.sin(t), jnp.cos(t)),
    ],
)
def test_a_gap_that_is_affine_is_not_said_to_be_none(moved):
    """What could not be shown of a table with kinks and jumps is its continuity."""
    asked = {"gap": (0.0, 1.0), "speed": (0.0, 1.0), "t": (20.0, 30.0)}
    proof = hy.certify(fall(gap=lambda self, t, s: s.x - 0.01 * moved(t)), asked)
    assert proof.verdict == "undecided"
    assert "continuous in time" in proof.reason
    assert "affine" not in proof.reason


def test_a_narrow_smooth_bump_of_a_table_is_decided():
    """A Gaussian of width 1e-5, so low that the table never falls away."""
    asked = {"gap": (0.0, 1.0), "speed": (0.0, 1.0), "t": (20.0, 30.0)}
    model = fall(gap=lambda self, t, s: s.x - 1e-11 * jnp.exp(-(((t - 25.0) / 1e-5) ** 2)))
    proof = hy.certify(model, asked)
    assert proof.verdict == "certified"
    assert pytest.approx(9.8 + 0.2, rel=0.03) == proof.M  # 2 A / width^2, at the top


def test_a_gap_of_two_positions_says_so():
    """A ball above another: the positions are named."""

    class Two(hy.Automaton):
        x = hy.state()
        v = hy.state()
        y = hy.state()
        w = hy.state()

        @hy.mode
        def flight(self, t, s):
            return s.v, -9.8, s.w, 0.0

        hit = hy.contact(flight, gap=lambda self, t, s: s.x - s.y, restitution=0.5)

    asked = {**RELATIVE, "x": (0.0, 1.0), "v": (-5.0, 5.0), "y": (0.0, 1.0), "w": (-1.0, 1.0)}
    proof = hy.certify(Two(), asked)
    assert proof.verdict == "undecided"
    assert "several positions (x, y)" in proof.reason
