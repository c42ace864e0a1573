"""Cycles of jumps that accumulate, and cycles that only look like it."""

import math
import re
from functools import cache

import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from scipy.special import zeta

import hybrid as hy
from hybrid.lowering.scene import scene_of
from hybrid.run import cycles
from hybrid.zeno.cycle import accelerated, limit, period
from hybrid.zeno.instant import Cascade, shrinking
from models.two_tanks import TwoTanks

from . import systems
from .contract.ways import spread
from .systems import PILES, Pile, Stacked, stacked

NAMES = ["scipy", "taylor", "diffrax"]
SOLVERS = pytest.mark.parametrize("solver", NAMES)


class Rocking(hy.Automaton):
    """A slender block that rocks from edge to edge (Housner 1963, small angles)."""

    angle = hy.state()
    rate = hy.state()

    p: float = hy.parameter(2.0)
    alpha: float = hy.parameter(0.25)
    r: float = hy.parameter(0.9)

    @hy.mode(initial=True)
    def right(self, t, s):
        return s.rate, self.p**2 * (s.angle - self.alpha)

    @hy.mode
    def left(self, t, s):
        return s.rate, self.p**2 * (s.angle + self.alpha)

    @hy.mode(limit_of=("to_left", "to_right"))
    def stands(self, t, s):
        return 0.0 * s.rate, 0.0 * s.angle

    @hy.edge(right, to=left, guard=lambda self, t, s: s.angle)
    def to_left(self, t, s):
        return 0.0 * s.angle, self.r * s.rate

    @hy.edge(left, to=right, guard=lambda self, t, s: s.angle, crossing=hy.RISING)
    def to_right(self, t, s):
        return 0.0 * s.angle, self.r * s.rate


class PowerLaw(hy.Automaton):
    """A ball whose loss fades with the speed: the n-th flight lasts 1/n^2."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def flight(self, t, s):
        return s.v, -2.0

    impact = hy.contact(
        flight,
        gap=lambda self, t, s: s.x,
        restitution=lambda self, t, s, u: 1.0 / (1.0 + jnp.sqrt(jnp.abs(u))) ** 2,
    )


class Tiring(PowerLaw):
    """One whose flights fall like ``n^-p``."""

    p: float = hy.parameter(1.1)

    impact = hy.contact(
        "flight",
        gap=lambda self, t, s: s.x,
        restitution=lambda self, t, s, u: (1.0 + jnp.abs(u) ** (1.0 / self.p)) ** -self.p,
    )


@pytest.mark.long
def test_the_search_for_the_error_of_a_slow_sum_ends():
    """The run to compare with, of tighter tolerances, does not come to the sum in a thousand
    impacts more; then there is no bound. The sum is zeta(1.1)."""
    run = hy.simulate(Tiring(), {"x": 0.0, "v": 1.0}, (0.0, 11.5), rtol=1e-10)
    assert run.zeno[0].t == pytest.approx(10.584448464950809, rel=1e-9)
    assert run.zeno[0].t_error == math.inf


class LateInflow(TwoTanks):
    """The inflow grows shortly before the tanks would have run down."""

    at: float = hy.parameter(19.99)

    @hy.mode(initial=True)
    def fills_first(self, t, s):
        return self.w + self.more(t) - self.v1, -self.v2

    @hy.mode
    def fills_second(self, t, s):
        return -self.v1, self.w + self.more(t) - self.v2

    def more(self, t):
        return 0.5 * (1.0 + jnp.tanh(2e3 * (t - self.at)))


class Draining(TwoTanks):
    """The inflow grows once what is left in both is ``least``."""

    least: float = hy.parameter(1e-8)

    @hy.mode(initial=True)
    def fills_first(self, t, s):
        return self.more(s) - self.v1, -self.v2

    @hy.mode
    def fills_second(self, t, s):
        return -self.v1, self.more(s) - self.v2

    def more(self, s):
        return jnp.where(s.x1 + s.x2 > self.least, self.w, 1.9)


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_a_law_that_has_changed_is_no_power_of_the_turns(solver):
    """Shortly before a limit durations fall by another ratio. All in all they then seem to fall
    like a power, and the bound was half of what that was off."""
    for least, w in np.random.default_rng(5).uniform([-8.5, 1.6], [-7.5, 1.85], (8, 2)).tolist():
        model, start = Draining(least=10**least, w=w, r1=0.0, r2=0.0), {"x1": 1.0, "x2": 0.5}
        run = hy.simulate(model, start, (0.0, 30.0), solver=solver)
        exact = (1.5 - model.least) / (2.0 - w) + model.least / 0.1
        (point,) = run.zeno
        assert abs(point.t - exact) <= point.t_error < 1e-7


class Twisting(hy.Automaton):
    """``x'' = -2 sign x - sign x'`` (Levant 1993): the origin after finitely much time."""

    x = hy.state()
    v = hy.state()

    @hy.mode(initial=True)
    def right_back(self, t, s):
        return s.v, -1.0

    @hy.mode
    def left_back(self, t, s):
        return s.v, 3.0

    @hy.mode
    def left_forth(self, t, s):
        return s.v, 1.0

    @hy.mode
    def right_forth(self, t, s):
        return s.v, -3.0

    @hy.mode(limit_of=("crosses_left", "turns_left", "crosses_right", "turns_right"))
    def rests(self, t, s):
        return 0.0 * s.x, 0.0 * s.v

    crosses_left = hy.switching(right_back, left_back, surface=lambda self, t, s: s.x)
    crosses_right = hy.switching(right_forth, left_forth, surface=lambda self, t, s: s.x)
    turns_left = hy.switching(left_forth, left_back, surface=lambda self, t, s: s.v)
    turns_right = hy.switching(right_forth, right_back, surface=lambda self, t, s: s.v)


@SOLVERS
def test_twisting_reaches_the_origin(solver):
    """A cycle of four switchings that are crossed: half turns shrink by 1/3 in x."""
    run = hy.simulate(Twisting(), {"x": 1.0, "v": 0.0}, (0, 9), rtol=1e-10, solver=solver)
    half = math.sqrt(2.0) + math.sqrt(2.0) / 3.0
    (point,) = run.zeno
    assert abs(point.t - half / (1.0 - math.sqrt(1 / 3))) <= point.t_error < 1e-8
    assert point.ratio == pytest.approx(1 / 3, rel=1e-6)
    assert run.mode == "rests"


@SOLVERS
def test_two_tanks(solver, reference):
    """Both reference cases: t_inf, levels, ratio; the bound holds and is not idle."""
    for case in reference["two_tanks"]:
        numbers = {name: float(case[name]) for name in ("w", "v1", "v2", "r1", "r2")}
        start = [float(case["x1(0)"]), float(case["x2(0)"])]
        exact = float(case["zeno_time=(x1+x2-r1-r2)/(v1+v2-w)"])
        run = hy.simulate(TwoTanks(**numbers), start, (0, 30), solver=solver, rtol=1e-9)
        (point,) = run.zeno
        assert point.edges == ("to_first", "to_second")
        assert abs(point.t - exact) <= point.t_error < 1e-10
        assert point.ratio == pytest.approx(float(case["ratio_over_two_switches"]), rel=1e-6)
        assert run.mode == "shares"
        switches = [float(t) for t in case["switch_times_first12"]]
        np.testing.assert_allclose(run.jumps.t[:12], switches, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("solver", "r"), spread(NAMES, [0.5, 0.9, 0.97]))
def test_a_rocking_block_comes_to_stand(solver, r):
    """The k-th swing lasts (2/p) atanh(r^k rate / (alpha p)): the sum is known."""
    run = hy.simulate(
        Rocking(r=r), {"angle": 0.0, "rate": 0.4}, (0, 60), rtol=1e-11, atol=1e-13, solver=solver
    )
    k = np.arange(5000)
    exact = math.fsum(np.arctanh(r**k * 0.4 / 0.5))
    (point,) = run.zeno
    assert point.ratio == pytest.approx(r * r, rel=1e-3)
    assert abs(point.t - exact) <= point.t_error < 1e-7
    assert run.mode == "stands"


