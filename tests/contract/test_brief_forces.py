"""Forces that switch or act briefly: steps end on them; what is missed ``t_error`` covers.

Truth is piecewise polynomial, or an integral known in closed form.
"""

import math
import re

import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

import hybrid as hy

from .ways import spread

#: Ways whose methods know of no place at which a flow changes its formula.
METHODS = ["DOP853", "Radau", "LSODA", "Dopri8", "classic"]

#: Frequencies from slow to a thousand switchings a unit of time.
FREQUENCIES = [0.1, 1.0, 3.0, 7.0, 11.0, 20.0, 137.0, 1000.0]


class Square(hy.Automaton):
    """A square wave, its sum, and that of a second wave that switches with every other of it."""

    v = hy.state()
    u = hy.state()
    w: float = hy.parameter(11.0)

    @hy.mode
    def flow(self, t, s):
        return jnp.where(jnp.sin(self.w * t) > 0, 1.0, 0.0), jnp.sign(jnp.sin(0.5 * self.w * t))


class Clock(hy.Automaton):
    """A pulse of width ``d`` in each period ``p``, a staircase and a saw, by whole numbers."""

    v = hy.state()
    u = hy.state()
    z = hy.state()
    p: float = hy.parameter(0.7)
    d: float = hy.parameter(0.1)

    @hy.mode
    def flow(self, t, s):
        pulse = jnp.where(jnp.mod(t, self.p) < self.d, 1.0 / self.d, 0.0)
        return pulse, jnp.floor(t / self.p), jnp.round(t / self.p) - t / self.p


class Zone(hy.Automaton):
    """A body that crosses a thin zone with a force of one over its width."""

    x = hy.state()
    v = hy.state()
    w: float = hy.parameter(1e-2)

    @hy.mode
    def flow(self, t, s):
        return 1.0, jnp.where((s.x - 0.5) ** 2 < self.w**2, 0.5 / self.w, 0.0)


class Pulses(hy.Automaton):
    """Smooth pulses of area 1 at 0.5: Gaussian, Lorentz's squared, and one by ``tanh``."""

    a = hy.state()
    b = hy.state()
    c = hy.state()
    w: float = hy.parameter(1e-2)

    @hy.mode
    def flow(self, t, s):
        z = (t - 0.5) / self.w
        bell = jnp.exp(-z * z) / math.sqrt(math.pi)
        return (
            bell / self.w,
            2.0 / (math.pi * self.w * (1.0 + z * z) ** 2),
            0.25 * (jnp.tanh(z + 2.0) - jnp.tanh(z - 2.0)) / (2.0 * self.w),
        )


class Gust(hy.Automaton):
    """A ball that falls from 1 through a gust of force in a thin layer at 0.5."""

    x = hy.state()
    v = hy.state()
    w: float = hy.parameter(0.01)
    force: float = hy.parameter(200.0)
    r: float = hy.parameter(0.3)

    @hy.mode
    def fall(self, t, s):
        return s.v, -9.81 + jnp.where(jnp.abs(s.x - 0.5) < self.w, self.force, 0.0)

    impact = hy.contact(fall, gap=lambda self, t, s: s.x, restitution="r")


class Pushed(hy.Automaton):
    """A ball under a force that switches in time."""

    x = hy.state()
    v = hy.state()
    w: float = hy.parameter(7.0)
    r: float = hy.parameter(0.6)

    @hy.mode
    def fall(self, t, s):
        return s.v, -9.81 - 4.0 * jnp.where(jnp.sin(self.w * t) > 0, 1.0, 0.0)

    impact = hy.contact(fall, gap=lambda self, t, s: s.x, restitution="r")


def square(w, until):
    """Times with ``sin(w t) > 0`` in ``(0, until)``."""
    period = 2 * math.pi / w
    whole = math.floor(until / period)
    return whole * period / 2 + min(until - whole * period, period / 2)


