"""Rule 9 of docs/semantics.md, on every way in: what is seen of a record that jumps."""

import math
import re

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from models.delay_bounce import HISTORY, DelayBounce
from models.delay_jump import DelayJump
from models.pyragas import Pyragas

from .. import delayed
from .ways import COMPILED, SOLVERS_AND_COMPILED, later, spread

WAYS = SOLVERS_AND_COMPILED

#: Tolerances at which every way keeps about eight digits.
TIGHT = {"rtol": 1e-9, "atol": 1e-11}

#: BDF and LSODA restart at order one at each breaking point, RK23 is of order 3.
LOOSE = {"BDF": 1e-6, "LSODA": 1e-6, "RK23": 1e-7}


def tolerance(way, tight=1e-8):
    return LOOSE.get(way.name, tight)


class Seen(hy.Automaton):
    """``y`` jumps from 1 to 3 at 1/2; a lag of 1 later something looks."""

    y = hy.state()
    z = hy.state(doc="what a reset saw")

    level: float = hy.parameter(2.0)
    look: float = hy.parameter(9.0)

    @hy.mode(initial=True)
    def waits(self, t, s):
        return 0.0, 0.0

    @hy.mode
    def after(self, t, s):
        return 0.0, 0.0

    @hy.edge(waits, to=waits, guard=lambda self, t, s: t - 0.5, crossing=hy.EITHER)
    def kick(self, t, s):
        return s.replace(y=3.0)

    @hy.edge(waits, to=after, guard=lambda self, t, s, past: self.level - past(1.0).y)
    def carried(self, t, s, past):
        return s.replace(z=past(1.0).y)

    @hy.edge(waits, to=after, guard=lambda self, t, s: self.look - t)
    def comes(self, t, s, past):
        return s.replace(z=past(1.0).y)


def fired(way, result, edges):
    """These edges and no others, by name where the way tells."""
    assert result.status == "reached_end"
    assert result.jumps == len(edges)
    if way.tells("edges"):
        assert result.edges == edges


def test_a_breaking_point_is_no_jump(way):
    """One arc from the jump on, through breaking points at 1, 3/2, 2, ...; exact polynomials."""
    ends = np.array([1.5, 3.0])
    options = {"rtol": 1e-7, "atol": 1e-9}
    middle, result = way.many(DelayJump(), [{"y": 1.0}] * 2, (0.0, ends), **options)
    fired(way, result, ["kick"])
    assert middle.final.y == pytest.approx(13 / 8, abs=1e-5)
    assert result.final.y == pytest.approx(-11 / 12, abs=1e-4)
    if way.tells("before"):
        assert result.before.y[0] == pytest.approx(0.5, abs=1e-6)
    if way.tells("run"):
        assert [arc.t0 for arc in result.run.arcs] == [0.0, 0.5]
        assert result.run(0.5, side="left").y == pytest.approx(0.5, abs=1e-6)
        assert result.run(1.5).y == pytest.approx(13 / 8, abs=1e-5)


def test_a_guard_that_comes_to_zero_there_sees_left_values(way):
    """Its jump ends the arc before the breaking point."""
    result = way.run(Seen(level=9.0, look=1.5), {"y": 1.0, "z": 0.0}, (0.0, 3.0))
    fired(way, result, ["kick", "comes"])
    assert result.times[1] == 1.5
    assert result.final.z == pytest.approx(1.0, abs=1e-12)


class Timer(hy.Automaton):
    """A timer that is a state; each time it counts, and adds the count that was a lag before."""

    count = hy.state()
    seen = hy.state()
    timer = hy.state()

    period: float = hy.parameter(0.1)
    lag: float = hy.parameter(0.3)
    rate: float = hy.parameter(1.0)

    @hy.mode
    def runs(self, t, s):
        return 0.0, 0.0, self.rate

    @hy.edge(runs, guard=lambda self, t, s: self.rate * self.period - s.timer)
    def ring(self, t, s, past):
        return s.count + 1.0, s.seen + past(self.lag).count, 0.0


class Wave(Timer):
    """The same where a wave passes zero, which no reset changes: it must not fire there twice."""

    @hy.mode
    def runs(self, t, s):
        return 0.0, 0.0, 0.0

    @hy.edge(
        runs,
        guard=lambda self, t, s: self.rate * jnp.sin(jnp.pi * t / self.period),
        crossing=hy.EITHER,
    )
    def ring(self, t, s, past):
        return s.replace(count=s.count + 1.0, seen=s.seen + past(self.lag).count)


