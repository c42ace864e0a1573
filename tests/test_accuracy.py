"""Accumulation times against reference values, and the true error against its bound."""

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from models.ball_on_circle import BallOnCircle
from models.bead_on_table import BeadOnTable
from models.bouncing_ball import BouncingBall
from models.hard_spring import HardSpring
from models.moon_holmes import MoonHolmes

from .conftest import SOLVERS

TOLERANCES = [1e-6, 1e-9, 1e-12]


@pytest.fixture(params=["DOP853", "Dopri8"])
def backend(request):
    """Options that choose the default method of each backend."""
    return SOLVERS[request.param]


def check(run, t_inf, tolerance):
    """The bound holds; at 1e-12 the result is within 1e-11."""
    point = run.zeno[0]
    error = abs(point.t - t_inf)
    assert error <= point.t_error
    if tolerance <= 1e-12:
        assert error <= 1e-11 * t_inf


@pytest.mark.parametrize(
    ("e", "t_inf"), [(0.7, 2.55863396558580846), (0.99, 89.85320455616), (0.999, 902.59575833047)]
)
def test_bouncing_ball_in_closed_form(backend, e, t_inf):
    """1e-12 relative from a handful of impacts, however many a brute force would need."""
    exact = np.sqrt(2 / 9.81) * (1 + e) / (1 - e)
    assert exact == pytest.approx(t_inf, rel=1e-12)
    run = hy.simulate(BouncingBall(r=e), {"x": 1.0, "v": 0.0}, (0, 1000), save="jumps", **backend)
    assert abs(run.zeno[0].t - exact) <= min(1e-12 * exact, run.zeno[0].t_error)
    assert len(run.own_jumps) <= 3
    assert run.final.x == 0.0


@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize("r", ["0.8", "0.5", "0.99"])
def test_example_1(backend, reference, r, tolerance):
    """t_inf, and the first impacts to 1e-10 at 1e-12."""
    case = reference["example_1"][f"r={r},x0=2.1"]
    run = hy.simulate(
        HardSpring(r=float(r)),
        {"x": 2.1, "v": 0.0},
        (0, 31),
        rtol=tolerance,
        atol=tolerance,
        **backend,
    )
    check(run, float(case["t_inf"]), tolerance)
    if tolerance <= 1e-12:
        first = [float(row["t"]) for row in case["first_impacts"][:20]]
        np.testing.assert_allclose(run.jumps.t[: len(first)], first, rtol=0, atol=1e-10)


@pytest.mark.parametrize("r", ["0.8", "0.5", "0.99"])
def test_example_1_to_rounding(reference, r):
    """As exact as ``1 / (1 - r)`` flights, each of which is off by some roundings of the time."""
    exact = float(reference["example_1"][f"r={r},x0=2.1"]["t_inf"])
    run = hy.simulate(HardSpring(r=float(r)), {"x": 2.1, "v": 0.0}, (0, 31), solver="taylor")
    assert abs(run.zeno[0].t - exact) <= 8 * np.spacing(exact) / (1 - float(r))
    assert abs(run.zeno[0].t - exact) <= run.zeno[0].t_error


@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_example_2(backend, reference, tolerance):
    """A moving table: t_inf, the point on the table, and the first impacts."""
    case = reference["example_2"]
    run = hy.simulate(
        BeadOnTable(), [1.9, 0.0], (2 * np.pi / 0.29, 40), rtol=tolerance, atol=tolerance, **backend
    )
    check(run, float(case["t_inf"]), tolerance)
    x_inf = float(case["X(t_inf)"])
    assert abs(run.zeno[0].state.x - x_inf) <= run.zeno[0].state_error.x
    first = [float(row["t"]) for row in case["impacts"]]
    np.testing.assert_allclose(run.jumps.t[: len(first)], first, rtol=0, atol=1e-10)


