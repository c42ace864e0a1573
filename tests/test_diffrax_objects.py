"""Diffrax's solvers and step size controllers as objects."""

import math

import diffrax
import numpy as np
import pytest

import hybrid as hy
from hybrid.lowering import scene_of
from hybrid.solvers import diffrax_objects, diffrax_program
from models.hard_spring import HardSpring
from tests.contract.ways import later
from tests.systems import Oscillator
from tests.test_advance import SCENES

#: Example 1's accumulation, from 40 digits.
T_INF = 1.32961738383844857732

CONSTANT = diffrax.ConstantStepSize()


def run(**options):
    return hy.simulate(HardSpring(), [2.1, 0.0], (0.0, 5.0), solver="diffrax", **options)


@pytest.mark.parametrize(
    "method", [diffrax.Tsit5(), diffrax.Dopri8(), diffrax.Kvaerno5(), diffrax.Sil3]
)
def test_a_method_may_be_an_object(method):
    """Its steps, our events: the accumulation is told within its error."""
    if method is diffrax.Sil3:
        with pytest.raises(hy.OptionError, match=r"Sil3.*ODETerm"):
            run(method=method())
        return
    found = run(method=method, rtol=1e-9, atol=1e-11)
    (point,) = found.zeno
    assert abs(point.t - T_INF) <= point.t_error < 1e-7
    assert found.options["method"] == type(method).__name__
    assert found.arcs[-1].mode == "flight.rest(impact)"


def test_a_controller_chooses_the_steps():
    """Ten times the tolerances, fewer steps; its name is kept."""
    loose, tight = (
        run(method="Tsit5", controller=diffrax.PIDController(rtol=rtol, atol=1e-2 * rtol))
        for rtol in (1e-4, 1e-10)
    )
    assert loose.stats.steps < tight.stats.steps
    assert abs(tight.zeno[0].t - T_INF) < 1e-9
    assert tight.options["controller"] == "PIDController"


def test_steps_of_one_length():
    """Heun's method is of order two: half the step, a quarter of the error."""
    errors = [
        abs(run(method=diffrax.Heun(), controller=CONSTANT, first_step=h).zeno[0].t - T_INF)
        for h in (4e-3, 2e-3, 1e-3)
    ]
    assert errors[1] < 0.4 * errors[0]
    assert errors[2] < 0.4 * errors[1]


def test_what_cannot_be_used_is_refused():
    """The error names the method or the option."""
    with pytest.raises(hy.OptionError, match=r"Euler.*error estimate"):
        run(method=diffrax.Euler())
    with pytest.raises(hy.OptionError, match="controller"):
        run(method="Tsit5", controller=3)
    with pytest.raises(hy.OptionError, match=r"scipy.*controller"):
        hy.simulate(HardSpring(), [2.1, 0.0], (0.0, 5.0), controller=CONSTANT)
    with pytest.raises(hy.OptionError, match=r"taylor.*controller"), pytest.warns(FutureWarning):
        run(method="Taylor", controller=CONSTANT)


@pytest.mark.parametrize("name", ["Bosh3", "Kvaerno5"])
def test_objects_with_the_same_numbers_are_one(name):
    """And a method by name is its object; tolerances are numbers given to what is compiled."""
    cls = getattr(diffrax, name)
    asked = [(cls(), 1e-8), (cls(), 1e-8), (name, 1e-8), (cls(), 1e-9)]
    one, *others = (diffrax_objects.solver_of(method, rtol, 1e-2 * rtol) for method, rtol in asked)
    assert all(other.key == one.key for other in others)
    assert diffrax_objects.solver_of(cls(), 1e-8, 1e-10, CONSTANT).key != one.key


class Throw(hy.Automaton):
    """A quartic of the time, which methods of order four follow in steps of any length, beside a
    state that a rate of 1e5 holds to it."""

    x = hy.state()
    v = hy.state()
    a = hy.state()
    w = hy.state()

    @hy.mode
    def flow(self, t, s):
        return s.v, s.a, t - 1.0, -1e5 * (s.w - s.x)


@pytest.mark.parametrize("method", ["Kvaerno4", "Kvaerno5", diffrax.Kvaerno5(scan_kind="lax")])
def test_long_steps_are_exact_between_their_ends(method):
    """The cubic through their ends alone is 0.2 off: rtol of the largest state, and the lag 1e-5 v
    of the fast one."""
    run = hy.simulate(Throw(), [0.0] * 4, (0.0, 3.9), solver="diffrax", method=method, rtol=1e-6)
    times = np.linspace(0.0, 3.9, 300)
    exact = times**4 / 24.0 - times**3 / 6.0
    assert np.abs(run(times).x - exact).max() < 1e-5
    assert np.abs(run(times).w - exact).max() < 5e-5