@SOLVERS
def test_gaps_that_fall_like_the_square_accumulate(solver, reference):
    """Ratio 1, and yet a limit: pi^2 / 6; then the ball rests."""
    exact = float(reference["zeno_ratio_to_1"]["theta_inf=(2/(g c^2)) psi1(1/(c sqrt v0))=pi^2/6"])
    run = hy.simulate(PowerLaw(), {"x": 0.0, "v": 1.0}, (0, 3), rtol=1e-9, solver=solver)
    (point,) = run.zeno
    assert abs(point.t - exact) <= point.t_error < 1e-9
    assert point.ratio == 1.0
    assert run.mode == "flight.rest(impact)"
    assert "gaps that fall like a power" in run.explain()
    assert "found by sequence acceleration" in run.explain()


class Losing(PowerLaw):
    """A ball that loses ``a |v|^p`` of its speed."""

    a: float = hy.parameter(0.5)
    p: float = hy.parameter(0.2)

    impact = hy.contact(
        "flight",
        gap=lambda self, t, s: s.x,
        restitution=lambda self, t, s, u: 1.0 - self.a * jnp.abs(u) ** self.p,
    )


def losing(a, p, v, impacts):
    """The durations of the flights of such a ball from the floor, and how long the flights behind
    them take, from a series in ``v^p``: what is left behind ``v`` is ``v^(1 - p)`` times such a
    series, and what is left behind the next speed is less by that flight."""
    with mp.workdps(30):
        a, p, speeds = mp.mpf(a), mp.mpf(p), [mp.mpf(v)]
        while len(speeds) <= impacts or a * speeds[-1] ** p > 0.02:
            speeds.append(speeds[-1] * (1 - a * speeds[-1] ** p))

        def loss(k, power):
            return -mp.binomial(1 + (k - 1) * p, power) * (-a) ** power

        terms = []
        for k in range(14):
            known = sum(own * loss(j, k - j + 1) for j, own in enumerate(terms))
            terms.append(((k == 0) - known) / loss(k, 1))
        end = speeds.pop()
        left = sum(own * end ** (1 + (k - 1) * p) for k, own in enumerate(terms))
        left += mp.fsum(speeds[impacts:])
        return np.array(speeds[:impacts], dtype=float), float(left)


@pytest.mark.parametrize("p", [0.06, 0.1, 0.2, 1 / 3, 0.5, 0.7, 0.9])
def test_speeds_that_lose_a_power_of_themselves_are_summed_within_the_bound(p):
    """Their number has a logarithm in what is left to the limit. By it estimates were off by up to
    ten times their bounds."""
    for a, v in np.random.default_rng(6).uniform([0.2, 0.3], [0.9, 1.0], (8, 2)).tolist():
        for turns in (20, 40, 80, 160):
            spans, left = losing(a, p, v, turns)
            times, states = np.append(0.0, np.cumsum(spans)), np.append(spans, 0.0)[:, None]
            found = limit(("a",), times, states, 1e-6, 0.0)
            if found is not None:
                rounding = turns * np.spacing(times[-1])  # of the sums
                assert abs(found.remaining - left) <= found.t_error + rounding
                assert found.t_error <= 1e-6 * 2.0 * (times[-1] + left)


@pytest.mark.parametrize(
    ("solver", "p", "rtol"), spread(NAMES, [0.1, 0.2, 0.5, 0.7], [1e-8, 1e-10, 1e-12])
)
def test_a_ball_that_loses_a_power_of_its_speed_rests_within_the_bound(solver, p, rtol):
    """``t_error`` was up to 1.8 times too small, or there was no limit in 8000 impacts. The bound
    is of the size of the tolerance: rounding of one turn is repeated by those that count."""
    for a, v in np.random.default_rng(7).uniform([0.5, 0.5], [0.9, 1.0], (3, 2)).tolist():
        (first,), left = losing(a, p, v, 1)
        exact = first + left
        model, start = Losing(a=a, p=p), {"x": 0.0, "v": v}
        run = hy.simulate(model, start, (0.0, 2.0 * exact), rtol=rtol, solver=solver)
        (point,) = run.zeno
        assert abs(point.t - exact) <= point.t_error
        assert point.t_error <= 2.0 * max(rtol, 2e-10) * exact
        assert len(run.jumps) <= 100


@pytest.mark.parametrize("rtol", [1e-10, 1e-13])
@pytest.mark.parametrize("p", [0.6, 0.76, 0.82, 0.88])
def test_a_limit_is_as_exact_as_rounding_lets_it_be(p, rtol):
    """Doubles do not tell the limit as well as was asked. It was waited for, in vain or for ever,
    or the bound was infinite, as luck in the last digits would have it. A limit is taken where
    rounding leaves 1e-10 of it open: two runs, with what the errors of their jumps add, have 4e-10
    here, of which another processor may make more."""
    for a, v in np.random.default_rng(8).uniform([0.5, 0.5], [0.9, 1.0], (2, 2)).tolist():
        (first,), left = losing(a, p, v, 1)
        exact = first + left
        span = (0.0, 2.0 * exact)
        run = hy.simulate(Losing(a=a, p=p), {"x": 0.0, "v": v}, span, rtol=rtol, max_jumps=1000)
        (point,) = run.zeno
        assert abs(point.t - exact) <= point.t_error <= 2e-9 * exact


class Undefined(hy.Automaton):
    """Speeds 1, 1/2^p, 1/3^p, ...: a law that has no value for a body that leaves the floor."""

    x = hy.state()
    v = hy.state()
    p: float = hy.parameter(2.0, positive=True)

    @hy.mode
    def flight(self, t, s):
        return s.v, -2.0

    impact = hy.contact(
        flight,
        gap=lambda self, t, s: s.x,
        restitution=lambda self, t, s, u: (1.0 + (-u) ** (1.0 / self.p)) ** -self.p,
    )


class UndefinedEdge(hy.Automaton):
    """The same law, in the reset of an edge."""

    x = hy.state()
    v = hy.state()
    p: float = hy.parameter(2.0, positive=True)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -2.0

    @hy.mode(limit_of="strike")
    def rests(self, t, s):
        return 0.0, 0.0

    @hy.edge(flight, to=flight, guard=lambda self, t, s: s.x)
    def strike(self, t, s):
        return s.replace(x=0.0, v=-s.v * (1.0 + (-s.v) ** (1.0 / self.p)) ** -self.p)


@SOLVERS
@pytest.mark.parametrize("model", [Undefined, UndefinedEdge])
@pytest.mark.parametrize("p", [1.5, 2.0, 3.0])
def test_a_law_may_have_no_value_beyond_the_limit(model, p, solver):
    """The speed at the limit is found up to rounding, which may have either sign."""
    run = hy.simulate(model(p=p), {"x": 0.0, "v": 1.0}, (0.0, 3.0), rtol=1e-10, solver=solver)
    (point,) = run.zeno
    assert abs(point.t - zeta(p)) <= point.t_error < 1e-9
    assert len(run.jumps) < 100


@pytest.mark.parametrize("w", [2.0, 2.1])
def test_tanks_that_do_not_run_down(w):
    """Enough inflow: the visits last as long for ever, or longer."""
    run = hy.simulate(TwoTanks(w=w), {"x1": 8.0, "x2": 6.0}, (0, 200))
    assert not run.zeno
    assert len(run.jumps) > 10


@pytest.mark.parametrize("before", [1e-2, 1e-3, 1e-4])
def test_tanks_that_are_saved_at_the_last_moment(before):
    """Gaps shrink until just before the end that they point to; then the inflow grows."""
    model = LateInflow(at=20.0 - before)
    run = hy.simulate(model, {"x1": 8.0, "x2": 6.0}, (0, 22), rtol=1e-9)
    assert not run.zeno
    assert run.t1 == 22.0


