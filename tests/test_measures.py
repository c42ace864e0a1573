"""What lanes of an ensemble are asked for besides their ends (``docs/maps.md``)."""

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.ensembles import runs
from models.bead_on_table import BeadOnTable
from models.delay_bounce import DelayBounce
from models.two_tanks import TwoTanks

from .oscillators import Baker, bouncing, flight
from .swept import Ball, G

#: One spacing of a float for each of a few operations.
ROUNDING = 1e-14


class Swing(hy.Automaton):
    """A forced, damped oscillator without any jump: ``x = sin(omega t)`` is its limit."""

    x = hy.state()
    v = hy.state()
    omega: float = hy.parameter(1.0)

    @hy.mode
    def free(self, t, s):
        w = self.omega
        return s.v, -s.v - s.x + (1 - w * w) * jnp.sin(w * t) + w * jnp.cos(w * t)


R = np.array([0.5, 0.6, 0.8])


def top(self, t, s):
    return s.v


def test_points_at_the_jumps_of_an_edge():
    """After impact ``k`` a ball has the speed ``r^(k + 1)`` times that of its fall."""
    lanes = hy.ensemble(
        Ball(),
        {"x": 1.0, "v": 0.0},
        (0.0, 1.5),
        {"r": R},
        section="impact",
        skip=1,
        every=2,
        keep=2,
    )
    fall, k = np.sqrt(2 * G), np.array([1, 3])
    exact = np.where(lanes.hits.values[:, None] > k, fall * R[:, None] ** (k + 1), np.nan)
    # the times of impacts are rounded, some 1e-16 at each
    np.testing.assert_allclose(lanes.v_section, exact, rtol=1e-13)
    assert lanes.hit.values.tolist() == [1, 3]
    assert (lanes.hits == lanes.jumps).all()
    assert lanes.x.attrs["units"] == lanes.x_section.attrs["units"] == "m"
    assert lanes.r.attrs["units"] == "1"


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_a_lane_meets_what_its_run_meets(solver):
    """At the jumps of an edge, and wherever the state is kept, a lane is its run."""
    start, span, times = {"x": 1.9, "v": 0.0}, (21.67, 45.0), np.linspace(21.67, 45.0, 9)
    run = hy.simulate(BeadOnTable(r=0.8), start, span, solver=solver)
    asked = {"section": "impact", "keep": 100, "save": times, "measure": ["stick"]}
    lane = hy.ensemble(BeadOnTable(r=0.8), start, span, solver=solver, **asked).isel(lane=0)
    own = [row for _, row in sorted(run.own_jumps.items()) if row.edge == "impact"]
    assert int(lane.hits) == len(own) > 1
    assert lane.t_section.values[: len(own)].tolist() == [row.t for row in own]
    assert lane.v_section.values[: len(own)].tolist() == [row.after[1] for row in own]
    assert np.isnan(lane.t_section.values[len(own) :]).all()
    assert lane.x_saved.values.tolist() == run(times).x.tolist()
    resting = sum(arc.length for arc in run.arcs if ".rest(" in arc.mode)
    assert float(lane.stick) == pytest.approx(resting / (span[1] - span[0]), rel=ROUNDING)


@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_a_lane_with_delays_meets_what_its_run_meets(solver):
    """Also where the flow looks into the past, through rests and releases."""
    asked = {"t": (0.0, 4.0), "solver": solver, "history": {"y": 0.0, "v": 0.0}}
    start, times = {"y": 0.05, "v": 0.0}, np.linspace(0.0, 4.0, 9)
    run = hy.simulate(DelayBounce(), start, **asked)
    lane = hy.ensemble(
        DelayBounce(), start, section="impact.release", save=times, measure=["stick"], **asked
    ).isel(lane=0)
    releases = [row.t for row in run.own_jumps.values() if row.edge == "impact.release"]
    assert int(lane.hits) == len(releases) > 1
    assert lane.t_section.values[: len(releases)].tolist() == releases
    assert lane.y_saved.values.tolist() == run(times).y.tolist()
    resting = sum(arc.length for arc in run.arcs if ".rest(" in arc.mode)
    assert float(lane.stick) == pytest.approx(resting / 4.0, rel=ROUNDING)