@pytest.mark.parametrize("until", [1.0, 2.5, 10.0])
@pytest.mark.parametrize("w", FREQUENCIES)
def test_a_square_wave_is_summed_to_rounding(w, until):
    """Wherever the run ends; 4e-16 of the time for each of the switchings, added up."""
    if w * until > 3000:
        until = 3000 / w
    run = hy.simulate(Square(w=w), [0.0, 0.0], (0.0, until), solver="taylor", save="jumps")
    allowed = 4e-16 * until * (4 + w * until / math.pi)
    assert abs(run.final.v - square(w, until)) <= allowed
    assert abs(run.final.u - (2 * square(0.5 * w, until) - until)) <= allowed


def test_no_switching_is_late():
    """The kink of the sum lies at each k pi / w, from both sides, to 1e-12 of a unit."""
    run = hy.simulate(Square(w=11.0), [0.0, 0.0], (0.0, 10.0), solver="taylor")
    for k in range(1, 35):
        t = k * math.pi / 11.0
        before, here, after = (float(run(t + d).v) for d in (-1e-3, 0.0, 1e-3))
        rates = [1.0, 0.0] if k % 2 else [0.0, 1.0]
        np.testing.assert_allclose(
            [here - before, after - here], np.array(rates) * 1e-3, atol=1e-12
        )


@pytest.mark.parametrize(("p", "d"), [(0.7, 0.1), (1.0, 0.25), (0.01, 0.003), (0.5, 1e-6)])
def test_whole_numbers_switch_a_force(p, d):
    """``mod``, ``floor`` and ``round``: rounding of the time, magnified by the force, added up."""
    until = 3.304
    run = hy.simulate(Clock(p=p, d=d), [0, 0, 0], (0.0, until), solver="taylor", save="jumps")
    count = math.floor(until / p)
    rest = until - count * p
    assert run.final.v == pytest.approx(count + min(rest / d, 1.0), abs=4e-16 * count / d + 1e-12)
    assert run.final.u == pytest.approx(p * count * (count - 1) / 2 + count * rest, rel=1e-12)
    last = min(rest, p - rest)
    assert run.final.z == pytest.approx(-(last**2) / (2 * p), abs=1e-12)


@pytest.mark.parametrize("w", [10.0**-k for k in range(1, 10)])
@pytest.mark.parametrize("until", [0.7, 1.2, 100.0])
def test_a_thin_zone_is_not_stepped_over(w, until):
    """Its edges are as exact as x is, which is 1e-16 over the width."""
    run = hy.simulate(Zone(w=w), [0.0, 0.0], (0.0, until), solver="taylor")
    assert run.final.v == pytest.approx(1.0, abs=4e-16 / w + 1e-12)


@pytest.mark.parametrize("way", METHODS, indirect=True)
@pytest.mark.parametrize("w", [1e-1, 1e-3, 1e-5])
@pytest.mark.parametrize("until", [0.7, 1.2, 100.0])
def test_no_method_steps_over_a_thin_zone(way, w, until):
    """The place of its edges is lost by some tolerances of 1e-8 at most; they are 1e-12 apart."""
    result = way.run(Zone(w=w), [0.0, 0.0], (0.0, until))
    assert result.final.v == pytest.approx(1.0, abs=1e-7)


@pytest.mark.parametrize("way", METHODS, indirect=True)
@pytest.mark.parametrize(("w", "until"), [(1.0, 10.0), (11.0, 2.5), (137.0, 1.0)])
def test_every_method_ends_steps_where_a_force_switches(way, w, until):
    """Between, the force is constant: there is the tolerance of 1e-8 to lose where it begins."""
    result = way.run(Square(w=w), [0.0, 0.0], (0.0, until))
    assert result.final.v == pytest.approx(square(w, until), abs=1e-8)
    assert result.final.u == pytest.approx(2 * square(0.5 * w, until) - until, abs=1e-8)


