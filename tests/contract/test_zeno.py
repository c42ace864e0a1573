"""Accumulation, rest, release: the same on every way in."""

import numpy as np
import pytest

import hybrid as hy
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall

from .. import systems
from .ways import ACCURATE, COMPILED, SOLVERS, SOLVERS_AND_COMPILED, later

WAYS = SOLVERS_AND_COMPILED

#: Tolerances at which the accurate ways reach about eleven digits.
TIGHT = {"rtol": 1e-12, "atol": 1e-12}

accurate_ways = pytest.mark.parametrize("way", ACCURATE, indirect=True)


def error_is_within_its_bound(way, result, exact, least=0.0):
    """Asked of the ways whose ``t_error`` bounds the whole error."""
    if way.tells("bound"):
        assert abs(result.t_inf - exact) <= result.t_error + least


def releases(result, contact="impact"):
    """Times at which a contact is released, for ways that tell the edges."""
    names = np.array(result.edges)
    return result.times[names == f"{contact}.release"]


@pytest.mark.each_method
def test_impacts_accumulate_and_the_ball_rests(way):
    """t_inf is closed form; afterwards x is exactly 0."""
    result = way.run(BouncingBall(), {"x": 1.0, "v": 0.0}, (0, 3), rtol=1e-9)
    assert result.t_inf == pytest.approx(2.55863396558580846, rel=1e-6)
    error_is_within_its_bound(way, result, 2.55863396558580846)
    assert result.final.x == 0.0
    if way.tells("mode"):
        assert result.mode == "flight.rest(impact)"


def test_table_throws_the_bead_off_where_its_acceleration_is_minus_g(way):
    """Release where -omega^2 sin(omega t) = -g, whatever the way."""
    model = BeadOnTable(r=0.3, omega=4.0)
    phase = np.arcsin(9.8 / 16.0)
    due = (2 * np.pi * np.array([1, 2]) + phase) / 4.0
    result = way.run(model, {"x": 1.5, "v": 0.0}, (0, 5), rtol=1e-9)
    assert np.abs(result.times[:, None] - due).min(axis=0) == pytest.approx(0.0, abs=1e-8)
    if way.tells("edges"):
        assert releases(result)[:2] == pytest.approx(due, abs=1e-8)
    if way.tells("all zeno"):
        assert [point.t_release for point in result.zeno[:2]] == pytest.approx(due, abs=1e-8)


@accurate_ways
@pytest.mark.parametrize(("case", "r", "omega"), [("A", 0.3, 4.0), ("B", 0.6, 3.5)])
def test_tables_a_and_b(way, reference, case, r, omega):
    """Every stick and lift time to 1e-9; the error inside its bound."""
    events = reference[f"table_released_{case}"]["events"]
    sticks, lifts = (
        np.array([float(e["t"]) for e in events if e["kind"] == kind]) for kind in ("stick", "lift")
    )
    model, start = BeadOnTable(r=r, omega=omega), {"x": 1.5, "v": 0.0}
    result = way.run(model, start, (0, 6.8), **TIGHT)
    assert abs(result.t_inf - sticks[0]) <= 1e-9
    assert np.abs(result.times[:, None] - lifts).min(axis=0) == pytest.approx(0.0, abs=1e-9)
    if way.tells("accumulations"):
        assert result.accumulations >= len(sticks)
    if way.tells("all zeno"):
        for point, stick in zip(result.zeno, sticks, strict=False):
            assert abs(point.t - stick) <= min(1e-9, point.t_error)
        for point, lift in zip(result.zeno, lifts, strict=False):
            assert point.t_release == pytest.approx(lift, abs=1e-9)