@pytest.mark.parametrize(
    ("cls", "start", "period", "lags", "rate"),
    [
        (Timer, 0.0, 0.1, 3, 1.0),
        (Wave, 0.35, 0.7, 3, 1.0),
        *later(
            (Timer, 0.0, 0.7, 4, 7.0),
            (Timer, 10.0, 1 / 3, 5, 7.0),
            (Wave, 0.05, 0.1, 1, 1.0),
            (Wave, 0.15, 0.3, 4, 7.0),
            (Wave, 0.05, 0.1, 5, 0.37),
        ),
    ],
)
def test_what_fires_a_lag_behind_its_own_jump_sees_left_values(way, cls, start, period, lags, rate):
    """The lag is so many periods, in exact arithmetic; how times round does not matter."""
    model = cls(period=period, lag=lags * period, rate=rate)
    begin = {"count": 0.0, "seen": 0.0, "timer": 0.0}
    result = way.run(model, begin, (start, start + 24.2 * period), rtol=1e-9, atol=1e-12)
    assert (result.status, result.jumps, result.final.count) == ("reached_end", 24, 24.0)
    assert result.final.seen == pytest.approx(sum(range(24 - lags)), abs=1e-9)


def test_a_guard_carried_over_zero_fires_there_and_sees_right_values(way):
    """By a jump of what it sees."""
    result = way.run(Seen(), {"y": 1.0, "z": 0.0}, (0.0, 3.0))
    fired(way, result, ["kick", "carried"])
    assert result.times[1] == 1.5
    assert result.final.z == pytest.approx(3.0, abs=1e-12)


def test_a_history_that_does_not_lead_to_the_start_is_a_jump(way):
    """Seen a lag later: from 0 before it to 3 at the start, which carries a guard at 1."""
    before = {"y": 0.0, "z": 0.0}
    result = way.run(Seen(), {"y": 3.0, "z": 0.0}, (0.0, 3.0), history=before)
    fired(way, result, ["kick", "carried"])
    assert result.times[1] == 1.0
    assert result.final.z == pytest.approx(3.0, abs=1e-12)


class Leaping(hy.Automaton):
    """An oscillator; at ``on`` a lag leaps from ``lag`` to twice that. An edge that is carried over
    zero by it puts down what it sees."""

    x = hy.state()
    y = hy.state()
    seen = hy.state()
    lag: float = hy.parameter(0.6)
    on: float = hy.parameter(1.2)

    @hy.mode
    def swings(self, t, s):
        return s.y, -s.x, 0.0

    def look(self, t, past):
        return past(jnp.where(t < self.on, self.lag, 2.0 * self.lag))

    @hy.edge(swings, guard=lambda self, t, s, past: self.look(t, past).x)
    def leaps(self, t, s, past):
        return s.replace(seen=self.look(t, past).y)


@pytest.mark.parametrize("lag", [0.6, 0.31, *later(0.45, 0.55)])
@pytest.mark.parametrize("on", [1.3, *later(1.7)])
def test_the_reset_of_what_a_lag_carries_sees_what_it_shows_then(way, lag, on):
    """Not the window that the lag has left, continued: ``x = sin(t - phase)`` falls a lag ago."""
    phase, begin = on - 1.5 * lag, on - 0.4 * lag
    start = {"x": math.sin(begin - phase), "y": math.cos(begin - phase), "seen": 0.0}
    history = {"x": lambda t: jnp.sin(t - phase), "y": lambda t: jnp.cos(t - phase), "seen": 0.0}
    span = begin, on + 0.3 * lag
    result = way.run(Leaping(lag=lag, on=on), start, span, history=history, **TIGHT)
    assert (result.status, result.jumps) == ("reached_end", 1)
    assert result.final.seen == pytest.approx(math.cos(0.5 * lag), abs=tolerance(way))


JUMPING = {
    "where": lambda t: jnp.where(t < -0.3286, 1.4 + 0.2 * t, 0.4),
    "floor": lambda t: 0.4 - jnp.floor(t + 0.3286),  # as it is to the left of there
    "sign": lambda t: 1.0 - 0.5 * jnp.sign(t + 0.3286) + 0.1 * t,
    "steep": lambda t: 0.9 - 0.5 * jnp.tanh(1e5 * (t + 0.3286)),
}


@pytest.mark.parametrize(("history", "lag"), spread([*JUMPING], [0.5378688370073788, 0.7, 0.91]))
def test_a_jump_within_the_history_is_a_breaking_point(way, history, lag):
    """A guard that it carries over zero fires there, once; so does one that comes over steeply."""
    given = {"y": JUMPING[history], "z": 0.0}
    result = way.run(
        Passed(lag=lag), {"y": float(given["y"](0.0)), "z": 0.0}, (0.0, lag - 1e-3), history=given
    )
    assert (result.status, result.jumps, result.final.z) == ("reached_end", 1, 1.0)
    if way.tells("edges"):
        abs_error = 2e-6 if history == "steep" else 1e-14
        assert result.times[0] == pytest.approx(lag - 0.3286, abs=abs_error)


def test_what_a_restarted_memory_shows(way):
    """The state after the jump, and not the jump: nothing is carried a lag later."""
    start, options = {"y": 1.0, "z": 0.0}, {"memory": "restart"}
    result = way.run(Seen(level=4.0), start, (0.0, 3.0), **options)
    fired(way, result, ["kick"])
    result = way.run(Seen(level=4.0, look=0.75), start, (0.0, 3.0), **options)
    assert result.final.z == pytest.approx(3.0, abs=1e-12)


