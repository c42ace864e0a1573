"""What acts briefly on the way to a limit, and losses that stop: no false limit, no false proof.

A ball on a floor, ``g = 2``, ``r = 0.7``, thrown up with speed 1: without anything else its impacts
accumulate at ``10/3``. A pulse of force kicks it on the way; the exact motion is made of parabolas.
"""

import math
from itertools import product

import jax.numpy as jnp
import pytest

import hybrid as hy

from .ways import SOLVERS, later, spread

pytest.importorskip("flint")

WAYS = ["DOP853", "taylor", "Dopri8", "ensemble", "as_function"]

#: Ways in whose answers are the driver's: the others sum with no look between their flights.
LANES = ("as_function",)

START = [0.0, 1.0]


class Ball(hy.Automaton):
    """A ball that is kicked at ``at``, for about the time ``width``, by a speed of ``kick``."""

    x = hy.state()
    v = hy.state()
    at: float = hy.parameter(3.28333)
    width: float = hy.parameter(1e-4)
    kick: float = hy.parameter(1.0)
    g: float = hy.parameter(2.0)
    r: float = hy.parameter(0.7)

    @hy.mode
    def flight(self, t, s):
        return s.v, -self.g + self.kick / self.width * self.shape((t - self.at) / self.width)

    def shape(self, s):
        return jnp.exp(-(s**2)) / math.sqrt(math.pi)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")


class Boxed(Ball):
    """A pulse that switches on and off."""

    def shape(self, s):
        return jnp.where(jnp.abs(s) < 1.0, 0.5, 0.0)


class Pointed(Ball):
    """A pulse that is a triangle."""

    def shape(self, s):
        return jnp.maximum(1.0 - jnp.abs(s), 0.0)


class Bell(Ball):
    """A pulse that falls off like an exponential."""

    def shape(self, s):
        return 0.5 * (1.0 - jnp.tanh(s) ** 2)


def limit(at, kick, g=2.0, r=0.7, v=1.0):
    """When the impacts accumulate: parabolas, the kick on one of them."""
    t = 0.0
    while t + 2 * v / g < at:
        t, v = t + 2 * v / g, r * v
    s = at - t
    x, u = v * s - g * s * s / 2, v - g * s + kick
    rest = (u + math.sqrt(u * u + 2 * g * x)) / g
    return t + s + rest - 2 * r * (u - g * rest) / g / (1 - r)


def honest(result, exact, way):
    """An accumulation that is claimed is the true one, within the bound; one is claimed."""
    (point,) = result.zeno[:1]
    assert abs(point.t - exact) <= point.t_error
    if way.tells("bound") and point.verdict == "certified":
        assert point.t_error < math.inf
        if way.tells("run"):
            low, high = point.enclosure
            assert low <= exact <= high


KICKS = [
    (3.28333, 1e-4, 1.8),
    (3.28333, 1e-6, 0.3),
    (3.3, 1e-5, 1e-3),
    (3.1, 3e-3, 0.05),
    (2.9, 1e-7, 0.4),
    (3.33, 1e-6, 1e-2),
]

#: The broadest kick, the narrowest and the nearest to the limit; the others in between.
FEW = [KICKS[0], *KICKS[4:], *later(*KICKS[1:4])]


@pytest.mark.parametrize(("at", "width", "kick"), FEW)
def test_a_pulse_on_the_way_to_the_limit_is_seen(way, at, width, kick):
    """However narrow it is, and however near to the limit; the answer is that of parabolas."""
    result = way.run(Ball(at=at, width=width, kick=kick), START, (0.0, 60.0), rtol=1e-9)
    exact = limit(at, kick)
    if way.tells("bound"):
        honest(result, exact, way)
    assert result.t_inf == pytest.approx(exact, abs=1e-5)  # a step's tolerance and the kick's
    if way.tells("verdict"):
        assert result.zeno[0].verdict == "certified"