@pytest.mark.parametrize("way", ["DOP853", "taylor", "ensemble"], indirect=True)
@pytest.mark.parametrize(("case", "r", "omega"), [("A", 0.3, 4.0), ("B", 0.6, 3.5)])
def test_modes_beside_the_events_of_tables_a_and_b(way, reference, case, r, omega):
    """1e-6 after a stick the bead rests, before it it flies; the other way round at a lift."""
    events = [e for e in reference[f"table_released_{case}"]["events"] if "t" in e]
    times = np.array([float(e["t"]) for e in events])
    modes = ["flight.rest(impact)" if e["kind"] == "stick" else "flight" for e in events]
    before = ["flight" if mode != "flight" else "flight.rest(impact)" for mode in modes]
    ends = np.concatenate([times + 1e-6, times - 1e-6])
    starts = [{"x": 1.5, "v": 0.0}] * len(ends)
    results = way.many(BeadOnTable(r=r, omega=omega), starts, (0.0, ends), **TIGHT)
    assert [result.mode for result in results] == modes + before


@pytest.mark.each_method
def test_quadratic_drag_with_its_kink(way):
    """The flow's kink at each top of a flight is followed: against 16 digits (Taylor, 1e-13)."""
    result = way.run(systems.Drag(), {"x": 1.0, "v": 0.0}, (0, 5), rtol=1e-9)
    assert result.t_inf == pytest.approx(3.03185051506359, abs=1e-6)
    error_is_within_its_bound(way, result, 3.03185051506359)


@pytest.mark.parametrize("way", ["DOP853", "taylor", "ensemble"], indirect=True)
def test_quadratic_drag_is_no_worse_at_tighter_tolerances(way):
    """The same to ten digits, which all reach at 1e-11."""
    result = way.run(systems.Drag(), {"x": 1.0, "v": 0.0}, (0, 5), **TIGHT)
    assert result.t_inf == pytest.approx(3.03185051506359, abs=1e-10)


@accurate_ways
def test_a_force_that_is_flat_to_rounding_before_it_turns(way):
    """Small terms of a series prove nothing: against quadratures of each flight, 30 digits."""
    result = way.run(systems.Rubbed(), {"x": 1.0, "v": 0.0}, (0, 3), **TIGHT)
    assert result.times[0] == pytest.approx(0.54228966404263324591, abs=1e-11)
    assert result.t_inf == pytest.approx(1.8538083920074954531, abs=1e-11)
    error_is_within_its_bound(way, result, 1.8538083920074954531)
    if way.tells("bound"):
        assert result.t_error <= 1e-10


def test_resting_on_one_contact_and_striking_another(way):
    """A ball at rest on the floor slides into the wall, and stays on the floor."""
    result = way.run(systems.Room(), [0.0, 1.0, 1.0, 0.0], (0, 5), rtol=1e-9)
    strikes = result.times[result.after.u == -0.5][:1]
    if way.tells("edges"):
        strikes = result.times[np.array(result.edges) == "wall"]
    assert strikes.tolist() == pytest.approx([3.0], abs=1e-7)
    if way.tells("mode"):
        assert result.mode == "flight.rest(floor)"
    assert result.final.x == pytest.approx(2.0, abs=1e-6)
    assert result.final.y == 0.0


def test_two_bodies_rest_at_the_end_of_their_own_series(way):
    """Two balls on two floors: both accumulate; then both contacts are held at once."""
    result = way.run(systems.Pair(), [1.0, 0.9, 0.0, 0.0], (0, 3), rtol=1e-9)
    truth = [np.sqrt(2 * h / 10.0) * 3.0 for h in (0.9, 1.0)]
    assert result.t_inf == pytest.approx(truth[0], abs=1e-5)
    if way.tells("accumulations"):
        assert result.accumulations == 2
    if way.tells("all zeno"):
        assert [point.t for point in result.zeno] == pytest.approx(truth, abs=1e-5)
    if way.tells("mode"):
        assert result.mode == "flight.rest(first, second)"
    assert (result.final.x, result.final.y) == (0.0, 0.0)