class Passed(hy.Automaton):
    """``z`` counts how often ``y`` a lag ago passes 0.98."""

    y = hy.state()
    z = hy.state()
    lag: float = hy.parameter(0.5)

    @hy.mode
    def waits(self, t, s):
        return 0.0, 0.0

    @hy.edge(waits, guard=lambda self, t, s, past: past(self.lag).y - 0.98, crossing=hy.EITHER)
    def seen(self, t, s):
        return s.replace(z=s.z + 1.0)


class Lifted(hy.Automaton):
    """``y`` jumps from 1 to 3 at 1/2, which carries a guard below zero; its reset raises it."""

    y = hy.state()
    z = hy.state()
    lift: float = hy.parameter(3.0)

    @hy.mode
    def waits(self, t, s):
        return 0.0, 0.0

    @hy.edge(waits, to=waits, guard=lambda self, t, s: t - 0.5, crossing=hy.EITHER)
    def kick(self, t, s):
        return s.replace(y=3.0)

    @hy.edge(waits, to=waits, guard=lambda self, t, s, past: 2.0 - past(1.0).y + s.z)
    def carried(self, t, s):
        return s.replace(z=s.z + self.lift)


def test_the_reset_of_a_guard_carried_below_zero_must_raise_it(way):
    """By more than it has fallen, or the state is outside the domain."""
    models = {"lift": [3.0, 0.5]}
    raised, outside = way.many(Lifted(), [{"y": 1.0, "z": 0.0}] * 2, (0.0, 3.0), models)
    fired(way, raised, ["kick", "carried"])
    assert raised.final.z == 3.0
    assert outside.status == "refused"


class Late(hy.Automaton):
    """``y`` jumps from 1 to 3 at 1/2, which a guard without an inside sees a lag later."""

    y = hy.state()
    z = hy.state()

    @hy.mode
    def flow(self, t, s):
        return 0.0, 0.0

    @hy.edge(flow, to=flow, guard=lambda self, t, s: t - 0.5, crossing=hy.EITHER)
    def kick(self, t, s):
        return s.replace(y=s.y + 2.0)

    @hy.edge(flow, to=flow, guard=lambda self, t, s, past: past(1.0).y - 2.0, crossing=hy.EITHER)
    def seen(self, t, s, past):
        return s.replace(z=past(1.0).y)


def test_an_edge_carried_over_zero_may_leave_its_guard_as_it_is(way):
    """The guard is not zero after the jump: the run goes on on its other side."""
    result = way.run(Late(), {"y": 1.0, "z": 0.0}, (0.0, 4.0))
    fired(way, result, ["kick", "seen"])
    assert result.final.z == pytest.approx(3.0, abs=1e-12)  # rounding of a window


def test_a_load_carried_below_zero_releases_there(way):
    """At ``t0 + tau``, where the history did not lead to the start."""
    start, ends = {"y": 0.05, "v": 0.0}, np.array([0.9, 1.1, 2.0])
    held, lifted, result = way.many(DelayBounce(), [start] * 3, (0.0, ends), history=HISTORY)
    assert held.final.y == 0.0
    assert lifted.final.y > 0.0
    assert np.abs(result.times - 1.0).min() <= 1e-15
    if way.tells("edges"):
        releases = np.array(result.edges) == "impact.release"
        assert result.times[releases][0] == pytest.approx(1.0, abs=1e-15)
    if way.tells("run"):
        assert result.zeno[0].t_release == pytest.approx(1.0, abs=1e-15)
        assert result.run(1.1).y > 0.0


def test_an_accumulation_is_seen_and_passed(way):
    """A rest begins, and ends by what is seen of the flights before it."""
    model, start = Pyragas(C=60.0, r=0.2), {"x1": 2.5, "x2": 0.0}
    known = [2.450940744376058, 2.659592992729097, 3.489179517880435, 3.873441893315749]
    result = way.run(model, start, (0.0, 4.0), rtol=1e-6, atol=1e-8)
    if way.tells("all zeno"):
        times = [t for point in result.zeno for t in (point.t, point.t_release)]
        assert times == pytest.approx(known, abs=2e-2)
    assert result.t_inf == pytest.approx(known[0], abs=2e-2)
    for release in known[1::2]:
        assert np.abs(result.times - release).min() <= 2e-2
    if way.tells("accumulations"):
        assert result.accumulations == 2


class Watched(hy.Automaton):
    """A ball dropped from 1/2 that comes to rest at 3, and the sum of what is seen of it."""

    y = hy.state()
    v = hy.state()
    w = hy.state(doc="sum of what is seen")

    of_speed: float = hy.parameter(0.0)
    tau: float = hy.parameter(0.7)

    @hy.mode
    def flight(self, t, s, past):
        seen = past(self.tau)
        return s.v, -1.0, (1.0 - self.of_speed) * seen.y + self.of_speed * seen.v

    ground = hy.contact(flight, gap=lambda self, t, s: s.y, restitution=0.5)


