"""Switchings: crossing, sliding by both flows, and the ends of sliding, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from models.dry_friction import DryFriction
from models.relay import START, Relay

from .switched import (
    Apart,
    Drawn,
    Fold,
    Planar,
    Pursuit,
    Quadrants,
    Relieved,
    Rings,
    StickSlip,
    Timed,
    TwoFold,
)

SOLVERS = ("scipy", "taylor", "diffrax")

#: Rounding of the state, and of a few hundred steps at rtol 1e-12.
TIGHT = {"rtol": 1e-12, "atol": 1e-12}
SMALL = 1e-10

UNTIL = (0.0, 21.0)


@pytest.fixture(params=SOLVERS)
def solver(request):
    return {"solver": request.param}


@pytest.fixture(params=SOLVERS)
def tight(request):
    return {"solver": request.param, **TIGHT}


@pytest.fixture
def wide():
    """JAX in 64 bits, as ``hy.as_function`` asks for."""
    with jax.enable_x64(True):
        yield


def modes(run):
    return [arc.mode for arc in run.arcs]


# -- the sliding field, and where it ends -------------------------------------------------


@pytest.mark.parametrize("options", [TIGHT, {}])
def test_a_forced_relay_slides_and_leaves_at_the_reference_times(solver, options):
    """Twelve hits and ends, to 1e-10; 1e-9 at the default rtol of 1e-8 for each step."""
    run = hy.simulate(Relay(w=1.0), START, UNTIL, **solver, **options)
    a, pi = np.arcsin(1 / 1.3), np.pi
    hits = [
        *(3.0988104769344734006, 6.1357968127068399705, 9.2773894662966332090),
        *(12.418982119886226447, 15.560574773476219686, 18.702167427066012924),
    ]
    exact = np.ravel(np.column_stack([hits, a + pi * np.arange(1, 7)]))
    assert run.jumps.edge.tolist() == ["relay", "relay.negative", "relay", "relay.positive"] * 3
    np.testing.assert_allclose(run.jumps.t, exact, rtol=0, atol=1e-10 if options else 1e-9)
    assert modes(run) == ["up", *["slide(relay)", "down", "slide(relay)", "up"] * 3][:13]
    assert run.zeno == []


@pytest.mark.parametrize(("mode", "y", "rate"), [("up", 0.3, 2.0), ("down", -0.3, 1.0)])
def test_the_surface_is_reached_from_either_side(tight, mode, y, rate):
    """On ``y = 0``: ``x' = (1 - 2 x) / 3``, from where each flow has led."""
    run = hy.simulate(Planar(), {"x": -1.0, "y": y}, (0, 3), mode=mode, **tight)
    hit = 0.3 / rate
    x0 = -1.0 + hit if mode == "up" else -np.exp(-hit)
    assert run.jumps.t == pytest.approx([hit], abs=1e-14)
    assert modes(run) == [mode, "slide(line)"]
    t = np.linspace(hit, 3.0, 50)
    exact = 0.5 + (x0 - 0.5) * np.exp(-2 * (t - hit) / 3)
    np.testing.assert_allclose(run(t).x, exact, rtol=0, atol=SMALL)
    assert run.final.y == 0.0


def test_a_state_stays_on_a_curved_surface(solver):
    """Angular speed 3/2 on the circle; at the default tolerances the circle is held to rounding."""
    run = hy.simulate(Rings(), {"x": 2.0, "y": 0.0}, (0, 60), **solver)
    t = np.linspace(1.0, 60.0, 400)
    angle = np.log(2) + 1.5 * (t - np.log(2))
    state = run(t)
    np.testing.assert_allclose(state.x**2 + state.y**2, 1.0, rtol=0, atol=1e-12)
    # Errors of single steps (1e-8) add up over 90 radians.
    np.testing.assert_allclose(state.x, np.cos(angle), rtol=0, atol=1e-6)


def test_a_moving_surface_is_followed_until_it_is_too_fast(tight):
    """``x = 2 sin t`` while ``2 |cos t| < 1``: the rate of the surface itself counts."""
    run = hy.simulate(Pursuit(), {"x": 2.0}, (1.0, 3.0), mode="above", **tight)
    hit, end = run.jumps.t
    assert 2.0 - (hit - 1.0) == pytest.approx(2 * np.sin(hit), abs=1e-12)
    assert end == pytest.approx(2 * np.pi / 3, abs=1e-12)
    assert run.jumps.edge.tolist() == ["target", "target.positive"]
    assert run(1.9).x == pytest.approx(2 * np.sin(1.9), abs=1e-13)
    assert run.final.x == pytest.approx(2 * np.sin(end) - (3.0 - end), abs=1e-11)