@pytest.mark.parametrize("cls", [Boxed, Pointed])
@pytest.mark.parametrize(("at", "width", "kick"), KICKS)
def test_a_series_that_does_not_happen_is_not_certified(cls, at, width, kick):
    """DOP853 may pass over a pulse: what follows in its run is proved, and is another series."""
    model = cls(at=at, width=width, kick=kick)
    point = hy.simulate(model, START, (0, 60), method="DOP853", rtol=1e-9).zeno[0]
    exact = limit(at, kick)
    assert abs(point.t - exact) <= point.t_error
    if abs(point.t - exact) > 1e-3:
        assert point.verdict == "estimated"
        assert point.enclosure is None


class Distant(Ball):
    """The same ball over a gap that is written as a distance."""

    impact = hy.contact("flight", gap=lambda self, t, s: jnp.abs(s.x), restitution="r")


class Sided(Ball):
    """The same with a choice, and the ball below its table."""

    @hy.mode
    def flight(self, t, s):
        return s.v, self.g - self.kick / self.width * self.shape((t - self.at) / self.width)

    impact = hy.contact(
        flight, gap=lambda self, t, s: jnp.where(s.x > 0, s.x, -s.x), restitution="r"
    )


class Floating(Ball):
    """The same over a plain gap; below the table there would be another force."""

    @hy.mode
    def flight(self, t, s):
        force = -self.g + self.kick / self.width * self.shape((t - self.at) / self.width)
        return s.v, jnp.where(s.x >= 0, 1.0, 0.5) * force

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")


BALLS, BOTH = [(Distant, 1.0), (Sided, -1.0), (Floating, 1.0)], ["scipy", "taylor"]


@pytest.mark.parametrize(
    ("ball", "pulse", "by"),
    [
        *spread(BALLS, [KICKS[0], *KICKS[4:]], BOTH),
        *later(*product(BALLS, KICKS[1:4], BOTH)),
    ],
)
def test_a_pulse_where_a_formula_changes_at_the_impacts(ball, pulse, by):
    """Balls about an impact are on both sides of it; the flights are not, and are looked at."""
    (cls, v), (at, width, kick) = ball, pulse
    model = cls(at=at, width=width, kick=kick)
    run = hy.simulate(model, [0.0, v], (0, 20), solver=by, rtol=1e-9)
    point, exact = run.zeno[0], limit(at, kick)
    assert abs(point.t - exact) <= point.t_error < 1e-6
    assert abs(point.t - exact) < 1e-7


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
@pytest.mark.parametrize(("cls", "v"), [(Distant, 1.0), (Sided, -1.0), (Floating, 1.0)])
def test_a_formula_that_changes_at_the_impacts_is_summed(cls, v, solver):
    """Where no pulse acts, from the first impacts on."""
    run = hy.simulate(cls(kick=0.0), [0.0, v], (0, 20), solver=solver, rtol=1e-9)
    assert abs(run.zeno[0].t - 10 / 3) <= run.zeno[0].t_error < 1e-8  # rtol, a few times
    assert len(run.own_jumps) < 5


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
@pytest.mark.parametrize("cls", [Boxed, Pointed, Bell])
@pytest.mark.parametrize(("at", "width", "kick"), [KICKS[1], (3.2, 1e-5, 0.1)])
def test_pulses_of_other_shapes(cls, solver, at, width, kick):
    """Switched, with a kink, with long tails."""
    run = hy.simulate(cls(at=at, width=width, kick=kick), START, (0, 60), solver=solver, rtol=1e-9)
    point, exact = run.zeno[0], limit(at, kick)
    assert abs(point.t - exact) <= point.t_error
    assert point.verdict == "estimated" or point.enclosure[0] <= exact <= point.enclosure[1]


class Lossy(hy.Automaton):
    """A ball whose restitution has a bump of height ``more`` about the speed ``about``."""

    x = hy.state()
    v = hy.state()
    about: float = hy.parameter(1e-5)
    width: float = hy.parameter(2e-6)
    more: float = hy.parameter(0.5)

    @hy.mode
    def flight(self, t, s):
        return s.v, -2.0

    def law(self, t, s, u):
        return 0.6 + self.more * jnp.exp(-(((jnp.abs(u) - self.about) / self.width) ** 2))

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=law)