def test_without_a_mode_to_go_on_in_the_run_stops():
    """The status says what to declare; zeno='raise' says what happened."""
    start = {"x1": 8.0, "x2": 6.0}
    run = hy.simulate(systems.BareTanks(), start, (0, 30))
    assert run.status is hy.Status.NO_REST
    assert "limit_of=" in str(run.status)
    assert run.t1 == pytest.approx(20.0, abs=1e-10)
    with pytest.raises(hy.ZenoError) as raised:
        hy.simulate(TwoTanks(), start, (0, 30), zeno="raise")
    before, t_inf, after = re.split(r"(?<=t_inf = )([-+.e\d]+)", str(raised.value))
    assert before == "TwoTanks: Jumps of to_first, to_second accumulate at t_inf = "
    assert float(t_inf) == pytest.approx(20.0, abs=1e-10)  # a hundredth of the tolerance, 1e-8
    assert after == (
        " with ratio 0.64; the limit was found by sequence acceleration (estimated). The run ended "
        "there (zeno='rest' goes on at rest, 'stop' ends the run, 'truncate' cuts the series, "
        "'raise' makes it an error)."
    )
    assert hy.simulate(TwoTanks(), start, (0, 30), zeno="stop").status is hy.Status.ZENO_STOPPED


def test_only_series_of_impacts_are_cut_off():
    """A cycle of edges passes its limit: jump by jump it would go on beyond, by rounding."""
    start, runs = {"x1": 8.0, "x2": 6.0}, []
    for zeno in ("rest", "truncate"):
        runs.append(hy.simulate(TwoTanks(), start, (0, 30), solver="taylor", zeno=zeno))
    rests, cut = runs
    assert cut.status is hy.Status.REACHED_END
    assert cut.mode == "shares"
    assert cut.zeno[0].t == pytest.approx(rests.zeno[0].t, abs=rests.zeno[0].t_error)
    assert [float(x) for x in cut.final] == pytest.approx([float(x) for x in rests.final])


def test_a_limit_of_unknown_edges_is_a_fault():
    """The declaration names the mode and what there is."""
    with pytest.raises(hy.DeclarationError, match=r"limit_of=.*'gone' is no edge; there are: go"):

        class Lost(hy.Automaton):
            x = hy.state()

            @hy.mode(initial=True)
            def one(self, t, s):
                return (-1.0 + 0.0 * s.x,)

            @hy.mode(limit_of=("gone",))
            def two(self, t, s):
                return (0.0 * s.x,)

            @hy.edge(one, to=two, guard=lambda self, t, s: s.x)
            def go(self, t, s):
                return s


@pytest.mark.parametrize(
    ("terms", "accumulates"),
    [
        (lambda k: k**-1.0, False),
        (lambda k: k**-1.05, False),
        (lambda k: k**-1.2, True),
        (lambda k: k**-3.0, True),
        (lambda k: 0.3**k, True),
        (lambda k: 0.99**k, True),
        (lambda k: 0.1 + 0.5**k, False),
        (lambda k: 1.0 / (k * np.log(k + 1.0)), False),
    ],
)
def test_which_sequences_have_a_sum(terms, accumulates):
    """Powers just below and just above 1, geometric ones, ones that tend to something else."""
    k = np.arange(1.0, 2001.0)
    times = np.concatenate([[0.0], np.cumsum(terms(k))])
    states = np.append(terms(k), 0.0)[:, None]
    found = [limit(("e",), times[:n], states[:n], 1e-8, 0.0) for n in (10, 30, 60, 200, 2000)]
    assert any(f is not None for f in found) == accumulates


def test_the_shortest_period_is_found():
    """Of one edge, of two, of three with a repetition in it; of none."""
    assert period(["a"] * 20) == 1
    assert period(["a", "b"] * 10) == 2
    assert period(["a", "a", "b"] * 10) == 3
    assert period(list("abcdefghij") * 2) == 0


class Box(hy.Automaton):
    """A body that falls into a corner; each wall has its own restitution."""

    u = hy.state()
    w = hy.state()
    du = hy.state()
    dw = hy.state()

    r1: float = hy.parameter(0.6)
    r2: float = hy.parameter(0.6)

    @hy.mode
    def falls(self, t, s):
        return s.du, s.dw, -1.0, -1.0

    one = hy.contact(falls, gap=lambda self, t, s: s.u, restitution="r1")
    other = hy.contact(falls, gap=lambda self, t, s: s.w, restitution="r2")


@SOLVERS
@pytest.mark.parametrize(("height", "r2"), [(1.0, 0.6), (1.5, 0.6), (0.5, 0.8), (0.25, 7 / 9)])
def test_two_contacts_close_one_after_the_other_or_at_once(solver, height, r2):
    """Together in step, one after the other, and at one instant from different series."""
    run = hy.simulate(Box(r2=r2), [1.0, height, 0.0, 0.0], (0, 20), solver=solver, rtol=1e-10)
    ends = [math.sqrt(2 * h) * (1 + r) / (1 - r) for h, r in ((1.0, 0.6), (height, r2))]
    found = [point.t for point in run.zeno]
    expected = sorted(ends) if abs(ends[0] - ends[1]) > 1e-9 else [ends[0]]
    assert found == pytest.approx(expected, abs=1e-10)
    assert run.mode == "falls.rest(one, other)"
    assert all(point.t_error < 1e-8 for point in run.zeno)


class Shelf(Box):
    """The same corner, with a third coordinate that lies on a shelf all the while."""

    h = hy.state()
    dh = hy.state()

    @hy.mode
    def falls(self, t, s):
        return s.du, s.dw, -1.0, -1.0, s.dh, -1.0

    shelf = hy.contact("falls", gap=lambda self, t, s: s.h, restitution=0.5)


@SOLVERS
def test_a_contact_held_before_is_held_after(solver):
    """Two contacts close at once while a third has been closed from the start."""
    start = [1.0, 1.0, 0.0, 0.0, 0.0, 0.0]
    run = hy.simulate(Shelf(), start, (0, 9), solver=solver, mode="falls.rest(shelf)")
    assert run.zeno[0].t == pytest.approx(math.sqrt(2.0) * 4.0, abs=1e-9)
    assert set(run.mode.removeprefix("falls.rest(").removesuffix(")").split(", ")) == {
        *("one", "other", "shelf")
    }
    assert run.final.h == 0.0


def test_what_max_jumps_has_cut_off_is_explained():
    """A cycle on its way to its limit, with the limit predicted; one that goes nowhere."""
    run = hy.simulate(TwoTanks(), {"x1": 8.0, "x2": 6.0}, (0, 30), max_jumps=20)
    assert "to_second, to_first" in run.explain()
    assert "0.64 times the one before it" in run.explain()
    assert "accumulate at about t = 20." in run.explain()
    steady = hy.simulate(TwoTanks(w=2.0), {"x1": 8.0, "x2": 6.0}, (0, 200), max_jumps=20)
    assert "do not accumulate" in steady.explain()


@SOLVERS
@pytest.mark.parametrize(
    "case",
    [
        (0.8, 0.3, 1.0, 1.2, 0.0, 0.0),
        (0.25, 0.44, 0.98, 1.27, 0.0, -0.89),  # they meet where the lower one has all but stopped
        (0.74, 0.61, 0.79, 0.85, 0.0, 0.0),  # a cycle that is slow to settle
        (0.68, 0.79, 1.0, 1.04, 1.4, -0.42),  # the lower one stops again and again
        (0.29, 0.56, 1.0, 1.23, -1.58, -0.23),
        (0.0, 0.9, 1.0, 1.12, -0.74, 1.57),
    ],
)
def test_two_beads_come_to_rest_together(solver, case):
    """Impacts on the floor and between the beads accumulate, and sums of them; both rest."""
    a, b, *start = case
    run = hy.simulate(Stacked(a=a, b=b), start, (0, 9), rtol=1e-11, solver=solver)
    assert run.zeno[-1].t == pytest.approx(stacked(*case), abs=1e-9)  # what the exact one leaves
    assert run.mode == "falls.rest(floor, between)"
    assert run.final.x == pytest.approx(0.0, abs=1e-12)
    assert run.final.y == pytest.approx(0.0, abs=1e-12)