@pytest.mark.parametrize("solver", ["taylor", "scipy", "diffrax"])
def test_points_on_a_surface(solver):
    """The tops of a ball's flights: each is ``r^2`` times the one before."""
    lanes = hy.ensemble(
        Ball(), {"x": 0.0, "v": np.sqrt(2 * G)}, (0.0, 1.27), {"r": R}, solver=solver,
        section=top, crossing=hy.FALLING, keep=2, measure=["energy"],
    )  # fmt: skip
    # tolerances of the solvers, 1e-8, and a factor for the two flights
    np.testing.assert_allclose(lanes.x_section[:, 0], 1.0, rtol=1e-7)
    np.testing.assert_allclose(lanes.x_section[:, 1], R**2, rtol=1e-7)
    np.testing.assert_allclose(lanes.energy_section, G * lanes.x_section, rtol=1e-7)
    assert lanes.energy_section.attrs["units"] == "J/kg"


def test_a_period_of_each_lane():
    """States a period of its own forcing apart, once a transient has died away."""
    omega = np.array([0.5, 2.0])
    lanes = hy.ensemble(
        Swing(), {"x": 0.3, "v": 0.0}, (0.0, 30 * 2 * np.pi), {"omega": omega},
        section=lambda self: 2 * np.pi / self.omega, skip=10, keep=4, measure=["period"],
    )  # fmt: skip
    assert lanes.hits.values.tolist() == [15, 60]
    # exp(-t/2) after eleven periods of the faster one: exp(-17) = 4e-8
    np.testing.assert_allclose(lanes.x_section, 0.0, atol=1e-7)
    np.testing.assert_allclose(lanes.v_section, np.broadcast_to(omega[:, None], (2, 4)), rtol=1e-6)


def test_the_period_of_an_orbit():
    """A ball on a still table has none; one that swings has the period one."""
    lanes = hy.ensemble(
        Swing(), {"x": 0.0, "v": 1.0}, (0.0, 60.0), section=2 * np.pi, skip=1, measure=["period"]
    )
    assert lanes.period.values.tolist() == [1]
    lanes = hy.ensemble(
        Swing(), {"x": 0.0, "v": 1.0}, (0.0, 60.0), section=np.pi, skip=1, measure=["period"]
    )
    assert lanes.period.values.tolist() == [2]
    balls = hy.ensemble(
        Ball(), {"x": 1.0, "v": 0.0}, (0.0, 2.0), section="impact", measure=["period"]
    )
    assert balls.period.values.tolist() == [0]


def test_the_share_of_sticking():
    """A ball rests from its limit on: what is left of its time is the closed form's."""
    lanes = hy.ensemble(Ball(), {"x": 1.0, "v": 0.0}, (0.0, 5.0), {"r": R}, measure=["stick"])
    t_inf = np.sqrt(2 / G) * (1 + R) / (1 - R)
    np.testing.assert_allclose(lanes.stick, np.maximum(1 - t_inf / 5.0, 0.0), rtol=1e-12)


def test_a_lane_that_fails_harms_no_other():
    """It is a row with its reason, and what it met until then."""
    lanes = hy.ensemble(
        Ball(), {"x": np.array([1.0, -1.0, 1.0]), "v": 0.0}, (0.0, 1.5), section="impact", keep=2,
        save=[0.0, 1.5], measure=["stick", "energy"],
    )  # fmt: skip
    assert lanes.status.values.tolist() == ["reached_end", "outside", "reached_end"]
    assert "must be positive" in str(lanes.reason.values[1])
    for name in ("v_section", "x_saved", "stick", "energy_saved"):
        values = lanes[name].values
        assert np.isnan(values[1]).all() or name == "stick"
        np.testing.assert_array_equal(values[0], values[2])
        assert np.isfinite(values[0]).all()