def iterated(about, width, more):
    """The sum of the flights, one after the other."""
    flights, v = [], 1.0
    while v > 1e-20:
        flights.append(v)
        v *= 0.6 + more * math.exp(-(((v - about) / width) ** 2))
    return math.fsum(flights)


@pytest.mark.parametrize(
    ("about", "width", "more"),
    [(1e-5, 2e-6, 0.5), (1e-3, 2e-4, 0.3), (1e-8, 3e-9, -0.4), (1e-6, 4e-7, 0.1)],
)
def test_a_restitution_that_changes_on_the_way(way, about, width, more):
    """Impacts that lose less, or nothing, at some speed far below the first."""
    model = Lossy(about=about, width=width, more=more)
    result = way.run(model, START, (0.0, 5.0), rtol=1e-8)
    honest(result, iterated(about, width, more), way)


class Tireless(Lossy):
    """Impacts slower than ``about`` lose nothing, or gain."""

    def law(self, t, s, u):
        return jnp.where(jnp.abs(u) < self.about, self.more, 0.6)

    impact = hy.contact("flight", gap=lambda self, t, s: s.x, restitution=law)


@pytest.mark.parametrize(
    ("about", "more"), spread([1e-3, 1e-6, 1e-7, 1e-9, 1e-12], [1.0, 1.3], of=2)
)
def test_what_never_tires_never_rests(way, about, more):
    """The impacts go on for ever: none is said to be the last."""
    model = Tireless(about=about, more=more)
    result = way.run(model, START, (0.0, 5.0), max_jumps=300)
    assert not result.zeno
    assert result.status in ("max_jumps", "jump_loop", "too_many_jumps")


def test_a_ball_that_loses_nothing():
    """Restitution 1 exactly, for all impacts."""
    assert not hy.simulate(Tireless(about=2.0, more=1.0), START, (0, 5), max_jumps=300).zeno


@pytest.mark.parametrize("about", [1e-12, 1e-5])
def test_a_restitution_of_one_at_a_single_speed(about):
    """Which the impacts pass by, or nearly so."""
    run = hy.simulate(Lossy(about=about, width=1e-13, more=0.4), START, (0, 5), max_jumps=300)
    assert not run.zeno or run.zeno[0].t_error >= abs(run.zeno[0].t - iterated(about, 1e-13, 0.4))


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
@pytest.mark.parametrize("width", [1e-3, 1e-5, 1e-7])
def test_a_restitution_that_slow_impacts_make_negative_is_refused(width, solver):
    """Low flights lead to the first of them: it is no rest."""
    model = Lossy(about=0.0, width=width, more=-0.8)
    with pytest.raises(hy.FlowError, match="must not be negative"):
        hy.simulate(model, START, (0, 5), solver=solver)


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
@pytest.mark.parametrize("width", [1e-3, 1e-6, 1e-10, 1e-13])
def test_a_loss_that_fades_like_the_square_of_the_speed(width, solver):
    """Slow impacts lose ``0.4 (u / width)^2``: their times are like ``n^(-1/2)``, without a sum."""
    run = hy.simulate(
        Lossy(about=0.0, width=width, more=0.4), START, (0, 5), solver=solver, max_jumps=300
    )
    assert not run.zeno


class Gusty(hy.Automaton):
    """A ball that falls through a thin zone of wind onto a floor."""

    x = hy.state()
    v = hy.state()
    force: float = hy.parameter(200.0)
    thin: float = hy.parameter(0.01)

    @hy.mode
    def flight(self, t, s):
        return s.v, -9.81 + jnp.where(jnp.abs(s.x - 0.5) < self.thin, self.force, 0.0)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.3)