def test_a_body_sticks_to_a_belt_and_slips(tight):
    """From rest: ``x = 1 - cos t`` to the belt's speed, then on with it until ``x = mu``."""
    run = hy.simulate(DryFriction(belt=0.5), {"x": 0.0, "v": 0.0}, (0, 5), **tight)
    stick = np.pi / 6
    slip = stick + (1.0 - (1.0 - np.cos(stick))) / 0.5
    np.testing.assert_allclose(run.jumps.t, [stick, slip], rtol=0, atol=1e-11)
    assert modes(run) == ["slower", "slide(friction)", "slower"]
    assert run.final.x == pytest.approx(1.0 + 0.5 * np.sin(5 - slip), abs=SMALL)
    assert run(1.0).v == 0.5


def test_both_flows_through_the_surface_cross_it(tight):
    """A body turning against dry friction: a jump that leaves the state as it is."""
    run = hy.simulate(DryFriction(mu=0.4), {"x": 5.0, "v": 0.0}, (0, 12), **tight)
    turns = [5.0, 4.2, 3.4, 2.6]
    np.testing.assert_allclose(run.jumps.t, np.pi * np.arange(1, 4), rtol=0, atol=SMALL)
    np.testing.assert_allclose(np.abs(run.jumps.before.x), turns[1:], rtol=0, atol=SMALL)
    assert run.jumps.edge.tolist() == ["friction"] * 3
    assert np.all(run.jumps.before.x == run.jumps.after.x)
    assert modes(run) == ["slower", "faster", "slower", "faster"]


def test_a_stick_slip_oscillation_is_the_same_by_every_solver(tight):
    """Thirty sticks in 200 s; an attracting cycle, so that errors of steps do not add up."""
    exact = hy.simulate(StickSlip(), {"x": 0.0, "v": 0.0}, (0, 200), solver="taylor")
    run = hy.simulate(StickSlip(), {"x": 0.0, "v": 0.0}, (0, 200), **tight)
    assert len(run.jumps) > 50
    assert run.jumps.edge.tolist() == exact.jumps.edge.tolist()
    np.testing.assert_allclose(run.jumps.t, exact.jumps.t, rtol=0, atol=1e-9)


def test_no_run_hangs_or_leaves_its_side(tight):
    """Systems drawn at random: each arc stays on its side, or on the surface."""
    rng = np.random.default_rng(1)
    slid = 0
    for _ in range(12):
        A, b = rng.normal(size=(2, 3, 3)) - np.eye(3), rng.normal(size=(2, 3))
        run = hy.simulate(Drawn(A=A, b=b), {"q": [2.0, 0.1, -0.3]}, (0, 10), **tight)
        slid += "slide(bent)" in modes(run)
        for arc in run.arcs:
            q = arc.local(np.linspace(0.0, arc.length, 50))
            h = q[:, 0] + 0.3 * q[:, 1] ** 2
            sign = {"up": 1, "down": -1}.get(arc.mode, 0)
            size = np.abs(q).max() ** 2
            assert np.all(sign * h >= -1e-11 * size)
            assert sign or np.all(np.abs(h) <= 1e-11 * size)
    assert slid >= 3


def test_sliding_arcs_are_drawn_as_such():
    """The legend says which arcs slide."""
    figure = hy.simulate(Relay(w=1.0), START, UNTIL).plot()
    labels = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert "sliding" in labels


# -- starting on the surface --------------------------------------------------------------


@pytest.mark.parametrize("mode", ["up", "down", "slide(line)"])
def test_a_start_on_the_surface_slides(solver, mode):
    """By both flows, whichever of the modes is named."""
    run = hy.simulate(Planar(), {"x": 0.5, "y": 0.0}, (0, 1), mode=mode, **solver)
    assert modes(run)[-1] == "slide(line)"
    assert len(run.jumps) == (0 if mode == "slide(line)" else 1)
    assert (run.final.x, run.final.y) == pytest.approx((0.5, 0.0), abs=1e-15)


def test_a_start_on_the_surface_goes_where_both_flows_go(solver):
    """A body pulled by a spring stronger than friction moves, and needs no jump."""
    start, short = {"x": 5.0, "v": 0.0}, (0, 1)
    assert modes(hy.simulate(DryFriction(), start, short, **solver)) == ["slower"]
    other = hy.simulate(DryFriction(), start, short, mode="faster", **solver)
    assert modes(other) == ["faster", "slower"]
    assert other.jumps.t.tolist() == [0.0]


def test_a_start_with_two_ways_out_is_refused(solver):
    """What follows is not unique."""
    with pytest.raises(hy.StartError, match=r"on the surface of line.*both lead away from it"):
        hy.simulate(Apart(), {"x": 0.0, "y": 0.0}, (0, 1), **solver)