@accurate_ways
def test_a_force_that_changes_inside_the_tail(way):
    """Gravity falls from 10 to 2 at t = 6, inside a tail that would have ended at 8.497."""
    result = way.run(systems.Switching(), {"x": 1.0, "v": 0.0}, (0, 30), **TIGHT)
    assert result.t_inf == pytest.approx(16.338222626746, abs=1e-6)
    error_is_within_its_bound(way, result, 16.338222626746, 1e-11)


def test_a_ceiling_that_dips_into_the_tail(way):
    """Another contact's gap is watched along the whole tail."""
    ceiling = lambda t: 2 - 1.99 * np.exp(-(((t - 3.0) / 0.2) ** 2))  # noqa: E731
    start = {"x": 1.0, "v": 0.0}
    if way.tells("edges"):
        result = way.run(systems.DippingCeiling(), start, (0, 12))
        assert "ceiling" in result.edges
    if way.tells("run"):
        times = np.linspace(0, 12, 2000)
        heights = result.run(times).x
    else:
        times = np.concatenate([np.linspace(2.0, 4.0, 41), np.linspace(4.5, 12.0, 7)])
        ended = way.many(systems.DippingCeiling(), [start] * len(times), (0, times))
        heights = np.array([result.final.x for result in ended])
    assert (ceiling(times) - heights).min() > -1e-6


@pytest.mark.parametrize("way", ["DOP853", "taylor", "ensemble", "as_function"], indirect=True)
@pytest.mark.parametrize("omega", [5.0, 150.0, 1e3, 1e4])
def test_release_at_any_frequency(way, omega):
    """A table of acceleration 1.5 g: rest ends where it falls faster than g, at each period."""
    model = BeadOnTable(r=0.3, omega=omega, amplitude=1.5 * 9.8 / omega**2)
    end, start = 20.0 / omega, {"x": 0.0, "v": model.amplitude * omega}
    result = way.run(model, start, (0, end))
    phase = np.arcsin(1 / 1.5)
    due = phase + 2 * np.pi * np.arange(3)
    assert np.abs(result.times[:, None] * omega / due - 1.0).min(axis=0) == pytest.approx(
        0.0, abs=1e-9
    )
    if way.tells("edges"):
        found = releases(result) * omega
        np.testing.assert_allclose(found, phase + 2 * np.pi * np.arange(len(found)), rtol=1e-9)


@pytest.mark.parametrize("way", ["DOP853", "taylor", "ensemble", "as_function"], indirect=True)
def test_a_body_set_at_rest_on_a_moving_table_does_not_sink(way):
    """Its gap speed is rounding: -1e-16. It rests until the table falls away."""
    model = BeadOnTable(r=0.5, omega=5.0, amplitude=1.0)
    start = {"x": -np.sin(np.pi / 2), "v": 5.0 * np.cos(-np.pi / 2)}
    times = np.linspace(-np.pi / 10, 0.5, 301)[1:]
    if way.tells("run"):
        heights = way.run(model, start, (-np.pi / 10, 0.5)).run(times).x
    else:
        ended = way.many(model, [start] * 60, (-np.pi / 10, times[4::5]))
        heights, times = np.array([result.final.x for result in ended]), times[4::5]
    assert np.min(heights - np.sin(5.0 * times)) >= -1e-12


#: A ball whose impacts accumulate, and when.
DROPPED = BouncingBall(), {"x": 1.0, "v": 0.0}, (0.0, 3.0)
T_INF = 2.55863396558580846


def test_a_run_stops_where_it_is_asked_to(way):
    """At the accumulation, on the floor."""
    result = way.run(*DROPPED, zeno="stop")
    assert result.status == "zeno_stopped"
    assert result.t_inf == pytest.approx(T_INF, abs=1e-6)
    assert result.t == pytest.approx(result.t_inf, abs=1e-15)  # the start of the last arc, rounded
    assert result.final.x == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("way", SOLVERS, indirect=True)