def blown(force, thin, r=0.3, g=9.81):
    """The energy argument: three falls, then hops that do not reach the zone."""
    heights, u, t = [0.5 - thin, 2 * thin, 0.5 - thin], 0.0, 0.0
    for height, a in zip(heights, (g, g - force, g), strict=True):
        after = math.sqrt(u * u + 2 * a * height)
        t, u = t + 2 * height / (u + after), after
    assert (r * u) ** 2 / (2 * g) < 0.5 - thin
    return t + 2 * r * u / g / (1 - r)


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
@pytest.mark.parametrize(
    ("force", "thin"), [(200.0, 0.01), (2e3, 1e-3), (400.0, 5e-3), (-3e4, 1e-4)]
)
def test_a_gust_before_the_first_impact(solver, force, thin):
    """A step that passes over it is told by the error, if not seen."""
    model = Gusty(force=force, thin=thin)
    point = hy.simulate(model, [1.0, 0.0], (0, 5), solver=solver).zeno[0]
    assert abs(point.t - blown(force, thin)) <= point.t_error


@pytest.mark.parametrize("solver", ["scipy", "taylor"])
def test_the_end_of_the_run_does_not_matter(solver):
    """The accumulation, its bound and its verdict are those of the motion, whatever ``t1``."""
    model = Ball(at=3.1, width=1e-4, kick=0.2)
    runs = [hy.simulate(model, START, (0, end), solver=solver, rtol=1e-9) for end in (9, 17, 400)]
    assert len({run.zeno[0].t for run in runs}) == 1
    assert len({(run.zeno[0].t_error, run.zeno[0].verdict) for run in runs}) == 1


class SlowTurn(hy.Automaton):
    """A ball by an edge whose reset has another formula for impacts slower than ``p``."""

    x = hy.state()
    v = hy.state()
    p = hy.parameter(1e-4)
    below = hy.parameter(1.0)

    @hy.mode(initial=True)
    def fly(self, t, s):
        return s.v, -2.0

    @hy.mode(limit_of=("back",))
    def rest(self, t, s):
        return 0.0, 0.0

    @hy.edge(fly, guard=lambda self, t, s: s.x)
    def back(self, t, s):
        return s.replace(x=0.0, v=-jnp.where(-s.v < self.p, self.below, 0.5) * s.v)


@pytest.mark.parametrize("solver", ["taylor", "DOP853"])
@pytest.mark.parametrize("p", [1e-3, 1e-4, 1e-6])
def test_a_reset_that_changes_on_the_way_to_the_limit_is_not_extrapolated(solver, p):
    """The impacts seen so far halve the speed; those to come keep 0.9 of it, or all."""
    speeds = [1.0]
    while speeds[-1] > 1e-18:
        speeds.append((0.9 if speeds[-1] < p else 0.5) * speeds[-1])
    start, t = {"x": 0.0, "v": 1.0}, (0.0, 2.3)
    for below, limit in ((0.5, 2.0), (0.9, sum(speeds))):
        run = hy.simulate(SlowTurn(p=p, below=below), start, t, **SOLVERS[solver])
        assert len(run.zeno) == 1
        assert abs(run.zeno[0].t - limit) < 1e-12
    elastic = hy.simulate(SlowTurn(p=p), start, t, max_jumps=1000, **SOLVERS[solver])
    assert len(elastic.zeno) == 0


class Watched(hy.Automaton):
    """A ball whose restitution is another for impacts slower than ``p``, counted at its apex."""

    x = hy.state()
    v = hy.state()
    p = hy.parameter(1e-4)
    r = hy.parameter(0.5)
    below = hy.parameter(0.9)

    @hy.mode
    def fly(self, t, s):
        return s.v, -2.0

    impact = hy.contact(
        fly,
        gap=lambda self, t, s: s.x,
        restitution=lambda self, t, s, u: jnp.where(jnp.abs(u) > self.p, self.r, self.below),
    )

    @hy.edge(fly, to=fly, guard=lambda self, t, s: s.v)
    def apex(self, t, s):
        return s