@SOLVERS
@pytest.mark.parametrize("gap", [0.0, 1e-19, 1e-15, 1e-12])
@pytest.mark.parametrize("speed", [-1e-11, 1e-12, 1e-10])
def test_beads_that_barely_move_come_to_rest(solver, gap, speed):
    """From gaps of rounding, above a bead that rests: no impact is lost."""
    start, until = [0.0, gap, 0.0, speed], (0.0, 0.05)
    run = hy.simulate(Stacked(), start, until, mode="falls.rest(floor)", rtol=1e-11, solver=solver)
    assert run.mode == "falls.rest(floor, between)"
    assert run.final.y == pytest.approx(0.0, abs=1e-12)


@SOLVERS
def test_beads_thrown_up_together_fly_together(solver):
    """In the air nothing presses them together and nothing parts them: they stay in contact."""
    model, start = Pile(), [0.0, 0.0, 1.2, 1.2]
    mode = "falls.rest(floor, between)"
    run = hy.simulate(model, start, (0, 0.15), mode=mode, rtol=1e-11, solver=solver)
    leaves = math.asin(9.81 / (0.1 * 12.0**2)) / 12.0
    x, v = 0.1 * math.sin(12.0 * leaves), 1.2 * math.cos(12.0 * leaves)
    assert run.jumps.edge.tolist() == ["floor.release"]
    assert run.jumps.t[0] == pytest.approx(leaves, abs=1e-10)
    assert run.mode == "falls.rest(between)"
    s = 0.15 - leaves
    assert run.final.x == run.final.y == pytest.approx(x + v * s - 0.5 * 9.81 * s * s, abs=1e-9)


class Three(hy.Automaton):
    """Three equal beads over a floor: where they strike in turns no time passes."""

    x = hy.state(shape=(3,))
    v = hy.state(shape=(3,))
    a: float = hy.parameter(0.25)
    b: float = hy.parameter(0.01)
    c: float = hy.parameter(0.58)

    @hy.mode
    def falls(self, t, s):
        return s.v, jnp.full(3, -9.81)

    low = hy.contact(falls, gap=lambda self, t, s: s.x[0], restitution="a")
    middle = hy.contact(falls, gap=lambda self, t, s: s.x[1] - s.x[0], restitution="b")
    high = hy.contact(falls, gap=lambda self, t, s: s.x[2] - s.x[1], restitution="c")


@SOLVERS
@pytest.mark.parametrize("r", [(0.25, 0.01, 0.58), (0.02, 0.68, 0.48), (0.4, 0.4, 0.4)])
def test_impacts_of_one_instant_that_slow_down_end(solver, r):
    """A bead falls on others at rest: hundreds of impacts at one time are no loop."""
    model = Three(**dict(zip("abc", r, strict=True)))
    start = {"x": np.array([1.0, 1.22, 1.47]), "v": np.zeros(3)}
    run = hy.simulate(model, start, (0, 9), rtol=1e-10, solver=solver)
    assert run.mode == "falls.rest(low, middle, high)"
    np.testing.assert_allclose(run.final.x, 0.0, atol=1e-12)


@cache
def pile(case, **options):
    """Two beads, thrown up together by a table."""
    a, b, size, omega, y = case
    model = Pile(a=a, b=b, size=size, omega=omega)
    return hy.simulate(model, [1.0, y, 0.0, 0.0], (0, 5), rtol=1e-11, **options)


@pytest.mark.long
@pytest.mark.parametrize(("solver", "case"), spread(NAMES, PILES))
def test_a_pile_on_a_shaking_table(solver, case):
    """Thrown up and at rest again: no bead falls through, whatever the method."""
    _, _, size, omega, _ = case
    other, run = pile(case, method="RK45"), pile(case, solver=solver)
    assert "falls.rest(floor, between)" in {arc.mode for arc in run.arcs}
    assert run.mode == other.mode
    assert run.final.x == pytest.approx(other.final.x, abs=1e-8)
    assert run.final.y == pytest.approx(other.final.y, abs=1e-8)
    t = np.linspace(0.0, 5.0, 2001)
    beads = run(t)
    assert min(beads.x - size * np.sin(omega * t)) > -1e-10
    assert min(beads.y - beads.x) > -1e-10


@pytest.mark.parametrize(("ratio", "found"), [(0.05, True), (0.12, True), (0.2, False)])
def test_a_fast_cycle_needs_few_turns(ratio, found):
    """Five closings, a few of them in a row: enough if each turn is an eighth of the one before."""
    k = np.arange(5.0)
    times, states = (1.0 - ratio**k) / (1.0 - ratio), np.column_stack([ratio**k, 1.0 + ratio**k])
    point = limit(("e",), times, states, 1e-8, 0.0)
    assert (point is not None) == found
    if point is not None:
        exact = 1.0 / (1.0 - ratio) - times[-1]
        assert abs(point.remaining - exact) <= point.t_error < 1e-13
        assert point.x_inf == pytest.approx([0.0, 1.0], abs=1e-14)


@pytest.mark.parametrize(("ratio", "count"), [(0.05, 10), (0.5, 20)])
def test_a_state_that_only_changes_sign_has_no_limit(ratio, count):
    """Its sum has a value in between; at every other jump it has a limit."""
    k = np.arange(float(count))
    times, states = (1.0 - ratio**k) / (1.0 - ratio), ((-1.0) ** k)[:, None]
    assert limit(("e",), times, states, 1e-8, 0.0) is None
    point = limit(("e",), times[1::2], states[1::2], 1e-8, 0.0)
    assert point is not None
    assert point.x_inf == pytest.approx([-1.0], abs=1e-12)


def test_a_count_has_no_limit():
    """Nor what grows as long as the cycle goes on."""
    k = np.arange(40.0)
    times = 1.0 - 0.5**k
    assert limit(("e",), times, k[:, None], 1e-8, 0.0) is None
    assert limit(("e",), times, np.sqrt(k)[:, None], 1e-8, 0.0) is None


def sequences():
    """Times of jumps: chaotic ones, such as fall, such as fall fast for a while, and equal ones."""
    rng = np.random.default_rng(3)
    yield np.cumsum(rng.uniform(0.1, 1.0, 900))
    yield np.cumsum(0.97 ** np.arange(300))
    yield np.cumsum(np.concatenate([rng.uniform(1, 2, 50), 0.1 ** np.arange(9), np.ones(60)]))
    yield np.arange(400.0)


@pytest.mark.parametrize("t", list(sequences()))
@pytest.mark.parametrize("most", [1 << 14, 64])
def test_looks_are_due_whether_jumps_come_singly_or_in_rows(t, most, monkeypatch):
    """The same jumps are remembered, and a limit is looked for at the same of them."""
    monkeypatch.setattr(cycles, "REMEMBERED_JUMPS", most)
    edges, modes = np.array([["ab"[k % 2] for k in range(len(t))], ["m"] * len(t)], dtype=object)
    low, states = 1e-18 * np.sin(t), np.array([t, np.cos(t)]).T
    jumps = cycles.Columns(edges, modes, t, low, t, states)
    one, rows = cycles.Cycles(), cycles.Cycles()
    one.longest = rows.longest = 1.0
    due = [k + 1 for k in range(len(t)) if one.saw(jumps.part(slice(k, k + 1)))]
    found, begin, calls = [], 0, 0
    while begin < len(t):
        calls, end = calls + 1, begin + rows.room(t[begin:], low[begin:])
        if rows.saw(jumps.part(slice(begin, end))):
            found.append(end)
        begin = end
    assert found == due
    assert calls == 1 or due or most < len(t)
    assert all(map(np.array_equal, one.seen, rows.seen))
    assert np.array_equal(rows.seen.t, t[-len(rows.seen.t) :])