@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize(("delta", "gamma"), [(0.0, 0.0), (0.05, 0.05)])
def test_moon_holmes(backend, reference, delta, gamma, tolerance):
    """With and without forcing."""
    key = "0" if delta == 0 else "0.05"
    case = reference[f"moon_holmes delta={key},gamma={key},w=0.1"]
    run = hy.simulate(
        MoonHolmes(delta=delta, gamma=gamma),
        [1.3, 0.0],
        (0, 30),
        rtol=tolerance,
        atol=tolerance,
        **backend,
    )
    check(run, float(case["t_inf"]), tolerance)
    if tolerance <= 1e-12:
        first = [float(row["t"]) for row in case["first_impacts"]]
        np.testing.assert_allclose(run.jumps.t[: len(first)], first, rtol=0, atol=1e-10)


def test_a_force_whose_terms_cancel_where_they_turn():
    """``cos(t) - 1`` rounds by half a spacing of 1, which points beside do not show: the step is
    taken all the same, and the speed is off by that in all of its time."""

    class Eased(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def pushed(self, t, s):
            return s.v, jnp.cos(t) - 1.0

    for end in (1e-3, 1e-4, 1e-6):
        run = hy.simulate(Eased(), {"x": 0.0, "v": 0.0}, (0.0, end), solver="taylor")
        exact = end**5 / 120.0 - end**3 / 6.0  # of sin(t) - t
        assert abs(run.final.v - exact) < 1.2e-16 * end
        assert run.stats.steps < 10


def test_the_circle_from_three_starts(backend):
    """0.191 chatters, slides and leaves; 0.192 makes 9 bounces; 0.15 leaves at a known height."""
    chatters = hy.simulate(BallOnCircle(), {"q": [0.191, 1.2], "p": [0, 0]}, (0, 6), **backend)
    assert len(chatters.zeno) == 1
    assert chatters.zeno[0].t_release is not None
    bounces = hy.simulate(BallOnCircle(), {"q": [0.192, 1.2], "p": [0, 0]}, (0, 6), **backend)
    assert (len(bounces.zeno), len(bounces.jumps)) == (0, 9)
    known = hy.simulate(
        BallOnCircle(), {"q": [0.15, 1.2], "p": [0, 0]}, (0, 6), rtol=1e-12, **backend
    )
    assert known(known.zeno[0].t_release).q[1] == pytest.approx(0.664320513532, abs=1e-11)


@pytest.mark.parametrize(
    "options",
    [
        {"solver": "taylor"},
        {"rtol": 1e-13, "atol": 1e-15},
        {"rtol": 1e-13, "atol": 1e-15, "solver": "diffrax", "method": "Dopri8"},
    ],
)
def test_the_border_between_chattering_and_bouncing_off(options):
    """0.1913325241911, known to 13 digits: chattering on one side of it, none on the other.

    Near it impacts are as slow as 1e-12; they are right only with the gap as a coordinate.
    """
    for x, count in ((0.1913325241910, 1), (0.1913325241912, 0)):
        run = hy.simulate(BallOnCircle(), {"q": [x, 1.2], "p": [0, 0]}, (0, 6), **options)
        assert len(run.zeno) == count


def test_run_in_the_tail_is_the_closed_form():
    """Dense output inside the infinitely many flights of a ball."""
    r, g = 0.7, 9.81
    run = hy.simulate(BouncingBall(r=r), {"x": 1.0, "v": 0.0}, (0, 3), rtol=1e-12)
    v = np.sqrt(2 * g) * r ** np.arange(1, 30)
    starts = np.sqrt(2 / g) + np.concatenate([[0], np.cumsum(2 * v / g)])[:-1]
    for n in (0, 1, 5, 20):
        s = 0.3 * 2 * v[n] / g
        state = run(starts[n] + s)
        assert state.x == pytest.approx(v[n] * s - g * s * s / 2, abs=1e-13)
        assert state.v == pytest.approx(v[n] - g * s, abs=1e-12)