def test_nothing_is_stored_of_what_is_skipped(monkeypatch):
    """A lane of many jumps keeps no more of them than it was asked for."""
    sizes = []

    class Counting(runs.MeasuredLane):
        def add(self, part):
            super().add(part)
            sizes.append(len(self.kept) + len(self.own))

    monkeypatch.setattr(runs, "MeasuredLane", Counting)
    lanes = hy.ensemble(
        BeadOnTable(r=0.5, omega=6.0), {"x": 1.5, "v": 0.0}, (0.0, 300.0),
        section="impact", skip=100, keep=3, measure=["stick"],
    )  # fmt: skip
    assert int(lanes.hits[0]) > 200
    assert max(sizes) == 1
    assert np.isfinite(lanes.v_section.values).all()


def test_functions_of_lanes():
    """A function of the Dataset of all lanes is a column."""

    def falls(table):
        return np.sqrt(2 * table.x_start / G)

    x = np.array([1.0, 2.0])
    lanes = hy.ensemble(Ball(), {"x": x, "v": 0.0}, (0.0, 1.0), measure=[falls, "energy"])
    np.testing.assert_allclose(lanes.falls, np.sqrt(2 * x / G), rtol=ROUNDING)
    assert "energy" in lanes


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"section": "bump"}, "there are the jumps impact"),
        ({"section": -1.0}, "a period greater than 0"),
        ({"section": "impact", "keep": 0}, "keep=0: a whole number, 1 or more"),
        ({"measure": ["period"]}, "counts points of a section="),
        ({"measure": ["liapunov"]}, "no state, output or measure 'liapunov'.*period, lyapunov"),
        ({"save": [2.0, 1.0]}, "increasing times"),
        ({"section": "impact", "certify": True}, "in a call of their own"),
    ],
)
def test_what_cannot_be_measured(asked, said):
    """Wrong use is one clear error before any lane flies."""
    with pytest.raises(hy.OptionError, match=said):
        hy.ensemble(Ball(), {"x": 1.0, "v": 0.0}, (0.0, 1.0), **asked)


@pytest.mark.parametrize("asked", [{}, {"skip": 3, "every": 2, "keep": 5}])
def test_jumps_of_lanes_that_machine_code_flies(asked, monkeypatch):
    """Points at the jumps of a contact are those of the loop of a run, to the last bit."""
    from hybrid.ensembles import measures

    def fly():
        return hy.ensemble(
            Ball(r=0.95),
            {"x": 1.0, "v": np.linspace(-1.0, 1.0, 40)},
            (0.0, 6.0),
            section="impact",
            **asked,
        )

    flown, driven = [], runs._Runs.row
    monkeypatch.setattr(runs._Runs, "row", lambda self, lane: flown.append(1) or driven(self, lane))
    table = fly()
    assert len(flown) < 5
    monkeypatch.setattr(measures.Measures, "jumps_only", property(lambda self: False))
    assert table.identical(fly())
    assert len(flown) >= 40
    assert np.isfinite(table.v_section.values).any()


@pytest.mark.parametrize(("section", "every"), [("impact", 1), ("impact", 3), (0.05, 1), (0.05, 4)])
@pytest.mark.parametrize("most", [None, 14])
def test_the_last_points(section, every, most):
    """``skip=None`` keeps the last ones of those that are kept otherwise, wherever a lane ends."""
    asked = {"start": {"x": 1.0, "v": 0.0}, "t": (0.0, 9.0), "section": section, "every": every}
    asked["max_jumps"] = most
    everyone = hy.ensemble(Ball(r=0.95), **asked, keep=999)
    last = hy.ensemble(Ball(r=0.95), **asked, skip=None, keep=4)
    there = np.isfinite(everyone.t_section.values[0])
    for name in ("t_section", "x_section", "v_section"):
        assert last[name].values[0].tolist() == everyone[name].values[0][there][-4:].tolist()
    assert last.hits.values == everyone.hits.values
    assert last.hit.values.tolist() == [-4 * every, -3 * every, -2 * every, -every]


