"""The bound on an accumulation's time holds, on random scenes whose truth is known."""

from functools import cache

import jax.numpy as jnp
import pytest

import hybrid as hy

from .scenes import scenes

#: A few of the scenes of ``benchmarks/bounds.py``, which goes through five hundred; made when the
#: first is asked for, as every worker reads this file.
COUNT = 24
made = cache(lambda: list(scenes(COUNT, seed=16)))


@pytest.mark.parametrize("rtol", [1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize("solver", ["scipy", "taylor"])
@pytest.mark.parametrize("number", range(COUNT))
def test_the_error_lies_within_its_bound(number, solver, rtol):
    """Balls, moving floors, weights that switch, hard springs; units from 1e-6 to 1e6."""
    scene = made()[number]
    (point,) = scene.run(solver, rtol).zeno
    assert abs(point.t - scene.exact) <= point.t_error


class Bead(hy.Automaton):
    """A bead on a table that falls away from it a little faster than it falls, once a period."""

    x = hy.state()
    v = hy.state()
    a = hy.parameter(1.0)
    w = hy.parameter(1.0)
    r = hy.parameter(0.5)

    @hy.mode
    def flight(self, t, s):
        return s.v, -9.8

    table = hy.contact(
        flight, gap=lambda self, t, s: s.x - self.a * jnp.sin(self.w * t), restitution="r"
    )


#: Table and restitution, the period whose accumulation it is, and its time: flights in closed form,
#: 60 digits.
WEAK = [
    (1.4207434780523691, 2.62642036889148, 0.13405075906783176, 1, 3.001477975999854998),
    (0.5631843447211484, 4.171483964620614, 0.4562895826541809, 2, 3.3937803873982161022),
    (30.51133949467437, 0.5668667279743603, 0.5793274781186821, 2, 25.170633246155477617),
]


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
@pytest.mark.parametrize(("a", "w", "r", "period", "exact"), WEAK)
def test_the_bound_counts_the_rounding_of_a_gap_under_a_weak_load(solver, a, w, r, period, exact):
    """Flights of a millionth of the table's height, which all runs round alike: the time is off by
    1e-11 to 2e-10, and its bound is a hundred times that at most."""
    start, until = {"x": 1.3 * a, "v": a * w}, exact + 0.1 / w
    run = hy.simulate(Bead(a=a, w=w, r=r), start, (0.0, until), solver=solver, rtol=1e-10)
    point = run.zeno[period]
    assert abs(point.t - exact) <= point.t_error <= 3e-6 * (point.t - run.zeno[period - 1].t)


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
def test_a_series_under_a_load_that_all_but_ends_is_summed(solver):
    """The load comes to a millionth of its terms, weight and the table's turn: flights as high as
    the rounding of the state are flown. The first rest to 60 digits, flights in closed form."""
    w, r, start = 1.0929234484582584, 0.07246158599853514, 2.1795833624497476
    a = 1.0000104917939567 * 9.8 / w**2
    run = hy.simulate(
        Bead(a=a, w=w, r=r), {"x": start, "v": a * w}, (0.0, 14.0), solver=solver, rtol=1e-10
    )
    rests = [arc.t0 for arc in run.arcs if arc.held]
    assert [point.t for point in run.zeno] == rests
    assert len(rests) == 4
    assert abs(rests[0] - 1.432861821952024636) <= run.zeno[0].t_error < 1e-9
    assert run.zeno[0].ratio == r


class Carried(Bead):
    """The bead as seen from the table: what cancels is the force, not the gap."""

    @hy.mode
    def flight(self, t, s):
        return s.v, self.a * self.w**2 * jnp.sin(self.w * t) - 9.8

    table = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")


#: Table and restitution, where the bead is let go with the table's speed, and its first rest, as
#: above: just before the table falls away, where the load is 1e-8 to 1e-4 of its terms.
WEAKEST = [
    (1.0687549601341857, 3.0281437342890047, 0.10394499538087243, 0.23491595684701388,
     0.517138263167041723224),
    (12.59687687794604, 0.8820264747446062, 0.07096441303448231, 3.3791030495899412,
     1.780067780989254850655),
    (0.41773426033391625, 4.84354139376819, 0.15330316330995866, 0.07028747142553511,
     0.324660143770058282268),
]  # fmt: skip


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
@pytest.mark.parametrize(("a", "w", "r", "start", "exact"), WEAKEST)
@pytest.mark.parametrize(("model", "rises"), [(Bead, 1.0), (Carried, 0.0)])
def test_impacts_under_the_weakest_load_are_summed(solver, a, w, r, start, exact, model, rises):
    """Near the turn of the table points beside do not show the rounding of the load: its terms do.

    SciPy's steps, of rtol 1e-10, lose up to 2e-7 of a time at which so little pulls; the rounding
    of the load's terms up to 2e-8.
    """
    run = hy.simulate(
        model(a=a, w=w, r=r), {"x": start, "v": rises * a * w}, (0.0, exact + 0.01 / w),
        solver=solver, rtol=1e-10,
    )  # fmt: skip
    point = run.zeno[0]
    assert point.ratio == r
    assert abs(point.t - exact) <= point.t_error < (2e-7 if solver == "scipy" else 2e-8)


class Sinking(hy.Automaton):
    """A ball on a floor that sinks ever faster: its weight on it goes down to zero."""

    x = hy.state()
    v = hy.state()
    weight = hy.parameter(1.0)
    k = hy.parameter(1.0)
    r = hy.parameter(0.5)

    @hy.mode
    def flight(self, t, s):
        return s.v, -self.weight

    floor = hy.contact(flight, gap=lambda self, t, s: s.x + self.k * t**3 / 6, restitution="r")


#: Weight, growth, restitution, speed and the accumulation's time: flights in closed form, 50
#: digits.
SHORTLY_BEFORE_RELEASE = [
    (0.01927235569267943, 0.0421505171309037, 0.8296243078834293, 0.0004505016535064388,
     0.45608072434457574),
    (0.03885028055630656, 0.3719895963158193, 0.29103398748417825, 0.0008727209383839242,
     0.10443903714467165),
]  # fmt: skip


@pytest.mark.parametrize(("weight", "k", "r", "v", "exact"), SHORTLY_BEFORE_RELEASE)
def test_the_bound_holds_shortly_before_a_release(weight, k, r, v, exact):
    """Where impacts hardly accumulate before the floor falls away."""
    model, until = Sinking(weight=weight, k=k, r=r), weight / k
    start = {"x": 0.0, "v": v}
    (point,) = hy.simulate(model, start, (0.0, until), solver="taylor", rtol=1e-10).zeno
    assert abs(point.t - exact) <= point.t_error <= 1e-9 * exact


class SuperTwisting(hy.Automaton):
    """Levant's algorithm, which brings ``x`` to zero in finite time."""

    x = hy.state()
    v = hy.state()

    @hy.mode(initial=True)
    def above(self, t, s):
        return s.v - 1.199 * jnp.sqrt(abs(s.x)), -0.966

    @hy.mode
    def below(self, t, s):
        return s.v + 1.199 * jnp.sqrt(abs(s.x)), 0.966

    @hy.mode(limit_of=("surface",))
    def rest(self, t, s):
        return 0.0, 0.0

    surface = hy.switching(above, below, surface=lambda self, t, s: s.x)


@pytest.mark.long
def test_steps_that_become_as_short_as_rounding_leave_no_bound_or_a_true_one():
    """The steps of the runs that are compared shrink to nothing at the limit."""
    start, found = {"x": 1.684, "v": 0.274}, []
    for options in ({}, {"rtol": 1e-5, "atol": 1e-7}):
        run = hy.simulate(SuperTwisting(), start, (0.0, 4.0), solver="taylor", **options)
        found += run.zeno
    fine, loose = found
    assert fine.t_error < 1e-10
    assert abs(fine.t - loose.t) <= fine.t_error + loose.t_error


class Falling(hy.Automaton):
    """Two beads, one above the other, with drag: blows of the upper alternate with the floor's."""

    x = hy.state()
    v = hy.state()
    y = hy.state()
    u = hy.state()
    r: float = hy.parameter(0.5)
    size: float = hy.parameter(0.1)
    drag: float = hy.parameter(0.5)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -10.0 - self.drag * s.v, s.u, -10.0 - self.drag * s.u

    floor = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")
    blow = hy.contact(flight, gap=lambda self, t, s: s.y - s.x - self.size, restitution="r")


#: Parameters, heights, and when the impacts of the lower come to an end, from the closed form of
#: each flight to 60 digits.
BLOWS = [
    ((0.4916740406778552, 0.14309938568143282, 0.592970019138602),
     (0.3439522824813262, 0.5638721946475638), 0.47626027017238342868),
    ((0.3394735561881783, 0.1405362891748702, 0.9018462069728312),
     (0.9863453949367662, 1.3411146957390294), 0.62703326201127084443),
]  # fmt: skip


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
@pytest.mark.parametrize(("model", "heights", "exact"), BLOWS)
def test_rounding_grows_between_blows_that_alternate(solver, model, heights, exact):
    """The gaps at some ten of them are rounded alike by all runs: those that are compared agreed
    six times too well. Moved by their last digits they are up to 1e-11 apart."""
    r, size, drag = model
    start = {"x": heights[0], "v": 0.0, "y": heights[1], "u": 0.0}
    run = hy.simulate(
        Falling(r=r, size=size, drag=drag), start, (0.0, 2.0), solver=solver, zeno="stop"
    )
    assert (
        abs(run.zeno[0].t - exact) <= run.zeno[0].t_error < (1e-10 if solver == "taylor" else 1e-7)
    )