def test_a_series_is_cut_or_an_error_where_that_is_asked(way):
    """Held after three impacts, with what that leaves out; or refused."""
    cut = way.run(*DROPPED, zeno="truncate", max_jumps=3)
    exact = np.sqrt(2 / 9.81) * np.array([1.0, 1 + 2 * 0.7, 1 + 2 * (0.7 + 0.49)])
    np.testing.assert_allclose(cut.times[:3], exact, atol=1e-6)
    assert cut.zeno[0].t == pytest.approx(exact[2], abs=1e-6)
    assert cut.final.x == 0.0
    assert cut.zeno[0].truncation.t_inf == pytest.approx(T_INF, abs=1e-6)
    assert way.run(*DROPPED, zeno="raise").status == "zeno_raised"


@pytest.mark.parametrize("way", COMPILED, indirect=True)
@pytest.mark.parametrize("zeno", ["truncate", "raise"])
def test_functions_refuse_what_they_cannot_do_at_an_accumulation(way, zeno):
    """They say what can."""
    with pytest.raises(hy.OptionError, match=r"'truncate' and 'raise' use hy\.simulate"):
        way.run(*DROPPED, zeno=zeno)


@pytest.mark.parametrize("way", ["DOP853", "taylor", "ensemble", *COMPILED], indirect=True)
def test_impacts_are_simulated_one_by_one_where_that_is_asked(way):
    """Ten of them, at the times of parabolas, and no limit."""
    result = way.run(*DROPPED, zeno="ignore", max_jumps=10)
    assert result.status == "max_jumps"
    exact = np.sqrt(2 / 9.81) * (1 + 2 * np.cumsum(0.7 ** np.arange(10)) - 2)
    np.testing.assert_allclose(result.times, exact, rtol=1e-9)
    assert not result.zeno


class Thrown(hy.Automaton):
    """A box that slides until friction stops it, and bounces: each at its own time."""

    x = hy.state()
    u = hy.state()
    y = hy.state()
    v = hy.state()

    friction: float = hy.parameter(0.2)
    r: float = hy.parameter(0.7)

    @hy.mode(initial=True)
    def slips(self, t, s):
        return s.u, -self.friction, s.v, -4.0

    @hy.mode
    def sticks(self, t, s):
        return 0.0, 0.0, s.v, -4.0

    floor = hy.contact(slips, gap=lambda self, t, s: s.y, restitution="r")
    ground = hy.contact(sticks, gap=lambda self, t, s: s.y, restitution="r")

    @hy.edge(slips, to=sticks, guard=lambda self, t, s: s.u)
    def stop(self, t, s):
        return s.replace(u=0.0)


@pytest.mark.parametrize("way", ["taylor", *later("DOP853", "Dopri8", "RK45")], indirect=True)
@pytest.mark.parametrize(
    ("friction", "r", "height", "since"),
    [
        (0.2, 0.7, 0.5, 0.0),
        (0.7344512408023016, 0.8769943161982721, 0.6485968750940875, 17.0),
        (0.669437037911119, 0.3963912052650761, 2.659582906631892, 0.0),
        (0.25762496605458246, 0.8976847140711768, 0.040554463530457135, 0.0),
    ],
)
def test_an_edge_may_fire_next_to_a_limit(way, friction, r, height, since):
    """Before it, at it or after it by roundings of the time: the box comes to rest all the same."""
    lasts = np.sqrt(0.5 * height) * (1.0 + r) / (1.0 - r)
    for away in (-120, -103, -93, -80, -67, -54, -40, -20, -8, -3, -1, 0, 1, 3, 8, 20, 54):
        ends = lasts + away * np.spacing(since + lasts)
        start = {"x": 0.0, "u": friction * ends, "y": height, "v": 0.0}
        model = Thrown(friction=friction, r=r)
        result = way.run(model, start, (since, since + 2.0 * lasts))
        assert result.status == "reached_end"
        assert result.mode == "sticks.rest(ground)"
        assert result.final.x == pytest.approx(0.5 * friction * ends**2, rel=1e-7)
        assert (result.final.u, result.final.y, result.final.v) == (0.0, 0.0, 0.0)