def test_how_far_a_lane_still_moves():
    """A ball at rest does not, one that has jumped of late has no bound, an oscillator swings."""
    rest = hy.ensemble(Ball(), {"x": 1.0, "v": 0.0}, (0.0, 60.0), section=1.0, skip=None)
    assert rest.moves.values.tolist() == [0.0]
    assert 1.0 <= rest.x_size.values[0] < 1.5  # a sum of coefficients: a bound
    assert rest.x_range.values[0] == pytest.approx(0.0, abs=1e-15)
    assert rest.mode_section.values[0, :3].tolist() == [1.0, 1.0, 1.0]  # at rest on the contact
    jumping = hy.ensemble(Ball(), {"x": 1.0, "v": 0.0}, (0.0, 1.6), section=1.0, skip=None)
    assert jumping.moves.values.tolist() == [np.inf]
    swing = hy.ensemble(Swing(), {"x": 0.0, "v": 1.0}, (0.0, 80.0), section=1.0, skip=None)
    # x = sin t: ten units of time show more than a period, sampled at nine of them
    assert 1.0 < swing.moves.values[0] <= 2.0
    # a bound by sums of coefficients, over steps of more than a unit of time
    assert 2.0 <= swing.x_range.values[0] < 4.0


def test_the_largest_exponent():
    """The baker's map parts neighbours by three once in each unit of time, whoever flies it."""
    x = np.linspace(0.1, 0.9, 5)
    asked = {"start": {"x": x, "y": 0.2, "clock": 0.0}, "t": (0.0, 60.0), "measure": ["lyapunov"]}
    for solver in ("taylor", "scipy"):
        lanes = hy.ensemble(Baker(), **asked, solver=solver)
        # what lies across the direction after the transient, one part in 3^7, counts by its square
        np.testing.assert_allclose(lanes.lyapunov, np.log(3.0), rtol=1e-6)


def test_the_exponent_of_an_orbit_is_that_of_its_multipliers():
    """A complex pair turns round with the direction: the mean over 200 periods is right to about
    1/200 of the exponent; lanes keep their other columns."""
    model, period, speed, since, _ = bouncing(0.8, 0.2, 5.0)
    orbit = hy.periodic_orbit(model, flight(model, speed, since, 0.1), t=since + 0.1, period=period)
    start = {name: orbit.start[name] for name in orbit.start.keys()}
    span = orbit.run.t0, orbit.run.t0 + 220 * period
    lane = hy.ensemble(model, start, span, measure=["lyapunov", "stick"])
    exact = np.log(np.abs(orbit.multipliers[0])) / period
    assert lane.lyapunov.values[0] == pytest.approx(exact, rel=0.05)
    assert lane.stick.values[0] == 0.0


def test_an_exponent_of_what_has_none():
    """Neighbours of a ball at rest are lost; past the limit of a cycle, and of a lane that cannot
    begin, nothing is known of them."""
    rest = hy.ensemble(Ball(), {"x": 1.0, "v": 0.0}, (0.0, 60.0), measure=["lyapunov"])
    assert rest.lyapunov.values[0] == -np.inf
    still = hy.ensemble(Ball(), {"x": 0.0, "v": 0.0}, (0.0, 60.0), measure=["lyapunov"])
    assert still.lyapunov.values[0] == -np.inf  # as of hy.lyapunov, though lost in the transient
    below = hy.ensemble(Ball(), {"x": -1.0, "v": 0.0}, (0.0, 60.0), measure=["lyapunov"])
    assert np.isnan(below.lyapunov.values[0])
    assert below.status.values[0] == "outside"
    tanks = hy.ensemble(TwoTanks(), {"x1": 8.0, "x2": 6.0}, (0.0, 30.0), measure=["lyapunov"])
    assert np.isnan(tanks.lyapunov.values[0])
    assert tanks.status.values[0] == "reached_end"
    with pytest.raises(hy.OptionError, match="DelayBounce looks into the past: measure 'lyapunov'"):
        hy.ensemble(DelayBounce(), {"y": 0.05, "v": 0.0}, (0.0, 1.0), measure=["lyapunov"])