@pytest.mark.parametrize("w", [10.0**-k for k in range(2, 8)])
@pytest.mark.parametrize("start", [0.0, 1.0])
def test_a_smooth_pulse_is_not_stepped_over(w, start):
    """However narrow, and flat to rounding from afar; the tail of Lorentz's is 4/3 (2 w)^3 / pi."""
    run = hy.simulate(Pulses(w=w), [start] * 3, (0.0, 1.2), solver="taylor")
    allowed = 1e-12 + 2e-16 / w
    assert run.final.a == pytest.approx(start + 1.0, abs=allowed)
    assert run.final.b == pytest.approx(start + 1.0, abs=allowed + 4 * w**3)
    assert run.final.c == pytest.approx(start + 1.0, abs=allowed)


def gust_ends(w, force, r):
    """When the impacts accumulate: falls by v dv = a dx, then bounces that stay below the gust."""
    g, v, t = 9.81, 0.0, 0.0
    for height, a in ((0.5 - w, -g), (2 * w, force - g), (0.5 - w, -g)):
        new = -math.sqrt(v * v - 2 * a * height)
        t, v = t + (new - v) / a, new
    assert (r * v) ** 2 / (2 * g) < 0.5 - w
    return t + 2 * r * -v / (g * (1 - r))


@pytest.mark.parametrize(("w", "force"), [(0.01, 200.0), (1e-3, 2000.0), (1e-5, -3e5), (1e-7, 1e7)])
def test_the_bound_covers_a_gust_that_was_missed(way, w, force):
    """And no verdict is "certified" where it does not."""
    result = way.run(Gust(w=w, force=force), {"x": 1.0, "v": 0.0}, (0.0, 1.5))
    exact = gust_ends(w, force, 0.3)
    if way.tells("bound"):
        assert abs(result.t_inf - exact) <= result.t_error
    if way.name in ("taylor", "ensemble"):
        assert result.t_inf == pytest.approx(exact, abs=1e-6 + 1e-16 / w)


@pytest.mark.parametrize(
    ("share", "w"), spread([0.7, 1.0, 1.9, -3.0], [10.0**-k for k in range(1, 9)])
)
def test_the_bound_covers_the_rounding_of_a_thin_zone(w, share):
    """Where its edges are is known to the rounding of x, which is 1e-16 over the width."""
    run = hy.simulate(Gust(w=w, force=share / w), [1.0, 0.0], (0.0, 1.5), solver="taylor")
    assert abs(run.zeno[0].t - gust_ends(w, share / w, 0.3)) <= run.zeno[0].t_error


@pytest.mark.parametrize("until", [1.9, 3.0, 8.0, 12.0, 100.0])
def test_the_answer_does_not_depend_on_the_last_time(until):
    """A ball pushed by a square wave, against parabolas; the bound holds, and is not idle."""
    exact = 1.71187330548
    run = hy.simulate(Pushed(), [1.0, 0.0], (0.0, until), solver="taylor")
    assert run.zeno[0].t == pytest.approx(exact, abs=1e-11)
    run = hy.simulate(Pushed(), [1.0, 0.0], (0.0, until), rtol=1e-10)
    # the reference is rounded to 5e-12
    assert abs(run.zeno[0].t - exact) <= run.zeno[0].t_error + 5e-12 <= 1e-10


class Restless(hy.Automaton):
    """A force that swings without end before x = 0 is reached."""

    x = hy.state()
    v = hy.state()

    @hy.mode
    def flow(self, t, s):
        return -1.0 + 0.1 * s.v, jnp.sin(1.0 / s.x)


@pytest.mark.parametrize("save", ["dense", "jumps"])
def test_a_force_that_swings_without_end_is_an_error(save):
    """Not a run without end: after some 1e5 steps, which is well below a second."""
    with pytest.raises(hy.FlowError, match="the steps become ever shorter") as fault:
        hy.simulate(Restless(), [1.0, 0.0], (0.0, 2.0), solver="taylor", save=save)
    counted = re.search(r"(\d+) in this arc", str(fault.value))
    assert 8192 <= int(counted[1]) <= 2e5