def test_a_tangent_flow_is_decided_by_its_next_derivative(tight):
    """At the fold ``a = 1``, ``b = -x``: the state slides by ``x' = 1 / (1 + x)``."""
    run = hy.simulate(Fold(), {"x": 0.0, "y": 0.0}, (0, 4), **tight)
    assert modes(run)[-1] == "slide(line)"
    assert run.final.x == pytest.approx(2.0, abs=SMALL)  # -1 + sqrt(1 + 2 t)


def test_two_tangent_flows_are_undecided(solver):
    """Both rates vanish: there is no convex combination to take."""
    with pytest.raises(hy.StartError, match="no first derivative decides"):
        hy.simulate(TwoFold(), {"x": 0.0, "y": 0.0}, (0, 1), **solver)


def test_a_start_on_the_wrong_side_names_the_other_mode(solver):
    """The surface is a guard of both modes."""
    with pytest.raises(hy.StartError, match=r"line is -1 and must be positive; there flows down"):
        hy.simulate(Planar(), {"x": 0.0, "y": -1.0}, (0, 1), **solver)


def test_a_start_to_slide_must_be_on_the_surface_and_held_there():
    """Off the surface, or where a flow leads away, there is no sliding."""
    with pytest.raises(hy.StartError, match=r"off the surface: it is 0\.2"):
        hy.simulate(Planar(), {"x": 0.0, "y": 0.2}, (0, 1), mode="slide(line)")
    with pytest.raises(hy.StartError, match=r"line.positive is 1 and must be negative"):
        hy.simulate(Apart(), {"x": 0.0, "y": 0.0}, (0, 1), mode="slide(line)")


# -- other rules --------------------------------------------------------------------------


def test_sliding_can_be_forbidden(solver):
    """slides=False: the error names the model, the mode, the switching and the remedies."""

    class Strict(Planar):
        line = hy.switching("up", "down", surface=lambda self, t, s: s.y, slides=False)

    with pytest.raises(hy.DomainError, match=r"Strict, mode up.*line both.*slides=True, or two"):
        hy.simulate(Strict(), {"x": 0.0, "y": 1.0}, (0, 1), **solver)


def test_edges_of_both_modes_are_watched_while_sliding(tight):
    """The alarm leaves one of the two modes; it fires at 2 though neither flows alone."""
    run = hy.simulate(Timed(), [0.5, 0.0], (0, 3), **tight)
    assert run.jumps.edge.tolist() == ["relay", "alarm"]
    np.testing.assert_allclose(run.jumps.t, [0.5, 2.0], rtol=0, atol=1e-12)
    assert run.final.x == pytest.approx(3.0, abs=1e-12)


def test_an_edge_may_leave_the_sliding_mode(tight):
    """Its guard bounds where the state may slide."""
    run = hy.simulate(Relieved(), [0.5, 0.0], (0, 3), **tight)
    assert run.jumps.edge.tolist() == ["relay", "relief"]
    assert run.final.x == pytest.approx(7.0 + 4.5, abs=1e-12)
    with pytest.raises(hy.DomainError, match=r"slide\(relay\).*relief is -0.4"):
        hy.simulate(Relieved(), [0.5, 1.4], (0, 3), **tight)


def test_a_second_surface_is_refused_while_sliding(solver):
    """Sliding north along x = 0 into y = 0: the error names both, and what to write."""
    with pytest.raises(hy.DomainError, match=r"mode slide\(north\).*surface of east too"):
        hy.simulate(Quadrants(), {"x": 0.5, "y": 1.0}, (0, 2), **solver)


def test_an_edge_leads_past_a_second_surface(solver):
    """An edge of the sliding mode comes first, and the state slides on along the other half."""

    class Led(Quadrants):
        south = hy.switching("south_east", "south_west", surface=lambda self, t, s: s.x)

        @hy.edge("slide(north)", to="south_east", guard=lambda self, t, s: s.y)
        def past(self, t, s):
            return s

    run = hy.simulate(Led(), {"x": 0.5, "y": 1.0}, (0, 2), **solver)
    assert run.jumps.edge.tolist() == ["north", "past", "south"]
    assert run.mode == "slide(south)"
    assert (run.final.x, run.final.y) == pytest.approx((0.0, -2.0), abs=1e-9)


def test_lanes_slide_as_runs_of_their_own_do():
    """Relays of several amplitudes: those of hy.simulate, mode by mode."""
    a = np.linspace(1.05, 2.0, 9)
    lanes = hy.ensemble(Relay(w=1.0), START, UNTIL, {"a": a}, rtol=1e-11, atol=1e-12)
    runs = [hy.simulate(Relay(w=1.0, a=v), START, UNTIL, solver="taylor") for v in a]
    assert lanes.jumps.values.tolist() == [len(run.jumps) for run in runs]
    assert lanes["mode"].values.tolist() == [run.mode for run in runs]
    np.testing.assert_allclose(lanes.x, [run.final.x for run in runs], rtol=0, atol=SMALL)