@pytest.mark.parametrize("method", ["Tsit5", "Kvaerno5", *later(diffrax.Bosh3(), diffrax.Dopri8())])
def test_steps_made_ahead_are_those_made_one_by_one(method, monkeypatch):
    """To the last bit: jumps, states between them, and what was rejected."""
    options = {"solver": "diffrax", "method": method, "rtol": 1e-7, "atol": 1e-9}
    model, start, _ = SCENES["duffing"]
    ahead = hy.simulate(model, start, (0.0, 60.0), **options)
    monkeypatch.setattr(diffrax_objects, "AHEAD", 1)
    single = hy.simulate(model, start, (0.0, 60.0), **options)
    assert ahead.jumps.t.tolist() == single.jumps.t.tolist()
    times = np.linspace(0.0, 60.0, 1000)
    assert ahead(times).x.tolist() == single(times).x.tolist()
    assert ahead.stats.steps == single.stats.steps > 5 * len(single.jumps) > 50
    assert ahead.stats.rejected == single.stats.rejected


@pytest.mark.parametrize("method", ["Tsit5", "Kvaerno5", diffrax.LeapfrogMidpoint()])
def test_a_state_set_from_outside_is_gone_on_from(method):
    """Steps made ahead from another state are forgotten, as are those beyond a landing."""
    field, start = scene_of(Oscillator(wall=-5.0)).field("flight"), [1.0, 0.0]
    controller = CONSTANT if method == diffrax.LeapfrogMidpoint() else None
    solver = diffrax_objects.solver_of(method, 1e-7, 1e-9, controller)
    solver.ahead = 16
    moved = solver.begin(field, 0.0, np.array(start), 10.0, 1e-3)
    for _ in range(3):
        moved.step(10.0)
    assert moved.made > moved.used
    moved.x = 2.0 * moved.x
    begin = moved.tau
    moved.step(10.0)
    assert moved.segment().start == begin
    assert np.linalg.norm(moved.x) == pytest.approx(2.0, rel=1e-4)
    half = 0.5 * (begin + moved.tau)
    moved.land(half)
    assert moved.tau == half
    moved.step(10.0)
    assert moved.segment().start == half
    assert np.linalg.norm(moved.x) == pytest.approx(2.0, rel=1e-4)


@pytest.mark.parametrize("method", ["Tsit5", "Dopri8", "Kvaerno5"])
def test_the_state_is_that_of_the_rounded_time(method):
    """Far from the start of an arc the end of a step is rounded to a spacing of 1e-11."""
    field = scene_of(Oscillator(wall=-5.0)).field("flight")
    solver = diffrax_objects.solver_of(method, 1e-13, 1e-13)
    far = solver.begin(field, 0.0, np.array([1.0, 0.0]), 2e5, 1e-3)
    far.tau = begin = 1e5
    far.wanted = begin + 1e-3
    for _ in range(1000):
        far.step(2e5)
    # the methods' own errors in as many steps; the roundings of the time would add up to some 1e-9
    assert far.x[0] == pytest.approx(math.cos(far.tau - begin), abs=5e-11)


class Fading(hy.Automaton):
    """As many states as leave room for a few steps ahead only."""

    x = hy.state(shape=(300,))

    @hy.mode
    def fades(self, t, s):
        return -s.x


@pytest.mark.parametrize("save", ["dense", "jumps"])
def test_large_states_fade(save):
    """Whatever there is room for: against the exponential, in steps one by one and all at once."""
    start = np.linspace(1.0, 2.0, 300)
    options = {"solver": "diffrax", "method": "Tsit5", "rtol": 1e-9, "atol": 1e-11}
    run = hy.simulate(Fading(), {"x": start}, (0.0, 5.0), save=save, **options)
    assert run.stats.steps > 2 * diffrax_program.NUMBERS // (300 * 5)
    np.testing.assert_allclose(run.final.x, np.exp(-5.0) * start, rtol=1e-7)
    if save == "dense":
        np.testing.assert_allclose(run(2.5).x, np.exp(-2.5) * start, rtol=1e-7)