#: What is seen of it from 0 to 5: the sum of its heights, or of its speeds, as parabolas have it.
WATCHED = {
    # at 1/2 before 0; the first fall, then flights of 2/3 u^3 for u = 1/2, 1/4, ...
    ("keep", 0.0): 0.7 * 0.5 + 1 / 3 + 2 / 3 * (1 / 8) / (1 - 1 / 8),
    ("keep", 1.0): -0.5,
    # for a lag after each impact its height, 0, and its speed; then what was a lag ago
    ("restart", 0.0): 0.35 + (0.15 - 0.0045) + (0.0225 - 0.0045),
    ("restart", 1.0): -0.045 + 0.35 + (0.15 - 0.045) + (1 / 8) / (1 - 1 / 4),
}


@pytest.mark.parametrize("memory", ["keep", "restart"])
def test_all_of_an_accumulation_is_seen_a_lag_later(way, memory):
    """Infinitely many flights, then rest; each jump of the record is one, the limit too."""
    start, asked = {"y": 0.5, "v": 0.0, "w": 0.0}, {"of_speed": [0.0, 1.0]}
    results = way.many(Watched(), [start] * 2, (0.0, 5.0), asked, memory=memory, **TIGHT)
    for of_speed, result in zip(asked["of_speed"], results, strict=True):
        assert result.t_inf == pytest.approx(3.0, abs=tolerance(way))
        assert result.final.w == pytest.approx(WATCHED[memory, of_speed], abs=tolerance(way))
        if way.tells("run"):
            ends = [arc.t0 + arc.low + s.end for arc in result.run.arcs for s in arc.segments]
            assert np.abs(np.array(ends) - 3.7).min() <= 10 * tolerance(way)


class Echoes(hy.Automaton):
    """``y' = -y(t - lag) - y(t - other)``, raised by 2 at 1/2."""

    y = hy.state()
    lag: float = hy.parameter(1.0)
    other: float = hy.parameter(0.3)

    @hy.mode
    def flow(self, t, s, past):
        return -past(self.lag).y - past(self.other).y

    @hy.edge(flow, to=flow, guard=lambda self, t, s: 0.5 - t)
    def raised(self, t, s):
        return s.replace(y=s.y + 2.0)


def echo(t, a=1.0, b=0.3):
    """What the two lags make of a unit jump at 0 out of nothing: a polynomial for each path."""
    paths = [(j, k) for j in range(12) for k in range(40) if t >= j * a + k * b]
    return sum(
        math.comb(j + k, j) * (j * a + k * b - t) ** (j + k) / math.factorial(j + k)
        for j, k in paths
    )


@pytest.mark.each_method
def test_breaking_points_are_followed_through_all_lags(way):
    """Jumps at 0 and 1/2 return after 0.3, 0.6, 0.9, 1, 1.2, 1.3, ..., smoother each time."""
    ends = np.array([0.25, 0.9, 1.7, 3.0])
    asked = {"history": {"y": 0.0}, **TIGHT}
    for t, result in zip(
        ends, way.many(Echoes(), [{"y": 1.0}] * 4, (0.0, ends), **asked), strict=True
    ):
        exact = echo(t) + 2.0 * echo(t - 0.5)
        assert result.final.y == pytest.approx(exact, abs=10 * tolerance(way))


def test_a_negative_lag_is_an_error(way):
    """Said with the model, the time, and which lag it is, by the ways that have words for it."""
    result = way.run(Echoes(lag=-1.0), {"y": 1.0}, (0.0, 1.0))
    assert result.status == "forgotten"
    if way.name not in COMPILED:
        assert re.search(r"Echoes, t = 0.0, .*: the lag lag is -1.0", result.said)


def test_a_history_that_is_not_finite_where_it_is_seen_is_an_error(way):
    """It has no value before -1/2, where it is seen from the start on."""
    history = {"y": lambda t: jnp.where(t < -0.5, jnp.nan, 1.0)}
    result = way.run(Echoes(), {"y": 1.0}, (0.0, 1.0), history=history)
    assert result.status == "forgotten"
    assert "not finite" in result.said


class Moving(hy.Automaton):
    """A lag that grows: what is seen moves at half the speed."""

    y = hy.state()

    @hy.mode
    def flow(self, t, s, past):
        return past(1.0 + 0.5 * t).y


def test_a_lag_that_moves_is_followed(way):
    """``y' = y(t / 2 - 1)`` with 1 before 0: ``3 + (t^2 - 4) / 4`` from 2 to 6."""
    result = way.run(Moving(), {"y": 1.0}, (0.0, 4.0), **TIGHT)
    assert result.final.y == pytest.approx(6.0, abs=10 * tolerance(way))