def test_steps_that_become_shorter_for_a_time_are_no_error():
    """A swing that quickens a thousandfold, and one that does so for ever, end."""

    class Chirp(hy.Automaton):
        v = hy.state()
        k: float = hy.parameter(1.0)

        @hy.mode
        def flow(self, t, s):
            return jnp.cos(500.0 * jnp.tanh(5.0 * t) + self.k * t * t)

    for k, until in ((1.0, 3.0), (2000.0, 2.0)):
        run = hy.simulate(Chirp(k=k), [0.0], (0.0, until), solver="taylor", save="jumps")
        assert run.t1 == until


class Nudged(hy.Automaton):
    """A ball, g = 2, thrown up at the speed 1; a force acts on it for a time."""

    x = hy.state()
    v = hy.state()
    r: float = hy.parameter(0.5)
    since: float = hy.parameter(1.0)
    lasts: float = hy.parameter(0.1)
    force: float = hy.parameter(1.0)

    @hy.mode
    def flight(self, t, s):
        acts = (t > self.since) & (t < self.since + self.lasts)
        return s.v, jnp.where(acts, self.force, 0.0) - 2.0

    ground = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")


def pushed_limit(r, since, lasts, force):
    """Where its impacts accumulate if all forces press it down: in 50 digits, flight by flight."""
    ends = [mp.mpf(since), mp.mpf(since) + mp.mpf(lasts), mp.inf]
    t, x, v = mp.mpf(0), mp.mpf(0), mp.mpf(1)
    for end, g in zip(ends, [mp.mpf(2), 2 - mp.mpf(force), mp.mpf(2)], strict=True):
        while True:
            flies = (v + mp.sqrt(v * v + 2 * g * x)) / g
            if v < 1e-40 and not x:
                return t + flies / (1 - mp.mpf(r))
            if t + flies > end:
                break
            t, x, v = t + flies, mp.mpf(0), r * (g * flies - v)
        d = end - t
        t, x, v = end, x + v * d - g * d * d / 2, v - g * d


#: Restitution; when the force begins, before the limit without it; how long it acts; and itself. It
#: begins and ends within a flight or two, or is faint.
PUSHES = [
    (0.3358, 4e-10, 1.5e-11, 0.95),
    (0.6615, 4.5e-10, 4.4e-10, 0.98),
    (0.3855, 4.1e-7, 2e-6, 2e-6),
    (0.5, 1e-6, 1.0, 1e-6),
    (0.5, 1e-3, 1e-4, 1e-9),
    (0.5, 1e-9, 1e-10, 1.0),
]


def test_a_brief_push_up_in_a_tail_is_flown():
    """Its end is some 1e-12 ahead of a step that might reach the end of the run. The limit is that
    of its parabolas in 50 digits."""
    given = 0.3024599921030956, 1.4336095256678487, 1.858387535371909e-10, 5.760577611710074
    model = Nudged(**dict(zip(["r", "since", "lasts", "force"], given, strict=True)))
    run = hy.simulate(model, {"x": 0.0, "v": 1.0}, (0.0, 4.0), solver="taylor")
    assert run.zeno[0].t == pytest.approx(1.4336095271065781583, abs=2e-15)


@pytest.mark.parametrize(("r", "before", "lasts", "force"), PUSHES)
@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_a_force_that_switches_in_a_tail_counts(solver, r, before, lasts, force):
    """Points of a sum may meet it, and a faint one is within what bounds may be off; the limit is
    where it is, and bound and enclosure hold it."""
    since = 1.0 / (1.0 - r) - before
    model = Nudged(r=r, since=since, lasts=lasts, force=force)
    run = hy.simulate(model, {"x": 0.0, "v": 1.0}, (0.0, 4.0), solver=solver)
    with mp.workdps(50):
        exact = pushed_limit(r, since, lasts, force)
        (point,) = run.zeno
        assert abs(point.t - exact) <= point.t_error
        if solver == "taylor":
            assert abs(point.t - exact) < 2e-15  # spacings of the time
        assert point.enclosure is None or point.enclosure[0] <= exact <= point.enclosure[1]