@pytest.mark.parametrize(
    "kind", ["geometric", "of two sequences", "of a map", "with a sign that alternates"]
)
def test_no_estimate_is_taken_for_better_than_it_is(kind):
    """Sequences with a known limit and the rounding of times: where a table has come to its limit,
    its next columns are made of rounding, and may agree with one another far from it."""
    draw, taken = np.random.default_rng(5), 0
    for _ in range(1500):
        k, q, part = np.arange(draw.integers(7, 40)), draw.uniform(0.15, 0.97), draw.uniform(-1, 1)
        other = q * draw.uniform(0.2, 0.95)
        away = {
            "geometric": q**k,
            "of two sequences": q**k + 0.4 * part * other**k,
            "of a map": q**k * (1.0 + 0.3 * part * q**k + 0.2 * draw.uniform(-1, 1) * q ** (2 * k)),
            "with a sign that alternates": q**k + 0.3 * part * (-other) ** k,
        }[kind]
        limit_of = draw.uniform(0, 10) + away[0]
        seen = (limit_of - away) * (1.0 + 1e-16 * draw.integers(-2, 3, len(k)))
        value, error, scale, _ = accelerated(seen[:, None], None)
        if error[0] <= 1e-12 * scale[0]:
            taken += 1
            assert abs(value[0] - limit_of) <= max(error[0], 1e-11 * scale[0])
    assert taken > 500


@pytest.mark.parametrize("rtol", [1e-6, 1e-9, 1e-14])
def test_a_sum_of_many_near_ratios_is_within_its_bound(rtol):
    """Speeds that lose ``1 - r0 - r1 v^q`` of themselves, for small q: where estimates agree by
    chance, those of one term less do not."""
    draw = np.random.default_rng(8)
    for _ in range(80):
        r0, q = draw.uniform(0.1, 0.85), draw.choice([0.1, 0.15, 0.2, 0.3, 0.4, 0.5])
        r1, speeds = draw.uniform(-0.09, 0.95 - r0), [1.0]
        while speeds[-1] > 1e-20:
            speeds.append(speeds[-1] * (r0 + r1 * speeds[-1] ** q))
        times, states = np.append(0.0, np.cumsum(speeds)), np.append(speeds, 0.0)[:, None]
        looks = (limit(("a",), times[:k], states[:k], rtol, 0.0) for k in range(8, len(speeds), 2))
        turns, found = next((k, found) for k, found in enumerate(looks) if found)
        left = math.fsum(speeds[2 * turns + 7 :])
        # times are sums, each off by its rounding
        assert abs(found.remaining - left) <= found.t_error + 1e-15 * times[-1]


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
@pytest.mark.parametrize(
    ("w", "v2"),
    [(1.5750576998639327, 0.9412971824925387), (1.5314734655055463, 0.9076897712723518)],
)
def test_the_limit_of_tanks_is_that_of_their_total_level(w, v2, solver):
    """It falls evenly. Of the sequence's own estimates some were far beyond, with a small error."""
    model, start, t_inf = TwoTanks(w=w, v2=v2), {"x1": 8.0, "x2": 6.0}, 4.0 / (1.0 + v2 - w)
    run = hy.simulate(model, start, (0.0, 27.0), solver=solver)
    assert abs(run.zeno[0].t - t_inf) <= run.zeno[0].t_error <= 1e-11
    lanes = hy.ensemble(model, {"x1": np.array([8.0]), "x2": 6.0}, (0.0, 27.0), solver=solver)
    assert abs(float(lanes.t_inf[0]) - t_inf) <= float(lanes.t_inf_error[0]) <= 1e-11


