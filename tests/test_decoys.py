"""Shrinking gaps that are no accumulation, next to ones that are."""

import numpy as np
import pytest

import hybrid as hy
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall

from . import systems


def test_weakening_gravity_on_both_sides_of_its_threshold(reference):
    """Escapes and accumulations down to 1e-9 from the border, each with its impacts."""
    for case in reference["decoy_weakening_gravity"]["r=0.5"]["cases"]:
        speed = float(case["v(0+) (y(0)=0)"])
        run = hy.simulate(
            systems.WeakeningGravity(), {"y": 0.0, "v": speed}, (0, 2), rtol=1e-13, atol=1e-15
        )
        if case["outcome"] == "zeno":
            assert run.zeno[0].t == pytest.approx(float(case["theta_inf"]), abs=1e-9)
            assert run.zeno[0].t_release == pytest.approx(1.0, abs=1e-12)
        else:
            assert not run.zeno
            assert len(run.jumps) == case["number_of_impacts_after_t=0"]


def test_harmonic_gaps_never_accumulate(reference):
    """The n-th impact is at the n-th harmonic number: 615 of them up to t = 7."""
    run = hy.simulate(systems.HarmonicBall(), {"x": 0.0, "v": 1.0}, (0, 7), rtol=1e-12)
    assert not run.zeno
    assert len(run.jumps) == reference["decoy_harmonic"]["impacts_up_to_t"]["7"]
    assert run.jumps.t[99] == pytest.approx(5.1873775176396202608, abs=1e-11)


class LeastTurn(hy.Automaton):
    """Turns that shrink by halves, but to a least length: they take for ever."""

    x = hy.state()
    y = hy.state()
    least: float = hy.parameter(0.0)

    @hy.mode(initial=True)
    def fall(self, t, s):
        return -1.0, 0.0

    @hy.mode(limit_of=("drop",))
    def after(self, t, s):
        return 1.0, 0.0

    @hy.edge(fall, to=fall, guard=lambda self, t, s: s.x)
    def drop(self, t, s):
        shorter = 0.5 * (s.y + self.least)
        return s.replace(x=shorter, y=shorter)


@pytest.mark.parametrize("least", [0.0, 1e-10, 1e-9, 1e-8])
def test_turns_that_tend_to_a_least_length_never_accumulate(solver, least):
    """However little that is: the guard at the limit of the states is not zero."""
    run = hy.simulate(LeastTurn(least=least), {"x": 1.0, "y": 1.0}, (0, 3), max_jumps=200, **solver)
    if least:
        assert run.status is hy.Status.MAX_JUMPS
        assert not run.zeno
    else:
        assert abs(run.zeno[0].t - 2.0) <= run.zeno[0].t_error < 1e-11


def test_elastic_impacts_never_accumulate():
    """r = 1: the gaps do not shrink."""
    run = hy.simulate(BouncingBall(r=1.0), {"x": 1.0, "v": 0.0}, (0, 20))
    assert not run.zeno
    assert run.jumps.gaps[-1] == pytest.approx(run.jumps.gaps[0], rel=1e-12)


def test_a_plastic_impact_rests_at_once():
    """r = 0: one impact, then the resting mode; no accumulation is claimed."""
    run = hy.simulate(BouncingBall(r=0.0), {"x": 1.0, "v": 0.0}, (0, 2))
    assert len(run.jumps) == 1
    assert not run.zeno
    assert run.mode == "flight.rest(impact)"


def test_budd_and_dux_shrinking_gaps_that_end():
    """w = 2.8, r = 0.8, wall at 0: five shrinking gaps, then the wall lets go."""
    run = hy.simulate(systems.ForcedOscillator(), {"x": 0.0, "v": -0.05}, (0, 2), rtol=1e-10)
    assert not run.zeno
    assert list(run.jumps.gaps[:4]) == sorted(run.jumps.gaps[:4], reverse=True)


def test_speed_dependent_restitution_accumulates():
    """v+ = 0.7 v / (1 + 0.1 v), g = 2: t_inf from a sum of a thousand terms."""

    class Soft(systems.LawBall):
        impact = hy.contact(
            "flight",
            gap=lambda self, t, s: s.x,
            restitution=lambda self, t, s, u: 0.7 / (1 - 0.1 * u),
        )

    v, t = 1.0, 0.0
    for _ in range(1000):
        t, v = t + v, 0.7 * v / (1 + 0.1 * v)
    run = hy.simulate(Soft(), {"x": 0.0, "v": 1.0}, (0, 20), rtol=1e-12)
    assert run.zeno[0].t == pytest.approx(t, abs=1e-12)
    assert run.zeno[0].ratio == 0.7


def test_the_sum_stops_short_of_the_end_of_the_run():
    """t1 before t_inf: no accumulation is reported, and the impacts up to t1 are there."""
    run = hy.simulate(BouncingBall(), {"x": 1.0, "v": 0.0}, (0, 2.5))
    assert not run.zeno
    assert run.t1 == 2.5
    assert run.jumps.t[-1] <= 2.5


@pytest.mark.parametrize("method", ["Tsit5", "Dopri8"])
def test_a_long_run_hides_no_small_table(method):
    """The step that a parabola allows spans many of the table's periods: none is jumped over."""
    model = BeadOnTable(r=0.85, omega=7.0, amplitude=1.0)
    options = {"max_jumps": 4, "save": "jumps", "rtol": 1e-9, "atol": 1e-9}
    start = {"x": 5.0, "v": 0.0}
    exact = hy.simulate(model, start, (0, 1e3), solver="taylor", **options)
    for end in (1e4, 1e6, 1e9):
        run = hy.simulate(model, start, (0, end), solver="diffrax", method=method, **options)
        np.testing.assert_allclose(run.jumps.t, exact.jumps.t, atol=1e-6)
