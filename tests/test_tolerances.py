"""Taylor series at a tolerance: it is honoured, and nothing is lost for it."""

import math
from itertools import pairwise

import numpy as np
import pytest

import hybrid as hy
from hybrid.solvers.taylor_backend import HIGHEST, order_at
from models.bead_on_table import BeadOnTable

from .contract.test_brief_forces import Gust, Pulses, gust_ends
from .scenes import scenes
from .systems import Oscillator

#: A bead on a shaking table: gravity, frequency (the amplitude is one), and the height of the
#: start.
G, OMEGA, HEIGHT = 9.8, 7.0, 5.0

#: Flights that begin more slowly cannot be told from rest.
SLOW = 1e-3


def flight(t, x, v):
    """Duration of a flight: the gap's acceleration is bounded, so each step can reach no zero."""
    own, most = 0.0, G + OMEGA**2
    gap, speed = x - math.sin(OMEGA * t), v - OMEGA * math.cos(OMEGA * t)
    for _ in range(10_000):
        root = math.sqrt(speed * speed + 2 * most * max(gap, 0.0))
        step = (speed + root) / most if speed > 0 else 2 * gap / (root - speed)
        own += step
        gap = x + own * (v - 0.5 * G * own) - math.sin(OMEGA * (t + own))
        speed = v - G * own - OMEGA * math.cos(OMEGA * (t + own))
        if gap <= 0.0 or step < 1e-14:
            break
    return own


def lost(jumps):
    """Flights whose exact gap has an earlier zero, those too slow to tell left out."""
    states = zip(jumps.t, jumps.after.x, jumps.after.v, strict=True)
    count, rows = 0, [(0.0, HEIGHT, 0.0), *states]
    for (t, x, v), (end, *_) in pairwise(rows):
        if x - math.sin(OMEGA * t) > 1e-9 or v - OMEGA * math.cos(OMEGA * t) > SLOW:
            count += t + flight(t, x, v) < end - 1e-3
    return count


class Logistic(hy.Automaton):
    """Growth from a thousandth to nearly all."""

    y = hy.state()

    @hy.mode
    def grows(self, t, s):
        return s.y * (1.0 - s.y)


class Riccati(hy.Automaton):
    """1 / (1 - t): on the way to a pole steps become shorter."""

    y = hy.state()

    @hy.mode
    def grows(self, t, s):
        return s.y**2


class Kepler(hy.Automaton):
    """An ellipse: fast where it is near, slow where it is far."""

    x = hy.state()
    y = hy.state()
    u = hy.state()
    v = hy.state()

    @hy.mode
    def orbit(self, t, s):
        cubed = (s.x**2 + s.y**2) ** 1.5
        return s.u, s.v, -s.x / cubed, -s.y / cubed


#: Model, start, end, what is compared and what it is there: by name.
KNOWN = {
    "oscillator": (Oscillator(wall=-5.0), [1.0, 0.0], 20.0, "x", math.cos(20.0)),
    "logistic": (Logistic(), [1e-3], 12.0, "y", 1.0 / (1.0 + 999.0 * math.exp(-12.0))),
    "riccati": (Riccati(), [1.0], 0.9, "y", 10.0),
    "kepler": (Kepler(), [0.5, 0.0, 0.0, math.sqrt(3.0)], 2.0 * math.pi, "y", 0.0),
}


#: What is lost at the start matters so much more at the end. Near the pole y grows tenfold, and
#: its relative error with it; energy that is off by e moves the end of an orbit by 6 pi e of time,
#: at a speed of the root of three.
GROWN = {"riccati": 10.0, "kepler": 33.0}


def flown(name, rtol):
    """The error at the end, relative to what is due or to one, and how many steps there were."""
    model, start, until, what, exact = KNOWN[name]
    run = hy.simulate(model, start, (0.0, until), solver="taylor", rtol=rtol)
    return abs(getattr(run.final, what) - exact) / max(exact, 1.0), run.stats.steps


@pytest.mark.parametrize("name", KNOWN)
def test_the_error_follows_the_tolerance(name):
    """No more than one step's share, grown along the way; above rounding, and for fewer terms."""
    exact = flown(name, None)
    before = [math.inf, math.inf]
    for k in range(3, 14):
        error, steps = flown(name, 10.0**-k)
        assert error <= GROWN.get(name, 1.0) * 10.0**-k + exact[0]
        assert error <= before[-2]  # from one to the next the order changes, and so does its share
        assert steps * order_at(10.0**-k) < exact[1] * HIGHEST
        before.append(max(error, 1e-15))
    assert flown(name, 1e-5)[0] > 1e-12


@pytest.mark.parametrize("name", KNOWN)
def test_without_a_tolerance_steps_are_exact_to_rounding(name):
    """As they are at 1e-14 and below, whatever else is asked."""
    error, steps = flown(name, None)
    assert error <= 100.0 * steps * 2.0**-53  # a rounding each, grown along an orbit
    for rtol in (1e-14, 1e-15):
        assert flown(name, rtol) == (error, steps)


class Beside(hy.Automaton):
    """A swing, beside something slow that has another size."""

    slow = hy.state()
    x = hy.state()
    v = hy.state()
    size: float = hy.parameter(1.0)
    w: float = hy.parameter(1.0)

    @hy.mode
    def swings(self, t, s):
        return 0.01 * self.w * s.slow * (1.0 - s.slow / self.size), s.v, -(self.w**2) * s.x