class Counted(hy.Automaton):
    """A ball on a shelf that moves evenly, and an event at the top of each flight."""

    x = hy.state()
    v = hy.state()
    n = hy.discrete(0)
    r: float = hy.parameter(0.5)
    height: float = hy.parameter(0.0)
    speed: float = hy.parameter(0.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -8.0

    impact = hy.contact(
        flight, gap=lambda self, t, s: s.x - self.height - self.speed * t, restitution="r"
    )

    @hy.edge(flight, guard=lambda self, t, s: s.v - self.speed, crossing=hy.FALLING)
    def top(self, t, s):
        return s.replace(n=s.n + 1)


@pytest.mark.long
@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize("speed", [0.0, 0.5])
@pytest.mark.parametrize("height", [0.0, 20.0, -600.0, 900.0])
def test_impacts_with_an_event_at_the_top_of_each_flight_have_their_limit(solver, speed, height):
    """Far from zero the rounding of the gap shows in the times of slow impacts; a second run then
    may not see the limit, and nothing is said of its error."""
    for r in (0.4, 0.5, 0.65, 0.8, 0.88):
        model, start = Counted(r=r, height=height, speed=speed), {"x": height + 1.0, "v": speed}
        run = hy.simulate(model, start, (0.0, 12.0), solver=solver, rtol=1e-10)
        (point,) = run.zeno
        off = abs(point.t - 0.5 * (1.0 + r) / (1.0 - r))
        assert off <= point.t_error, r
        assert point.t_error < 1e-7 or abs(height) > 20.0, r
        assert off < 1e-7, r
        assert run.mode == "flight.rest(impact)"


class Turning(hy.Automaton):
    """A ball on a shelf, and an event wherever its speed is zero, as it is at rest."""

    x = hy.state()
    v = hy.state()
    n = hy.discrete(0)
    r: float = hy.parameter(0.5)
    height: float = hy.parameter(0.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -8.0

    impact = hy.contact(flight, gap=lambda self, t, s: s.x - self.height, restitution="r")

    @hy.edge(flight, guard=lambda self, t, s: s.v)
    def top(self, t, s):
        return s.replace(n=s.n + 1)


@pytest.mark.long
@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize("height", [0.0, 94.5, 253.3, -232.6, -285.0])
def test_an_event_that_rest_keeps_at_zero_does_not_happen_there(solver, height):
    """Rounding ends the flights, be it before or behind the last event."""
    for r in np.linspace(0.05, 0.9, 18).tolist():
        model, start = Turning(r=r, height=height), {"x": height + 1.0, "v": 0.0}
        run = hy.simulate(model, start, (0.0, 12.0), solver=solver)
        (point,) = run.zeno
        assert abs(point.t - 0.5 * (1.0 + r) / (1.0 - r)) <= point.t_error, r
        assert run.mode == "flight.rest(impact)"


class Narrow(hy.Automaton):
    """A ball between a floor that rises and a wall that comes near it and goes again."""

    x = hy.state()
    v = hy.state()
    least: float = hy.parameter(1e-8)

    @hy.mode
    def flight(self, t, s):
        return s.v, 0.0 * s.v

    floor = hy.contact(flight, gap=lambda self, t, s: s.x - 0.3 * t, restitution=1.0)
    wall = hy.contact(
        flight, gap=lambda self, t, s: 0.3 * t + self.least + (1.0 - t) ** 2 - s.x, restitution=0.5
    )


@SOLVERS
@pytest.mark.parametrize(
    ("least", "rtol"), [(1e-7, 1e-6), (2e-8, 1e-6), (1e-9, 1e-8), (1e-10, 1e-10)]
)
def test_walls_that_come_near_and_do_not_touch_have_no_limit(least, rtol, solver):
    """The gap that they leave is below the tolerance, and known far better than that: the states
    behind impacts lie on the walls. In the frame of the floor nothing is small."""
    start = {"x": 0.6, "v": -0.7}
    run = hy.simulate(Narrow(least=least), start, (0.0, 1.5), solver=solver, rtol=rtol)
    assert not run.zeno
    assert run.status is hy.Status.REACHED_END
    fine = hy.simulate(Narrow(least=least), start, (0.0, 1.5), solver=solver, rtol=1e-13)
    assert len(run.jumps) == len(fine.jumps)
    assert run.final.x == pytest.approx(fine.final.x, abs=1e-3)


class DeadBeside(hy.Automaton):
    """A ball whose gravity changes at each impact, beside one that may lie dead on its floor."""

    x = hy.state()
    v = hy.state()
    y = hy.state()
    w = hy.state()
    r: float = hy.parameter(0.0)

    @hy.mode(initial=True)
    def light(self, t, s):
        return s.v, -1.0, s.w, -1.0

    @hy.mode
    def heavy(self, t, s):
        return s.v, -2.0, s.w, -1.0

    @hy.mode(limit_of=("to_heavy", "to_light"))
    def rest(self, t, s):
        return 0.0 * s.v, 0.0 * s.v, s.w, -1.0

    @hy.edge(light, to=heavy, guard=lambda self, t, s: s.x)
    def to_heavy(self, t, s):
        return s.replace(v=-0.5 * s.v)

    @hy.edge(heavy, to=light, guard=lambda self, t, s: s.x)
    def to_light(self, t, s):
        return s.replace(v=-0.5 * s.v)

    on_light = hy.contact(light, gap=lambda self, t, s: s.y, restitution="r")
    on_heavy = hy.contact(heavy, gap=lambda self, t, s: s.y, restitution="r")
    on_rest = hy.contact(rest, gap=lambda self, t, s: s.y, restitution="r")


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
@pytest.mark.parametrize("r", [0.0, 0.3])
@pytest.mark.parametrize("y", np.linspace(0.3, 5.0, 12).tolist())
def test_a_body_may_lie_dead_beside_a_limit(solver, r, y):
    """The impact that leaves it no speed may be the last on its floor before the limit, or be on
    the floor of the other mode. Two flights of half the time of the fall lead to a quarter."""
    limit = math.sqrt(2.0) * 7.0 / 3.0
    run = hy.simulate(DeadBeside(r=r), [1.0, 0.0, y, 0.0], (0.0, 6.0), solver=solver)
    point = next(point for point in run.zeno if len(point.edges) == 2)
    assert abs(point.t - limit) <= point.t_error <= 1e-8
    assert r > 0.0 or (run.mode == "rest.rest(on_rest)" and run.final.y == 0.0)


class Geared(hy.Automaton):
    """Two balls, each of which changes gravity and restitution with each of its impacts."""

    x = hy.state()
    v = hy.state()
    y = hy.state()
    w = hy.state()
    n = hy.discrete(0)
    m = hy.discrete(0)
    g = hy.parameter(np.ones(2))
    h = hy.parameter(np.ones(2))
    r = hy.parameter(np.ones(2))
    q = hy.parameter(np.ones(2))

    @hy.mode(initial=True)
    def both(self, t, s):
        return s.v, -jnp.where(s.n == 0, *self.g), s.w, -jnp.where(s.m == 0, *self.h)

    @hy.mode(limit_of="on_first")
    def one(self, t, s):
        return 0.0, 0.0, s.w, -jnp.where(s.m == 0, *self.h)

    @hy.mode(limit_of="on_last")
    def none(self, t, s):
        return 0.0, 0.0, 0.0, 0.0

    @hy.edge(both, to=both, guard=lambda self, t, s: s.x)
    def on_first(self, t, s):
        return s.replace(v=-jnp.where(s.n == 0, *self.r) * s.v, n=1 - s.n)

    @hy.edge(both, to=both, guard=lambda self, t, s: s.y)
    def on_second(self, t, s):
        return s.replace(w=-jnp.where(s.m == 0, *self.q) * s.w, m=1 - s.m)

    @hy.edge(one, to=one, guard=lambda self, t, s: s.y)
    def on_last(self, t, s):
        return s.replace(w=-jnp.where(s.m == 0, *self.q) * s.w, m=1 - s.m)


def geared_limit(g, r, x):
    """The fall from a height, then flights in turns of both gears."""
    u = math.sqrt(2.0 * g[0] * x)
    first, second = 2.0 * r[0] * u / g[1], 2.0 * r[0] * r[1] * u / g[0]
    return u / g[0] + (first + second) / (1.0 - r[0] * r[1])


@pytest.mark.long
@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_what_is_not_known_at_a_limit_is_not_known_behind_it(solver):
    """A ball that is flying at the limit of the other is known there to 2e-13, and its next slow
    impact makes 1e-11 of that, which no second run shows that has come through the same limit."""
    draw = np.random.default_rng(9)
    for _ in range(8):
        later, x = 10.0 ** -draw.uniform(1.0, 5.0), draw.uniform(0.2, 2.0)
        g, h = draw.uniform(0.5, 9.0, (2, 2))
        r, q = draw.uniform(0.1, 0.9, (2, 2))
        y = ((geared_limit(g, r, x) + later) / geared_limit(h, q, 1.0)) ** 2
        limits = geared_limit(g, r, x), geared_limit(h, q, y)
        run = hy.simulate(
            Geared(g=g, h=h, r=r, q=q), [x, 0.0, y, 0.0], (0.0, limits[1] + 1.0), solver=solver
        )
        assert [point.mode for point in run.zeno] == ["one", "none"]
        for point, at in zip(run.zeno, limits, strict=True):
            assert abs(point.t - at) <= point.t_error <= 1e-6


class Beside(hy.Automaton):
    """A ball that bounces in turns in two gears, and a body on a floor that shakes."""

    x = hy.state()
    v = hy.state()
    y = hy.state()
    w = hy.state()
    g = hy.parameter(np.ones(2))
    r: float = hy.parameter(0.55)
    amplitude: float = hy.parameter(0.02)
    omega: float = hy.parameter(2.4)

    def gap(self, t, s):
        return s.y - self.amplitude * jnp.sin(self.omega * t)

    @hy.mode(initial=True)
    def light(self, t, s):
        return s.v, -self.g[0], s.w, -7.5

    @hy.mode
    def heavy(self, t, s):
        return s.v, -self.g[1], s.w, -7.5

    @hy.mode(limit_of=("first", "second"))
    def rest(self, t, s):
        return 0.0 * s.v, 0.0, s.w, -7.5

    on_light = hy.contact(light, gap=gap, restitution=0.5)
    on_heavy = hy.contact(heavy, gap=gap, restitution=0.5)
    on_rest = hy.contact(rest, gap=gap, restitution=0.5)

    @hy.edge(light, to=heavy, guard=lambda self, t, s: s.x)
    def first(self, t, s):
        return s.replace(v=-self.r * s.v)

    @hy.edge(heavy, to=light, guard=lambda self, t, s: s.x)
    def second(self, t, s):
        return s.replace(v=-self.r * s.v)


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_a_body_at_rest_beside_a_cycle_stays_so_at_its_limit(solver):
    """The floor of each mode is another contact, in one place, and its acceleration is less than
    gravity: nothing may happen there. The limit of the body's state, extrapolated, was up to 1e-9
    off the floor, from where it fell."""
    draw = np.random.default_rng(3)
    for _ in range(5):
        g, omega, x = draw.uniform(0.5, 10.0, 2), draw.uniform(1.0, 5.0), draw.uniform(0.1, 1.0)
        model = Beside(g=g, r=draw.uniform(0.1, 0.8), omega=omega, amplitude=6.0 / omega**2)
        limit = geared_limit(g, [model.r] * 2, x)
        start = {"x": x, "v": 0.0, "y": 0.0, "w": model.amplitude * omega}
        run = hy.simulate(
            model, start, (0.0, limit + 0.5), mode="light.rest(on_light)", solver=solver
        )
        (point,) = run.zeno
        assert abs(point.t - limit) <= point.t_error <= 1e-11
        assert run.mode == "rest.rest(on_rest)"
        assert set(run.jumps.edge) == {"first", "second"}


class Sticking(hy.Automaton):
    """A block that sticks to a table by dry friction, and a ball that bounces on it: an edge in
    each of the two modes of the block."""

    u = hy.state()
    y = hy.state()
    w = hy.state()
    force: float = hy.parameter(1.0)
    r: float = hy.parameter(0.5)
    g: float = hy.parameter(10.0)

    @hy.mode(initial=True)
    def forwards(self, t, s):
        return self.force * jnp.sin(t) - 3.0, s.w, -self.g

    @hy.mode
    def backwards(self, t, s):
        return self.force * jnp.sin(t) + 3.0, s.w, -self.g

    friction = hy.switching(forwards, backwards, surface=lambda self, t, s: s.u)

    @hy.mode(limit_of=("first", "friction"))
    def ground(self, t, s):
        return 0.0, 0.0, 0.0

    @hy.edge(forwards, to=forwards, guard=lambda self, t, s: s.y)
    def first(self, t, s):
        return s.replace(w=-self.r * s.w, y=0.0)

    @hy.edge(backwards, to=backwards, guard=lambda self, t, s: s.y)
    def second(self, t, s):
        return s.replace(w=-self.r * s.w, y=0.0)


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_impacts_of_two_modes_accumulate_while_a_body_sticks(solver):
    """The guards of both edges are one function and are watched while it sticks; the edge declared
    first fires. The other is zero at the limit, too, and is no reason not to pass it."""
    draw = np.random.default_rng(0)
    for _ in range(8):
        model = Sticking(
            force=draw.integers(2), r=draw.uniform(0.1, 0.75), g=draw.uniform(3.0, 10.0)
        )
        y = draw.uniform(0.1, 1.0)
        limit = math.sqrt(2.0 * y / model.g) * (1.0 + model.r) / (1.0 - model.r)
        start = {"u": 0.1, "y": y, "w": 0.0}
        run = hy.simulate(model, start, (0.0, limit + 0.3), solver=solver)
        (point,) = run.zeno
        assert point.edges == ("first", "friction")
        assert abs(point.t - limit) <= point.t_error <= 1e-11
        assert run.mode == "ground"
        assert "second" not in run.jumps.edge


class Carried(hy.Automaton):
    """A block that sticks to a belt that shakes, until a ball on it lies still, and then."""

    u = hy.state()
    y = hy.state()
    w = hy.state()
    r: float = hy.parameter(0.5)
    g: float = hy.parameter(10.0)
    belt: float = hy.parameter(0.1)
    omega: float = hy.parameter(2.0)

    def slip(self, t, s):
        return s.u - self.belt * jnp.sin(self.omega * t)

    @hy.mode(initial=True)
    def forwards(self, t, s):
        return -3.0, s.w, -self.g

    @hy.mode
    def backwards(self, t, s):
        return 3.0, s.w, -self.g

    friction = hy.switching(forwards, backwards, surface=slip)

    @hy.mode(limit_of=("first", "friction"))
    def loaded_forwards(self, t, s):
        return -5.0, 0.0, 0.0

    @hy.mode
    def loaded_backwards(self, t, s):
        return 5.0, 0.0, 0.0

    loaded = hy.switching(loaded_forwards, loaded_backwards, surface=slip)

    @hy.edge(forwards, to=forwards, guard=lambda self, t, s: s.y)
    def first(self, t, s):
        return s.replace(w=-self.r * s.w, y=0.0)

    @hy.edge(backwards, to=backwards, guard=lambda self, t, s: s.y)
    def second(self, t, s):
        return s.replace(w=-self.r * s.w, y=0.0)


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_what_sticks_beside_a_cycle_does_so_at_its_limit(solver):
    """The limit of what is carried, extrapolated, was up to 1e-12 off the surface of the next mode,
    which it must not be beyond."""
    draw = np.random.default_rng(0)
    for _ in range(6):
        model = Carried(
            r=draw.uniform(0.1, 0.8),
            g=draw.uniform(3.0, 10.0),
            belt=draw.uniform(0.01, 0.5),
            omega=draw.uniform(0.5, 3.0),
        )
        y = draw.uniform(0.1, 1.0)
        limit = math.sqrt(2.0 * y / model.g) * (1.0 + model.r) / (1.0 - model.r)
        run = hy.simulate(model, {"u": 0.1, "y": y, "w": 0.0}, (0.0, limit + 0.5), solver=solver)
        (point,) = run.zeno
        assert abs(point.t - limit) <= point.t_error <= 1e-9
        assert run.mode == "slide(loaded)"
        assert run.jumps.edge[-1] == "loaded"
        assert run.final.u == pytest.approx(model.belt * np.sin(model.omega * run.t1), abs=1e-14)


def test_rounding_of_a_guard_that_is_made_of_zeros_may_be_anywhere_in_a_flight():
    """It has no size and no rate; the time at which it fired is not known any better."""
    scene, none = scene_of(Sticking()), np.zeros(2)
    names = np.array(["first"] * 2), np.array(["forwards"] * 2)
    seen = cycles.Columns(*names, np.array([0.0, 0.25]), none, none, np.zeros((2, 3)))
    assert cycles.blurs(scene, seen, np.array([1]), 1).tolist() == [0.25]


class Squeezed(hy.Automaton):
    """A ball between a floor and a ceiling that comes down on it at a constant speed."""

    y = hy.state()
    v = hy.state()
    g: float = hy.parameter(9.81)
    height: float = hy.parameter(1.0)
    speed: float = hy.parameter(0.5)
    below: float = hy.parameter(0.8)
    above: float = hy.parameter(0.7)

    @hy.mode
    def flight(self, t, s):
        return s.v, -self.g

    floor = hy.contact(flight, gap=lambda self, t, s: s.y, restitution="below")
    ceiling = hy.contact(
        flight, gap=lambda self, t, s: self.height - self.speed * t - s.y, restitution="above"
    )


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_a_ball_that_is_squeezed_ends_its_run_where_nothing_is_left_of_the_gap(solver):
    """Its impacts follow each other ever sooner, or it lies on the floor until the ceiling comes:
    then they go on at one instant, at speeds that come round and do not fall."""
    draw = np.random.default_rng(11)
    for _ in range(5):
        below, above = draw.uniform(0.05, 1.0, 2)
        height, speed = draw.uniform(0.5, 2.0), draw.uniform(0.1, 3.0)
        gravity = draw.choice([0.0, 1.0, 9.81])
        model = Squeezed(g=gravity, height=height, speed=speed, below=below, above=above)
        start = {"y": draw.uniform(0.1, 0.9) * height, "v": draw.uniform(-2.0, 2.0)}
        run = hy.simulate(model, start, (0.0, height / speed + 1.0), solver=solver)
        assert run.status is hy.Status.NO_REST
        point = run.zeno[-1]
        assert point.edges == ("ceiling", "floor")
        assert point.t == run.t1
        assert abs(point.t - height / speed) <= point.t_error <= 1e-8 * point.t  # SciPy's rtol


@pytest.mark.parametrize("loss", [1e-3, 1e-7])
def test_impacts_at_one_instant_that_lose_little_are_no_standstill(loss):
    """A body between two walls that touch it: each impact leaves ``1 - loss`` of the speed, which
    many turns show and one does not. Without loss they go on for ever, and nothing is at rest."""
    gain = np.array([[1.0, -1.0], [-1.0, 1.0]])
    found = shrinking(Cascade(gain, [1.0 - loss] * 2, [0.0, 0.0], [-1.0, 1.0]), 1.0)
    assert sorted(found.struck) == [0, 1]
    assert found.ratio == pytest.approx((1.0 - loss) ** 2, rel=1e-9)
    assert shrinking(Cascade(gain, [1.0, 1.0], [0.0, 0.0], [-1.0, 1.0]), 1.0) is None


class Together(hy.Automaton):
    """A ball that bounces in turns in two gears, and two bodies that fly, one on the other."""

    x = hy.state()
    v = hy.state()
    y = hy.state()
    w = hy.state()
    z = hy.state()
    u = hy.state()
    g = hy.parameter(np.ones(2))
    r = hy.parameter(np.ones(2))

    def gap(self, t, s):
        return s.z - s.y

    @hy.mode(initial=True)
    def light(self, t, s):
        return s.v, -self.g[0], s.w, -5.0, s.u, -5.0

    @hy.mode
    def heavy(self, t, s):
        return s.v, -self.g[1], s.w, -5.0, s.u, -5.0

    @hy.mode(limit_of=("first", "second"))
    def rest(self, t, s):
        return 0.0 * s.v, 0.0, s.w, -5.0, s.u, -5.0

    in_light = hy.contact(light, gap=gap, restitution=0.5)
    in_heavy = hy.contact(heavy, gap=gap, restitution=0.5)
    in_rest = hy.contact(rest, gap=gap, restitution=0.5)

    @hy.edge(light, to=heavy, guard=lambda self, t, s: s.x)
    def first(self, t, s):
        return s.replace(v=-self.r[0] * s.v)

    @hy.edge(heavy, to=light, guard=lambda self, t, s: s.x)
    def second(self, t, s):
        return s.replace(v=-self.r[1] * s.v)


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_bodies_that_fly_together_do_so_through_the_limit_of_a_cycle(solver):
    """They bear nothing, for good: that their load is zero at the limit is no event there."""
    draw = np.random.default_rng(5)
    for _ in range(3):
        g, r, x = draw.uniform(0.5, 10.0, 2), draw.uniform(0.1, 0.85, 2), draw.uniform(0.1, 1.0)
        limit, w = geared_limit(g, r, x), draw.uniform(1.0, 5.0)
        start, t = {"x": x, "v": 0.0, "y": 0.2, "w": w, "z": 0.2, "u": w}, limit + 0.1
        model = Together(g=g, r=r)
        run = hy.simulate(model, start, (0.0, t), mode="light.rest(in_light)", solver=solver)
        (point,) = run.zeno
        assert abs(point.t - limit) <= point.t_error <= 1e-9
        assert run.mode == "rest.rest(in_rest)"
        assert run.final.y == run.final.z
        assert run.final.y == pytest.approx(0.2 + w * t - 2.5 * t * t, abs=1e-12)


class Softer(hy.Automaton):
    """A twisting controller whose gain is another one within ``c`` of the origin."""

    x = hy.state()
    v = hy.state()
    far: float = hy.parameter(2.0)
    close: float = hy.parameter(2.0)
    c: float = hy.parameter(1e-6)

    def gain(self, s):
        return jnp.where(jnp.abs(s.x) > self.c, self.far, self.close)

    @hy.mode(initial=True)
    def right_back(self, t, s):
        return s.v, 1.0 - self.gain(s)

    @hy.mode
    def left_back(self, t, s):
        return s.v, self.gain(s) + 1.0

    @hy.mode
    def left_forth(self, t, s):
        return s.v, self.gain(s) - 1.0

    @hy.mode
    def right_forth(self, t, s):
        return s.v, -self.gain(s) - 1.0

    @hy.mode(limit_of=("crosses_left", "turns_left", "crosses_right", "turns_right"))
    def rests(self, t, s):
        return 0.0 * s.x, 0.0 * s.v

    crosses_left = hy.switching(right_back, left_back, surface=lambda self, t, s: s.x)
    crosses_right = hy.switching(right_forth, left_forth, surface=lambda self, t, s: s.x)
    turns_left = hy.switching(left_forth, left_back, surface=lambda self, t, s: s.v)
    turns_right = hy.switching(right_forth, right_back, surface=lambda self, t, s: s.v)


def comes_to_rest(x, far, close, c):
    """The time of :class:`Softer` from ``x`` at rest: half turn after half turn, by parabolas."""
    t = 0.0
    while x > 1e-40:
        outer, inner = 2.0 * (far - 1.0) * max(x - c, 0.0), 2.0 * (close - 1.0) * min(x, c)
        t += math.sqrt(outer) / (far - 1.0) + 2.0 * min(x, c) / (
            math.sqrt(outer) + math.sqrt(outer + inner)
        )
        left = outer + inner - 2.0 * (close + 1.0) * c
        if left <= 0.0:
            x = (outer + inner) / (2.0 * (close + 1.0))
            t += math.sqrt(outer + inner) / (close + 1.0)
        else:
            x = c + left / (2.0 * (far + 1.0))
            t += 2.0 * c / (math.sqrt(outer + inner) + math.sqrt(left))
            t += math.sqrt(left) / (far + 1.0)
    return t


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize(
    ("x", "far", "close", "c"),
    [
        (0.006513598165269565, 1.1742910374664386, 1.5316225271563915, 2.734981336922379e-12),
        (0.01, 1.2, 1.5, 3e-13),
        (0.05, 2.5, 1.8, 1e-11),
    ],
)
def test_a_cycle_that_rounding_ends_may_have_come_further(x, far, close, c, solver):
    """Another law begins so late that positions are rounded to zero before it is known: what is
    left then is sixteen digits of ``x``, but eight of the time."""
    exact = comes_to_rest(x, far, close, c)
    point = limit_or_refusal(Softer(far=far, close=close, c=c), x, 2.0 * exact, solver=solver)
    assert point is None or abs(point.t - exact) <= point.t_error


def limit_or_refusal(model, x, t1, **options):
    """The limit to which a controller comes from ``x``; None where the run says that it cannot go
    on. It does not go on elsewhere."""
    try:
        run = hy.simulate(model, {"x": x, "v": 0.0}, (0.0, t1), **options)
    except (hy.DomainError, hy.FlowError):
        return None
    (point,) = run.zeno
    assert run.mode == "rests"
    return point


@pytest.mark.parametrize("method", ["BDF", "LSODA", "Radau"])
@pytest.mark.parametrize("scale", [1e-2, 1.1e-3, 1e-3, 8e-4, 1e-4])
def test_a_cycle_that_steps_lose_is_no_way_out(method, scale):
    """Methods that lose much lead to the origin with no regular turns."""
    half = math.sqrt(scale) * (math.sqrt(2.0) + math.sqrt(2.0) / 3.0)
    point = limit_or_refusal(Twisting(), scale, 9.0, solver="scipy", method=method)
    exact = half / (1.0 - math.sqrt(1 / 3))
    assert point is None or abs(point.t - exact) <= point.t_error < 1e-6


class SetPoint(Twisting):
    """The controller of :class:`Twisting` about ``x = c``."""

    c = hy.parameter(3.0)
    right_back, left_back = Twisting.right_back, Twisting.left_back
    right_forth, left_forth = Twisting.right_forth, Twisting.left_forth
    crosses_left = hy.switching(right_back, left_back, surface=lambda self, t, s: s.x - self.c)
    crosses_right = hy.switching(right_forth, left_forth, surface=lambda self, t, s: s.x - self.c)


class Gains(hy.Automaton):
    """That controller by two gains that change their signs, with edges that have no side."""

    x = hy.state()
    v = hy.state()
    far = hy.state()
    close = hy.state()
    c = hy.parameter(3.0)

    @hy.mode
    def pushed(self, t, s):
        return s.v, -s.far - s.close, 0.0, 0.0

    @hy.edge(pushed, to=pushed, guard=lambda self, t, s: s.x - self.c, crossing=hy.EITHER)
    def crosses(self, t, s):
        return s.x, s.v, -s.far, s.close

    @hy.edge(pushed, to=pushed, guard=lambda self, t, s: s.v, crossing=hy.EITHER)
    def turns(self, t, s):
        return s.x, s.v, s.far, -s.close


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
@pytest.mark.parametrize("c", [3.0, -7.5, 150.7, -4000.1])
@pytest.mark.parametrize(("model", "gains"), [(SetPoint, {}), (Gains, {"far": 2.0, "close": -1.0})])
def test_a_cycle_may_lie_far_from_zero(model, gains, c, solver):
    """The rounding of ``x - c`` is that of ``c``, however low the flights are: the limit is taken
    before it hides on which side they begin. About -4000 that leaves 3e-7 of the time open."""
    run = hy.simulate(model(c=c), {"x": c + 1.0, "v": 0.0, **gains}, (0.0, 6.0), solver=solver)
    half = math.sqrt(2.0) + math.sqrt(2.0) / 3.0
    (point,) = run.zeno
    assert abs(point.t - half / (1.0 - math.sqrt(1 / 3))) <= point.t_error < 1e-6
    assert abs(point.state.x - c) <= 1e-9 * abs(c)