class Turned(hy.Automaton):
    """``sin(3 t) / 3`` seen to pass 0.3 one way and the other, by a guard and by its negative."""

    y = hy.state()
    n = hy.state()
    half: float = hy.parameter(1.0, doc="the lag is half the time, or 1e-3")

    def seen(self, t, past):
        return past(self.half * t / 2 + (1.0 - self.half) * 1e-3).y - 0.3

    @hy.mode(initial=True)
    def low(self, t, s):
        return jnp.cos(3.0 * t), 0.0

    @hy.mode
    def high(self, t, s):
        return jnp.cos(3.0 * t), 0.0

    @hy.edge(low, to=high, guard=lambda self, t, s, past: -self.seen(t, past))
    def rises(self, t, s):
        return s.replace(n=s.n + 1.0)

    @hy.edge(high, to=low, guard=lambda self, t, s, past: self.seen(t, past))
    def falls(self, t, s):
        return s.replace(n=s.n + 1.0)


#: An explicit method, an implicit one, series, and steps made ahead.
FOUR = ["DOP853", "Radau", "taylor", "Tsit5"]

#: LSODA, and each other method, goes on in steps of about a lag where that is short.
SHORT = ["DOP853", "taylor", "Dopri8", "ensemble", "as_function"]


@pytest.mark.parametrize(
    "way", [*SHORT, *later(*(name for name in WAYS if name not in SHORT))], indirect=True
)
def test_a_guard_that_has_fired_is_zero_after_its_jump(way):
    """Lags that move, and such as are shorter than steps: what is seen is read anew, only as well
    as the tolerances ask for, but not where a guard has just come to zero through it."""
    start, before = {"y": 0.0, "n": 0.0}, {"y": 0.0, "n": 0.0}
    asked = {"half": [1.0, 0.0]}
    halves, shorts = way.many(Turned(), [start] * 2, (0.0, 6.0), asked, history=before)
    first, turn, period = math.asin(0.9) / 3, math.pi / 3, 2 * math.pi / 3
    passes = sorted(
        [first + k * period for k in range(3)] + [turn - first + k * period for k in range(3)]
    )
    fired(way, halves, ["rises", "falls"] * 2)
    np.testing.assert_allclose(halves.times, [2 * t for t in passes[:4]], atol=1e-4)
    fired(way, shorts, ["rises", "falls"] * 3)
    np.testing.assert_allclose(shorts.times, [t + 1e-3 for t in passes], atol=1e-4)


class Slider(delayed.Slider):
    """A relay against a delayed drive, and the sum of what is seen of it."""

    w = hy.state()

    @hy.mode(initial=True)
    def above(self, t, s, past):
        return past(1.0).d - 1.0, 1.0, past(1.0).d

    @hy.mode
    def below(self, t, s, past):
        return past(1.0).d + 1.0, 1.0, past(1.0).d


@pytest.mark.parametrize(
    ("memory", "seen", "x"),
    [
        ("keep", 1.5**2 / 2, 0.125),
        # 0 until 1/4, 1/4 for a lag, then d(t - 1); 2 for a lag from 2 on, where sliding ends
        ("restart", 0.25 + (1.0 - 0.25**2) / 2 + 2 * 0.5, 0.5),
    ],
)
def test_sliding_begins_and_ends_as_jumps_of_the_record_do(way, memory, seen, x):
    """From 1/4 it slides until the drive, which is ``t``, is seen to be 1, at 2."""
    start = {"x": 0.25, "d": 0.0, "w": 0.0}
    result = way.run(Slider(), start, (0.0, 2.5), memory=memory, **TIGHT)
    fired(way, result, ["zero", "zero.positive"])
    np.testing.assert_allclose(result.times, [0.25, 2.0], atol=tolerance(way))
    assert result.final.x == pytest.approx(x, abs=10 * tolerance(way))
    assert result.final.w == pytest.approx(seen, abs=10 * tolerance(way))


class Pushed(hy.Automaton):
    """A body at rest that is pushed up by what ``u`` was: ``t``, or ``2 sin t``."""

    u = hy.state()
    y = hy.state()
    v = hy.state()
    turns: float = hy.parameter(0.0)
    tau: float = hy.parameter(1.0)

    @hy.mode
    def flight(self, t, s, past):
        rate = (1.0 - self.turns) + self.turns * 2.0 * jnp.cos(t)
        return rate, s.v, past(self.tau).u - 1.0

    ground = hy.contact(flight, gap=lambda self, t, s: s.y, restitution=0.5)


def test_a_release_is_a_jump_of_the_record(way):
    """Restarted, it sees what pushes now: at 2 that is 2, at ``7 pi / 6`` it is -1.

    With its memory kept it sees ``t - 1`` throughout.
    """
    start, ends = {"u": 0.0, "y": 0.0, "v": 0.0}, np.array([2.5, 5.0])
    asked = {"turns": [0.0, 1.0], "tau": [1.0, np.pi]}
    thrown, held = way.many(Pushed(), [start] * 2, (0.0, ends), asked, memory="restart", **TIGHT)
    fired(way, thrown, ["ground.release"])
    assert thrown.times[0] == pytest.approx(2.0, abs=tolerance(way))
    assert thrown.final.y == pytest.approx(0.125, abs=10 * tolerance(way))
    fired(way, held, ["ground.release"])
    assert held.times[0] == pytest.approx(7 * np.pi / 6, abs=tolerance(way))
    assert (held.final.y, held.final.v) == (0.0, 0.0)
    if way.tells("mode"):
        assert held.mode == "flight.rest(ground)"
    kept = way.run(Pushed(), start, (0.0, 2.5), **TIGHT)
    assert kept.final.y == pytest.approx(0.5**3 / 6, abs=10 * tolerance(way))