class Resting(hy.Automaton):
    """A body comes to rest; meanwhile ``p`` goes on, and passes a zone of width ``2 w`` at ``c``.
    Signs that are zero while it rests are decided by rounding."""

    x = hy.state()
    v = hy.state()
    p = hy.state()
    q = hy.state()
    c: float = hy.parameter(2.0)
    w: float = hy.parameter(0.01)

    def inside(self, s):
        return jnp.where(jnp.abs(s.p - self.c) < self.w, 1.0, 0.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -9.81 - 0.3 * jnp.sign(s.v), 1.0, self.inside(s)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)


class Sliding(Resting):
    """The state slides on ``x = 0``, by equal shares of two flows with other rates of ``q``."""

    @hy.mode(initial=True)
    def flight(self, t, s):
        return -1.0, jnp.abs(s.x), 1.0, 0.5 * self.inside(s)

    @hy.mode
    def below(self, t, s):
        return 1.0, jnp.abs(s.x), 1.0, 1.5 * self.inside(s)

    impact = hy.switching(flight, below, surface=lambda self, t, s: s.x)


@pytest.mark.parametrize("way", METHODS, indirect=True)
@pytest.mark.parametrize("cls", [Resting, Sliding])
@pytest.mark.parametrize("w", [1e-2, 1e-5])
def test_no_method_steps_over_a_thin_zone_while_the_state_is_held(way, cls, w):
    """At rest, and sliding: the state passes the zone after 2, 2.71 and 3.9."""
    start, places = {"x": 0.1, "v": 0.0, "p": 0.0, "q": 0.0}, [2.0, 2.71, 3.9]
    for c in places:
        result = way.run(cls(c=c, w=w), start, (0.0, 5.0))
        assert result.final.q == pytest.approx(2 * w, abs=1e-7)


class Wind(hy.Automaton):
    """A drag of constant size against the motion relative to a floor, which moves: as ``rate`` and
    ``rise`` have it, or not at all."""

    x = hy.state()
    v = hy.state()
    rate: float = hy.parameter(0.0)
    rise: float = hy.parameter(0.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -10.0 - jnp.sign(s.v - self.rate - self.rise * t)

    impact = hy.contact(
        flight,
        gap=lambda self, t, s: s.x - self.rate * t - 0.5 * self.rise * t * t,
        restitution=0.5,
    )


@pytest.mark.parametrize("way", ["taylor", *METHODS[:2], METHODS[3]], indirect=True)
@pytest.mark.parametrize("rate", [0.0, 1.0, 30.0])
@pytest.mark.parametrize("rise", [0.0, 2.0, -3.0])
def test_impacts_accumulate_in_a_wind_that_turns_in_each_flight(way, rate, rise):
    """Flights become lower than the rounding of the state, which hides whether they still rise; the
    sum is that of a geometric series, the same however the floor moves uniformly. Where rounding
    brings the body to rest before a sum is made, the limit is there."""
    up, down = 11.0 + rise, 9.0 + rise
    fall = math.sqrt(2.0 * 0.2 / down)
    speed, ratio = 0.5 * down * fall, 0.5 * math.sqrt(down / up)
    t_inf = fall + speed * (1.0 / up + 1.0 / math.sqrt(up * down)) / (1.0 - ratio)
    model = Wind(rate=rate, rise=rise)
    result = way.run(model, {"x": 0.2, "v": rate}, (0.0, 1.5))
    assert (result.status, result.mode) == ("reached_end", "flight.rest(impact)")
    assert result.accumulations == 1
    assert abs(result.t_inf - t_inf) <= result.t_error <= 1e-6
    assert len(result.times) < 100
    assert result.final.x == pytest.approx(1.5 * rate + 1.125 * rise, rel=1e-9, abs=1e-9)