@pytest.mark.parametrize("rtol", [None, 1e-6, 1e-10])
@pytest.mark.parametrize("unit", [1e-12, 1e-3, 1e3, 1e12])
def test_units_do_not_matter_to_a_step(unit, rtol):
    """Neither that of time nor that of another element of the state: as exact, in as many steps,
    where all coefficients are numbers; else those of the order 16."""
    usual = hy.simulate(Beside(), [0.1, 1.0, 0.0], (0.0, 20.0), solver="taylor", rtol=rtol)
    due = max(abs(usual.final.x - math.cos(20.0)), 2e-15)  # a rounding of w, and of the time
    represented = rtol or abs(math.log10(unit)) * HIGHEST < 290
    for model, of_time in ((Beside(size=unit), 1.0), (Beside(w=1.0 / unit), unit)):
        start, span = [0.1 * model.size, 1.0, 0.0], (0.0, 20.0 * of_time)
        run = hy.simulate(model, start, span, solver="taylor", rtol=rtol, atol=0.0)
        most = 1 if represented or of_time == 1.0 else 10 ** (16 / 15) * 20  # of 16 / 15 digits
        assert abs(run.stats.steps - usual.stats.steps) <= most
        assert abs(run.final.x - math.cos(20.0)) <= 4.0 * due  # of rounding it is another one


@pytest.mark.parametrize("rtol", [1e-3, 1e-6, 1e-9])
def test_dense_output_is_as_exact_as_the_steps(rtol):
    """Anywhere in a step the cosine is within the tolerance of what it was at its start."""
    model, start, until, *_ = KNOWN["oscillator"]
    run = hy.simulate(model, start, (0.0, until), solver="taylor", rtol=rtol)
    t = np.linspace(0.0, until, 1001)
    assert np.abs(run(t).x - np.cos(t)).max() <= 10.0 * rtol


def test_an_absolute_tolerance_counts_as_well():
    """Of a state that is small beside it fewer steps are made, and lose no more than that."""
    model, start, until, _, exact = KNOWN["oscillator"]
    small = [1e-6 * value for value in start]
    options = {"solver": "taylor", "rtol": 1e-9}
    runs = [hy.simulate(model, small, (0.0, until), atol=a, **options) for a in (0.0, 1e-9)]
    strict, loose = (abs(run.final.x - 1e-6 * exact) for run in runs)
    assert strict <= 1e-14
    assert loose <= 1e-8
    assert runs[1].stats.steps < runs[0].stats.steps


def test_the_order_follows_the_tolerance():
    """It grows by one for each two digits or so, up to that of series exact to rounding."""
    orders = [order_at(10.0**-k) for k in range(1, 17)]
    assert orders == sorted(orders)
    assert orders[0] < 10
    assert orders[-1] == HIGHEST


# ---------------------------------------------------------------------------------------
# events


@pytest.mark.parametrize("rtol", [10.0**-k for k in (3, 4, 5, 6, 7, 9, 11, 13)])
def test_no_impact_is_lost(rtol):
    """A bead on a shaking table: from each flight's start, an earlier zero of the exact gap would
    lie no deeper than what the tolerance takes for a touch, where the table is at one at most."""
    model = BeadOnTable(g=G, r=0.85, omega=OMEGA)
    start, span = {"x": HEIGHT, "v": 0.0}, (0.0, 5000.0)
    given = {"max_jumps": 400, "save": "jumps"}
    run = hy.simulate(model, start, span, solver="taylor", rtol=rtol, **given)
    assert len(run.own_jumps) == 400
    assert lost(run.jumps) <= len(run.grazings)
    other = hy.simulate(model, start, (0.0, 30.0), rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(run.jumps.t[:6], other.jumps.t[:6], rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("rtol", [1e-3, 1e-6, 1e-9])
def test_limits_lie_within_their_bounds(rtol):
    """Balls, moving floors, weights that switch, hard springs: with the error of the steps."""
    for scene in scenes(12, seed=7):
        (point,) = scene.run("taylor", rtol).zeno
        assert abs(point.t - scene.exact) <= point.t_error < math.inf


@pytest.mark.parametrize("rtol", [1e-3, 1e-6, 1e-9])
def test_brief_forces_are_seen_at_any_tolerance(rtol):
    """Smooth pulses down to 1e-6, and gusts down to 1e-7, which have an error bound."""
    for w in (1e-2, 1e-4, 1e-6):
        end = hy.simulate(Pulses(w=w), [1.0] * 3, (0.0, 1.2), solver="taylor", rtol=rtol).final
        # the tail of Lorentz's is 4/3 (2 w)^3 / pi, rounding of the time 2e-16 over the width
        np.testing.assert_allclose([end.a, end.b, end.c], 2.0, atol=rtol + 4 * w**3 + 2e-16 / w)
    for w in (1e-1, 1e-3, 1e-5, 1e-7):
        run = hy.simulate(
            Gust(w=w, force=1.9 / w), [1.0, 0.0], (0.0, 1.5), solver="taylor", rtol=rtol
        )
        exact = gust_ends(w, 1.9 / w, 0.3)
        assert abs(run.zeno[0].t - exact) <= min(run.zeno[0].t_error, rtol + 1e-16 / w)