def test_a_release_where_a_window_ends_does_not_hang_on_a_last_digit(way):
    """The load ends at ``1 + tau``, which is a breaking point, with either sign of its rounding.

    Which one it has depends on the steps, and so on the end of the run and on the machine.
    """
    start = {"u": 0.0, "y": 0.0, "v": 0.0}
    taus = [1.0, 0.5, 0.5, 1.0, 0.25, 0.5, 0.5]
    ends = np.array([2.0709208943793405, 1.6222474986054214, 1.7339312584921331, 4.188130325281924])
    ends = np.array([*ends, 1.541481091377864, 2.366829051933844, 3.318597195507168])
    for result, tau in zip(
        way.many(Pushed(), [start] * 7, (0.0, ends), {"tau": taus}, **TIGHT), taus, strict=True
    ):
        assert result.jumps >= 1
        assert result.times[0] == pytest.approx(1.0 + tau, abs=tolerance(way))


class Sees(hy.Automaton):
    """``y`` grows at 1/2; where it is seen above a height a load turns."""

    x = hy.state()
    v = hy.state()
    y = hy.state()
    tau: float = hy.parameter(0.2)
    height: float = hy.parameter(0.1)

    @hy.mode
    def rides(self, t, s, past):
        return s.v, jnp.where(past(self.tau).y > self.height, 3.0, -5.0), 0.5

    land = hy.contact(rides, gap=lambda self, t, s: s.x, restitution=0.3)


class SeesSurface(hy.Automaton):
    """The same, with a surface that moves away by 0.3."""

    x = hy.state()
    y = hy.state()
    tau: float = hy.parameter(0.2)
    height: float = hy.parameter(0.1)

    @hy.mode(initial=True)
    def above(self, t, s):
        return -1.0, 0.5

    @hy.mode
    def below(self, t, s):
        return 1.0, 0.5

    zero = hy.switching(
        positive=above,
        negative=below,
        surface=lambda self, t, s, past: s.x - jnp.where(past(self.tau).y > self.height, 0.3, 0.0),
    )


class SeesEdge(hy.Automaton):
    """The same, with an edge whose guard jumps."""

    x = hy.state()
    y = hy.state()
    tau: float = hy.parameter(0.2)
    height: float = hy.parameter(0.1)

    @hy.mode(initial=True)
    def above(self, t, s):
        return 0.0, 0.5

    @hy.mode
    def below(self, t, s):
        return 1.0, 0.5

    @hy.edge(
        above,
        to=below,
        guard=lambda self, t, s, past: jnp.where(past(self.tau).y > self.height, -1.0, 1.0),
    )
    def turns(self, t, s):
        return s


@pytest.mark.parametrize(
    ("model", "mode", "x"),
    [
        (Sees, "rides.rest(land)", 0.015),
        (SeesSurface, "slide(zero)", 0.1),
        (SeesEdge, "above", 0.1),
    ],
)
def test_what_turns_where_windows_end_is_seen_whatever_the_last_digits(way, model, mode, x):
    """It turns at ``2 tau``, which is a breaking point; rounding puts that on either side of it."""
    for tau, y in (0.5, 3.3), (0.25, 0.1), (0.3, 3.3), (1 / 3, 3.3), (0.7, 0.1), (0.2, 3.3):
        start = dict.fromkeys(model.spec.names, 0.0) | {"y": y}
        seen = model(tau=tau, height=y + 0.5 * tau)
        result = way.run(seen, start, (0.0, 2.0 * tau + 0.1), mode=mode, history=start)
        assert result.status == "reached_end"
        assert result.final.x == pytest.approx(x, abs=10 * tolerance(way))


class Counted(hy.Automaton):
    """``y = t`` is counted where it is seen to pass 2."""

    y = hy.state()
    n = hy.state()

    @hy.mode
    def flow(self, t, s):
        return 1.0, 0.0

    @hy.edge(flow, to=flow, guard=lambda self, t, s, past: 2.0 - past(1.0).y)
    def passed(self, t, s):
        return s.replace(n=s.n + 1.0)


@pytest.mark.parametrize("memory", ["keep", "restart"])
def test_a_guard_that_its_own_jump_carries_on_is_passed(way, memory):
    """At 3; restarted, it sees 3 for a lag and then what it would have seen: once is all."""
    result = way.run(Counted(), {"y": 0.0, "n": 0.0}, (0.0, 6.0), memory=memory)
    fired(way, result, ["passed"])
    assert result.times[0] == pytest.approx(3.0, abs=1e-9)
    assert result.final.n == 1.0