@pytest.mark.parametrize("solver", ["taylor", "DOP853"])
@pytest.mark.parametrize(("r", "below"), [(0.5, 0.9), (0.8, 0.5)])
def test_a_restitution_that_changes_is_not_extrapolated_in_a_cycle_either(solver, r, below):
    """An event beside the impacts makes a cycle of them; its contacts must keep their law, too."""
    speeds = [1.0]
    while speeds[-1] > 1e-18:
        speeds.append((r if speeds[-1] > 1e-4 else below) * speeds[-1])
    model, start = Watched(r=r, below=below), {"x": 0.0, "v": 1.0}
    run = hy.simulate(model, start, (0.0, 1.5 * sum(speeds)), **SOLVERS[solver], rtol=1e-11)
    assert len(run.zeno) == 1
    assert run.mode == "fly.rest(impact)"
    assert abs(run.zeno[0].t - sum(speeds)) <= run.zeno[0].t_error
    assert solver != "taylor" or run.zeno[0].t_error <= 1e-11


class Turning(hy.Automaton):
    """A count-down begins anew with a share of its last length; below the length ``about``, one of
    reset, guard and flow follows another law."""

    left = hy.state()
    length = hy.state()
    about = hy.parameter(1e-6)
    share = hy.parameter(0.5)
    later = hy.parameter(0.5, doc="the share below it")
    early = hy.parameter(0.0, doc="by what share of the length it ends too early there")
    pace = hy.parameter(1.0, doc="its pace there")

    @hy.mode(initial=True)
    def runs(self, t, s):
        return -jnp.where(s.length > self.about, 1.0, self.pace) + 0.0 * s.left, 0.0 * s.left

    @hy.mode(limit_of=("again",))
    def ends(self, t, s):
        return 0.0 * s.left, 0.0 * s.left

    def over(self, t, s):
        return s.left - jnp.where(s.length > self.about, 0.0, self.early * s.length)

    @hy.edge(runs, to=runs, guard=over)
    def again(self, t, s):
        length = s.length * jnp.where(s.length > self.about, self.share, self.later)
        return length, length


#: Changes of a law, from ones that a table of estimates takes for rounding to ones of some percent.
CHANGES = [
    {"share": 0.3, "later": 0.3002, "about": 1e-6},
    {"share": 0.872, "later": 0.847, "about": 2.8e-9},
    {"share": 0.824, "later": 0.824 * (1 - 1.2e-8), "about": 5e-4},
    {"share": 0.5, "later": 0.5, "about": 1e-6, "early": 0.5},
    {"share": 0.764, "later": 0.764, "about": 5e-4, "early": 0.055},
    {"share": 0.91, "later": 0.91, "about": 8.7e-6, "early": 2.5e-5},
    {"share": 0.27, "later": 0.27, "about": 2e-4, "pace": 1.00026},
    {"share": 0.88, "later": 0.88, "about": 2e-8, "pace": 1.007},
    {"share": 0.78, "later": 0.78, "about": 1e-6, "pace": 0.9973},
]


@pytest.mark.parametrize("solver", ["taylor", "DOP853"])
@pytest.mark.parametrize("change", CHANGES)
def test_a_law_that_changes_a_little_is_not_extrapolated(solver, change):
    """Reset, guard or flow: its limit is that of the law which holds there."""
    law = {"early": 0.0, "pace": 1.0, **change}
    lengths, flights = [1.0], []
    while lengths[-1] > 1e-20:
        late = lengths[-1] <= law["about"]
        flights.append(lengths[-1] * ((1.0 - law["early"]) / law["pace"] if late else 1.0))
        lengths.append(lengths[-1] * (law["later"] if late else law["share"]))
    run = hy.simulate(
        Turning(**law), {"left": 1.0, "length": 1.0}, (0.0, 40.0), **SOLVERS[solver], rtol=1e-9
    )
    (point,) = run.zeno
    assert run.mode == "ends"
    assert abs(point.t - math.fsum(flights)) <= point.t_error