def test_lanes_end_undecided_where_the_driver_has_an_error():
    """Two surfaces at once; sliding forbidden."""

    class Strict(Planar):
        line = hy.switching("up", "down", surface=lambda self, t, s: s.y, slides=False)

    both = hy.ensemble(Quadrants(), {"x": 0.5, "y": np.array([1.0, 2.0])}, (0, 3))
    forbidden = hy.ensemble(Strict(), {"x": 0.0, "y": np.array([1.0, 2.0])}, (0, 3))
    assert {*both.status.values, *forbidden.status.values} == {"undecided"}
    slides = hy.ensemble(Planar(), {"x": 0.0, "y": np.zeros(2)}, (0, 1), mode="slide(line)")
    assert set(slides["mode"].values) == {"slide(line)"}


@pytest.mark.usefixtures("wide")
def test_derivatives_pass_through_sliding():
    """Sliding ends at ``pi + asin(1 / a)``; the end is ``a`` times a cosine plus lines in time."""
    relay = hy.as_function(Relay(w=1.0), t=(0.0, 5.0), max_jumps=4, max_steps=256, **TIGHT)

    def values(a):
        outcome = relay(Relay(w=1.0, a=a), START)
        return jnp.append(outcome.jumps.t[:2], outcome.final["x"])

    hit, left, slope = jax.jacfwd(values)(1.3)
    t, sine = 3.0988104769344734006, np.sqrt(1 - 1 / 1.3**2)
    assert hit == pytest.approx((1 - np.cos(t)) / (1 - 1.3 * np.sin(t)), abs=SMALL)
    assert left == pytest.approx(-1 / (1.3**2 * sine), abs=SMALL)
    # x = a (cos(left) - cos 5) + 5 - left; the state does not move where sliding ends.
    assert slope == pytest.approx(-sine - np.cos(5.0), abs=SMALL)


def test_a_sliding_run_is_kept_and_read_again(tmp_path):
    """At given times, and from a file."""
    t = np.linspace(0.0, 21.0, 43)
    whole = hy.simulate(Relay(w=1.0), START, UNTIL, **TIGHT)
    some = hy.simulate(Relay(w=1.0), START, UNTIL, save=t, **TIGHT)
    np.testing.assert_array_equal(some(t).x, whole(t).x)
    whole.save(tmp_path / "run.nc")
    again = hy.load(tmp_path / "run.nc")
    assert modes(again) == modes(whole)
    np.testing.assert_array_equal(again(t).x, whole(t).x)


def test_all_faults_of_switchings_are_reported_together():
    """Each names the switching and what would do instead."""
    with pytest.raises(hy.DeclarationError) as caught:

        class Bad(hy.Automaton):
            x = hy.state()
            v = hy.state()

            @hy.mode(initial=True)
            def up(self, t, s):
                return s.v, -1.0

            @hy.mode
            def down(self, t, s):
                return s.v, 1.0

            floor = hy.contact(up, gap=lambda self, t, s: s.x, restitution=0.5)
            one = hy.switching(up, "under", surface=lambda self, t, s: s.v)
            two = hy.switching(down, down, surface=lambda self, t, s: s.v)
            three = hy.switching(up, down, surface=lambda self, t, s: (s.x, s.v), slides="no")
            four = hy.switching(down, up, surface=lambda self, t: t)

            @hy.edge(up, to="slide(two)", guard=lambda self, t, s: s.v)
            def stick(self, t, s):
                return s

    text = str(caught.value)
    for part in (
        "switching one: negative='under' is no mode of this class; there are: up, down",
        "switching two: positive and negative are both 'down'",
        "switching three: slides='no'; give True or False",
        "switching three, surface: a value of shape (2,) where one number is due",
        "switching three: mode up has the contact floor",
        "switching four, surface: takes (self, t) where (self, t, s) is due",
        "switching four: its modes are already those of the switching three",
        "edge stick: to='slide(two)' is no mode of this class; there are: up, down, "
        "hy.TERMINATE; name one of the two modes",
    ):
        assert part in text
    assert len(caught.value.faults) == 10


class Rubbing(hy.Automaton):
    """A block that friction stops, with the sign written into the flow."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def slides(self, t, s):
        return s.v, -2.0 * jnp.sign(s.v) + 0.5 * jnp.sin(t)


def test_a_sign_that_holds_from_both_sides_is_refused():
    """The series would go through it; the message names what to declare, and where."""
    with pytest.raises(hy.FlowError, match=r"Rubbing, mode slides, t = 0\.53.* hy\.switching"):
        hy.simulate(Rubbing(), {"x": 0.0, "v": 1.0}, (0.0, 2.0), solver="taylor")