@pytest.mark.each_method
def test_dense_output_is_fit_to_be_seen(way):
    """At its tolerance, where steps are exact and no reason to be short: polynomials."""
    ends, options = np.array([4.75, 10.0]), {"rtol": 1e-7, "atol": 1e-7}
    middle, result = way.many(DelayJump(), [{"y": 1.0}] * 2, (0.0, ends), **options)
    assert result.final.y == pytest.approx(0.09445695934262015, abs=3e-5)
    assert middle.final.y == pytest.approx(0.1156982421875, abs=3e-5)
    if way.tells("run"):
        assert result.run(4.75).y == pytest.approx(0.1156982421875, abs=3e-5)


class Carried(hy.Automaton):
    """``y`` jumps to 1 at 2.5; a guard in small units falls to zero at 3.2, and is carried back."""

    y = hy.state()
    n = hy.state()
    unit = hy.parameter(1.0)

    @hy.mode
    def flow(self, t, s, past):
        return 0.0, 0.0

    @hy.edge(flow, to=flow, guard=lambda self, t, s: 2.5 - t)
    def alarm(self, t, s):
        return s.replace(y=1.0)

    def seen(self, t, s, past):
        return self.unit * (past(1.0).y + 3.2 - t)

    @hy.edge(flow, to=flow, guard=seen, crossing=hy.RISING)
    def rises(self, t, s):
        return s.replace(n=s.n + 1.0)


def test_a_guard_is_carried_over_zero_in_any_unit(way):
    """At 3.5 it has crossed against its direction before, however little that is."""
    for result in way.many(
        Carried(), [[0.0, 0.0]] * 4, (0.0, 6.0), {"unit": [1.0, 1e-3, 1e-7, 1e-9]}
    ):
        fired(way, result, ["alarm", "rises"])
        assert result.final.n == 1.0
        assert result.times[1] == pytest.approx(3.5, abs=1e-12)


class Vanishing(hy.Automaton):
    """``y' = 1 - y(exp(1 - 1/t))``, which ``log t`` solves; at 1 the lag is zero."""

    y = hy.state()

    @hy.mode
    def flow(self, t, s, past):
        return (1.0 - past(t - jnp.exp(1.0 - 1.0 / t)).y,)


def vanished(solver, begin, end):
    """How far a run is from the logarithm at its end."""
    asked = {"history": {"y": math.log}, **TIGHT, **solver}
    run = hy.simulate(Vanishing(), {"y": math.log(begin)}, (begin, end), **asked)
    return abs(run.final.y - math.log(end))


@pytest.mark.each_method
def test_a_history_is_asked_only_where_the_model_looks(solver):
    """From 0.1 it looks at exp(-9), next to 0, beyond which there is no logarithm."""
    assert vanished(solver, 0.1, 0.9) <= 1e-6


def test_a_lag_may_be_zero_on_the_way(solver):
    """At 1, where what is seen is the state itself."""
    assert vanished(solver, 0.5, 3.0) <= 1e-6


class Swinging(hy.Automaton):
    """A pendulum that is pushed by what it did, with a lag that its swing makes longer."""

    x = hy.state()
    v = hy.state()
    up = hy.discrete(0)
    down = hy.discrete(0)
    level: float = hy.parameter(0.0)
    gain: float = hy.parameter(0.5)

    @hy.mode
    def swings(self, t, s, past):
        pushed = self.gain * past(0.7 + 0.2 * s.x**2).x
        return s.v, 1.3 * jnp.cos(1.7 * t) - 2.0 * s.x - 0.4 * s.v + pushed

    @hy.edge(swings, guard=lambda self, t, s: s.x - self.level, crossing=hy.RISING)
    def upwards(self, t, s):
        return s.replace(up=s.up + 1)

    @hy.edge(swings, guard=lambda self, t, s: s.x - self.level)
    def downwards(self, t, s):
        return s.replace(down=s.down + 1)


@pytest.mark.parametrize(
    ("way", "gain", "level"),
    spread(FOUR, [0.5, -0.5, 0.9], [-0.15, 0.0, 0.2]),
    indirect=["way"],
)
def test_a_mark_counts_in_its_direction_alone_where_windows_end(way, gain, level):
    """A guard that is still to pass zero has its sign where a window ends, or another fires: each
    edge counts as often as the dense output passes its mark."""
    start, end = {"x": 0.3, "v": 0.2}, 8.0
    run = way.run(Swinging(level=level, gain=gain), start, (0.0, end), rtol=1e-8, atol=1e-10).run
    passed = np.diff(np.sign(run(np.linspace(0.0, end, 20_001)).x - level))
    assert run.final.up == np.count_nonzero(passed > 0)
    assert run.final.down == np.count_nonzero(passed < 0)


class Halved(hy.Automaton):
    """``x' = -k x(t/2)``, with marks on what is seen: the time until which a step looks is many
    times that for which its windows hold."""

    x = hy.state()
    down = hy.discrete(0)
    up = hy.discrete(0)
    either = hy.discrete(0)
    k: float = hy.parameter(2.0)

    @hy.mode
    def decays(self, t, s, past):
        return (-self.k * past(t / 2).x,)

    @hy.edge(decays, guard=lambda self, t, s, past: past(t / 2).x)
    def falls(self, t, s):
        return s.replace(down=s.down + 1)

    @hy.edge(decays, guard=lambda self, t, s, past: -past(t / 2).x)
    def rises(self, t, s):
        return s.replace(up=s.up + 1)

    @hy.edge(decays, guard=lambda self, t, s, past: past(t / 2).x, crossing=hy.EITHER)
    def passes(self, t, s):
        return s.replace(either=s.either + 1)


@pytest.mark.parametrize(
    ("way", "start", "k"), spread(FOUR, [0.0, 0.5], [1.5, 2.0, 3.0]), indirect=["way"]
)
def test_a_mark_counts_once_however_far_its_series_are_followed(way, start, k):
    """Series of a guard are followed beyond their window, where they pass zero as they please."""
    end = 20.0
    run = way.run(Halved(k=k), {"x": 1.0}, (start, end), rtol=1e-8, atol=1e-10).run
    passed = np.diff(np.sign(run(np.linspace(start, end / 2, 20_001)).x))
    assert run.final.down == np.count_nonzero(passed < 0) > 0
    assert run.final.up == np.count_nonzero(passed > 0) > 0
    assert run.final.either == run.final.down + run.final.up


class Returning(hy.Automaton):
    """``x' = -k x(t - lag)``, with a lag that vanishes now and then, and between looks back again
    beyond the start, and marks on what is seen: flow and guards look by as many equal lags."""

    x = hy.state()
    down = hy.discrete(0)
    up = hy.discrete(0)
    k: float = hy.parameter(1.0)

    def lag(self, t):
        return 1.4 * (1.0 + jnp.sin(2.0 * t))

    @hy.mode
    def moves(self, t, s, past):
        return (-self.k * past(self.lag(t)).x,)

    @hy.edge(moves, guard=lambda self, t, s, past: past(self.lag(t)).x - 0.4)
    def falls(self, t, s):
        return s.replace(down=s.down + 1)

    @hy.edge(moves, guard=lambda self, t, s, past: past(self.lag(t)).x - 0.4, crossing=hy.RISING)
    def rises(self, t, s):
        return s.replace(up=s.up + 1)


@pytest.mark.parametrize(("way", "k"), spread(FOUR, [0.5, 0.65, 0.8]), indirect=["way"])
def test_lags_may_turn_back_together_over_a_breaking_point(way, k):
    """All of them pass it, and each mark that is seen counts once."""
    start, end, before = 0.3, 4.0, 1.0
    run = way.run(Returning(k=k), {"x": before}, (start, end), rtol=1e-8, atol=1e-10).run
    t = np.linspace(start, end, 20_001)
    place = t - 1.4 * (1.0 + np.sin(2.0 * t))
    seen = np.where(place > start, run(np.maximum(place, start)).x, before)
    passed = np.diff(np.sign(seen - 0.4))
    assert run.final.down == np.count_nonzero(passed < 0) > 0
    assert run.final.up == np.count_nonzero(passed > 0) > 0


class Meeting(hy.Automaton):
    """Two lags that each come to zero and grow again, with marks on what is seen; that on the way
    since then only touches zero there."""

    x = hy.state()
    v = hy.state()
    down = hy.discrete(0)
    up = hy.discrete(0)
    w: float = hy.parameter(2.0)

    def near(self, t):
        return 1.2 * (1.0 + jnp.sin(2.0 * t))

    def far(self, t):
        return 1.4 * (1.0 + jnp.sin(self.w * t))

    @hy.mode
    def moves(self, t, s, past):
        there = past(self.far(t)).v
        return past(self.near(t)).x - 0.3 * s.x, 0.5 * (s.x - s.v) - there

    @hy.edge(moves, guard=lambda self, t, s, past: past(self.far(t)).v - 0.1)
    def falls(self, t, s):
        return s.replace(down=s.down + 1)

    @hy.edge(moves, guard=lambda self, t, s, past: s.x - past(self.near(t)).x, crossing=hy.RISING)
    def rises(self, t, s):
        return s.replace(up=s.up + 1)


@pytest.mark.parametrize("way", ["DOP853", "taylor"], indirect=True)
@pytest.mark.parametrize("w", [1.6, 2.0])
def test_lags_vanish_and_grow_again(way, w):
    """In few windows, though each lag is shorter than a step there, and by what it moved; a mark
    that is touched does not count. At the start the second leaves zero."""
    end, start = 4.0, {"x": 0.63, "v": 0.99}
    run = way.run(Meeting(w=w), start, (0.0, end), rtol=1e-9, atol=1e-9).run
    t = np.linspace(0.0, end, 20_001)
    place = t - 1.4 * (1.0 + np.sin(w * t))
    seen = np.where(place > 0.0, run(np.maximum(place, 0.0)).v, start["v"])
    assert run.final.down == np.count_nonzero(np.diff(np.sign(seen - 0.1)) < 0) > 0
    assert run.final.up == 1
    assert run.stats.steps < 1500
