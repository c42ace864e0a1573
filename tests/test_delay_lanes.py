"""Delays in ensembles and functions, as one trajectory, and their derivatives."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from models.pyragas import Pyragas

TIGHT = {"rtol": 1e-10, "atol": 1e-12}


class Decay(hy.Automaton):
    """``y' = -y(t - tau)``: polynomials, one more degree each lag."""

    y = hy.state()
    tau: float = hy.parameter(1.0)

    @hy.mode(initial=True)
    def only(self, t, s, past):
        return -past(self.tau).y


def decay(tau, t):
    """``y`` and its derivative by the lag, from the closed form, for ``y = 1`` before 0."""
    terms = [(k, t - (k - 1) * tau) for k in range(12) if t - (k - 1) * tau >= 0]
    y = sum((-1) ** k * s**k / math.factorial(k) for k, s in terms)
    slope = sum((-1) ** k * (1 - k) * s ** (k - 1) / math.factorial(k - 1) for k, s in terms if k)
    return y, slope


@pytest.fixture
def wide():
    """JAX in 64 bits, as a user of ``as_function`` has it."""
    with jax.enable_x64(True):
        yield


@pytest.mark.parametrize("memory", ["keep", "restart"])
def test_lanes_are_trajectories(memory):
    """Each lane ends where the trajectory of its own does, with as many accumulations.

    1e-8: both errors of 1e-10 a step, grown by the impacts.
    """
    starts = np.array([2.1, 2.5, 3.0, 5.0])
    lanes = hy.ensemble(Pyragas(), {"x1": starts, "x2": 0.0}, (0.0, 5.0), memory=memory, **TIGHT)
    assert set(lanes.status.values) == {"reached_end"}
    for k, x in enumerate(starts.tolist()):
        run = hy.simulate(Pyragas(), {"x1": x, "x2": 0.0}, (0.0, 5.0), memory=memory, **TIGHT)
        assert lanes.x1.values[k] == pytest.approx(float(run.final.x1), abs=1e-8)
        assert lanes.accumulations.values[k] == len(run.zeno)
        assert lanes["mode"].values[k] == run.mode
        if run.zeno:
            assert lanes.t_inf.values[k] == pytest.approx(run.zeno[0].t, abs=1e-10)


def test_released_by_what_returns(reference):
    """Chattering, rest and release by the delayed term, again and again, in one lane."""
    known = reference["pyragas"]["C=+60, r=0.2, x0=2.5, constant history, memory kept"]
    model, start = Pyragas(C=60.0, r=0.2), {"x1": 2.5, "x2": 0.0}
    until = np.array([2.6, 3.6, 4.8])
    lanes = hy.ensemble(model, start, (0.0, until), **TIGHT)
    assert lanes.accumulations.values.tolist() == [1, 2, 3]
    assert set(lanes["mode"].values) == {"flight.rest(impact)"}
    np.testing.assert_allclose(lanes.t_inf, float(known["sticks"][0]), atol=1e-10)


def test_histories_of_lanes():
    """Constants by lane, functions of time, and the start where nothing is said."""
    for history, before in (
        ({"y": np.array([1.0, 2.0])}, [1.0, 2.0]),
        (None, [3.0, 3.0]),
    ):
        lanes = hy.ensemble(Decay(), {"y": np.full(2, 3.0)}, (0.0, 0.5), history=history, **TIGHT)
        np.testing.assert_allclose(lanes.y, 3.0 - 0.5 * np.array(before), rtol=1e-14)
    half = Decay(tau=np.pi / 2)
    for history in ({"y": jnp.cos}, lambda t: {"y": jnp.cos(t)}):
        lanes = hy.ensemble(half, {"y": np.ones(2)}, (0.0, 20 * np.pi), history=history, **TIGHT)
        # ten periods of 4 steps of 1e-12 each
        np.testing.assert_allclose(lanes.y, 1.0, atol=1e-10)


def test_lags_may_differ_by_lane():
    """A lag is a parameter like any other."""
    lags = np.array([0.3, 0.7, 1.0, 2.5])
    lanes = hy.ensemble(Decay(), {"y": 1.0}, (0.0, 2.0), {"tau": lags}, **TIGHT)
    expected = [decay(lag, 2.0)[0] for lag in lags]
    np.testing.assert_allclose(lanes.y, expected, atol=1e-11)


def test_a_lane_says_what_it_has_forgotten():
    """A history that has no value where it is seen ends the lane, with its reason."""
    history = {"y": lambda t: np.nan if t < -0.5 else 1.0}
    lanes = hy.ensemble(Decay(), {"y": 1.0}, (0.0, 1.0), {"tau": [0.3, 2.0]}, history=history)
    assert lanes.status.values.tolist() == ["reached_end", "forgotten"]
    assert "is not finite" in str(lanes.reason.values[1])


def test_derivatives_by_the_lag(wide):
    """Forward and reverse, through breaking points: the closed form to rounding."""
    run = hy.as_function(Decay(), t=(0.0, 3.3), max_jumps=1, max_steps=64, segments=32, **TIGHT)

    def end(tau):
        return run(Decay(tau=tau), {"y": 1.0}).final["y"]

    value, slope = decay(1.0, 3.3)
    assert end(1.0) == pytest.approx(value, abs=1e-14)
    assert jax.jvp(end, (1.0,), (1.0,))[1] == pytest.approx(slope, abs=1e-13)
    assert jax.grad(end)(1.0) == pytest.approx(slope, abs=1e-13)


def test_derivatives_through_impacts(wide):
    """The second impact's time by the lag, against differences of Taylor runs (1e-9: theirs)."""
    start, span = {"x1": 2.5, "x2": 0.0}, (0.0, 1.5)
    run = hy.as_function(
        Pyragas(tau=0.3),
        t=span,
        max_jumps=8,
        max_steps=200,
        segments=64,
        outputs=("jumps",),
        **TIGHT,
    )

    def time(tau):
        return run(Pyragas(tau=tau), start).jumps.t[1]

    def exact(tau):
        return hy.simulate(Pyragas(tau=tau), start, span, solver="taylor", max_jumps=2).jumps.t[1]

    h = 2.5e-4
    sides = [exact(0.3 + k * h) for k in (-2, -1, 1, 2)]
    differences = (sides[0] - 8 * sides[1] + 8 * sides[2] - sides[3]) / (12 * h)
    assert jax.jvp(time, (0.3,), (1.0,))[1] == pytest.approx(differences, rel=1e-8)


def _called(model, start, t, **options):
    return hy.as_function(model, t=t, max_jumps=1, **options)(model, start)


@pytest.mark.parametrize("memory", ["keep", "restart"])
def test_a_function_is_the_run(wide, memory):
    """To the last bit it gives what ``simulate`` does, through impacts, a limit and rest."""
    start, t = {"x1": 2.5, "x2": 0.0}, (0.0, 3.0)
    run = hy.simulate(Pyragas(r=0.4), start, t, solver="taylor", memory=memory)
    function = hy.as_function(Pyragas(), t=t, max_jumps=64, memory=memory)
    found = function(Pyragas(r=0.4), start)
    assert found.final == {"x1": run.final.x1, "x2": run.final.x2}
    assert found.zeno.t == run.zeno[0].t
    assert found.jumps.t[0] == run.jumps.t[0]


def test_a_lag_that_moves(wide):
    """``y' = -k y(t / 2)`` in a closed form: a series in ``k t``."""

    class Pantograph(hy.Automaton):
        y = hy.state()
        k = hy.parameter(1.0)

        @hy.mode
        def only(self, t, s, past):
            return -self.k * past(0.5 * t).y

    run = hy.as_function(Pantograph(), t=(0.0, 1.5), max_jumps=1)

    def end(k):
        return run(Pantograph(k=k), {"y": 1.0}).final["y"]

    terms = [1.5**n / math.factorial(n) * 0.5 ** (n * (n - 1) / 2) for n in range(30)]
    value = sum((-1) ** n * term for n, term in enumerate(terms))
    slope = sum((-1) ** n * n * term for n, term in enumerate(terms))
    assert end(1.0) == pytest.approx(value, abs=1e-13)  # rounding of the steps
    assert jax.grad(end)(1.0) == pytest.approx(slope, abs=1e-12)  # as resolved


def test_where_there_is_no_derivative(wide):
    """Impacts accumulate while a lag moves: values are there, and derivatives up to the limit."""

    class Ball(hy.Automaton):
        x = hy.state()
        v = hy.state()
        g = hy.parameter(9.81)

        @hy.mode
        def flight(self, t, s, past):
            return s.v, past(0.5 + 0.1 * jnp.sin(t)).x - self.g

        impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)

    run = hy.as_function(Ball(), t=(0.0, 2.0), max_jumps=64)

    def ends(g):
        out = run(Ball(g=g), {"x": 1.0, "v": 0.0})
        return jnp.stack([out.jumps.t[0], out.zeno.t]), out

    slopes, out = jax.jacrev(ends, has_aux=True)(9.81)
    assert np.isfinite(slopes[0])
    assert np.isnan(slopes[1])
    assert out.status == 1
    assert out.zeno.t < 2.0


class Lifted(hy.Automaton):
    """A mass at rest, lifted by a force that was: after the release it sees that of the release."""

    x = hy.state()
    v = hy.state()
    w = hy.state()

    @hy.mode
    def moves(self, t, s, past):
        return s.v, -1.0 + 1.5 * past(0.3).w * jnp.sin(2.0 * t), 0.2 * s.w

    impact = hy.contact(moves, gap=lambda self, t, s: s.x, restitution=0.4)


class Slides(hy.Automaton):
    """A relay that slides, and leaves its surface by what was before."""

    x = hy.state()
    v = hy.state()
    w = hy.state()

    def force(self, s, past):
        return 0.5 * past(0.4).w - s.x - 0.3 * s.v

    @hy.mode(initial=True)
    def above(self, t, s, past):
        return s.v, self.force(s, past) - 0.7, 0.6 * s.w

    @hy.mode
    def below(self, t, s, past):
        return s.v, self.force(s, past) + 0.7, 0.6 * s.w

    relay = hy.switching(above, below, surface=lambda self, t, s: s.v + 0.5 * s.x - 0.4)


@pytest.mark.parametrize(
    ("model", "start", "leaves"),
    [
        (Lifted, {"x": 0.0, "v": 0.0, "w": 1.2}, "impact.release"),
        (Slides, {"x": 0.2, "v": 0.7, "w": 1.3}, "relay.positive"),
    ],
)
@pytest.mark.parametrize("memory", ["keep", "restart"])
def test_derivatives_where_a_rest_or_a_slide_ends(wide, model, start, leaves, memory):
    """With a restarted past the flow jumps there: neighbours that leave later see another one.

    Differences over 1e-5 of runs to rounding are right to 1e-10.
    """
    asked = {"t": (0.0, 3.0), "memory": memory}
    run = hy.simulate(model(), start, solver="taylor", **asked)
    assert leaves in {jump.edge for jump in run.jumps}
    end = hy.as_function(model(), max_jumps=50, **asked)
    found = jax.jacfwd(lambda w: end(model(), {**start, "w": w}).final)(start["w"])
    ends = [
        hy.simulate(model(), {**start, "w": start["w"] + d}, solver="taylor", **asked).final
        for d in (-1e-5, 1e-5)
    ]
    for name in ("x", "v", "w"):
        slope = (getattr(ends[1], name) - getattr(ends[0], name)) / 2e-5
        assert float(found[name]) == pytest.approx(slope, abs=1e-8)


def test_second_derivatives_are_refused(wide):
    """With what can be done."""
    run = hy.as_function(Decay(), t=(0.0, 1.0), max_jumps=1)
    with pytest.raises(hy.OptionError, match=r"Decay looks into the past.*take differences"):
        jax.hessian(lambda tau: run(Decay(tau=tau), {"y": 1.0}).final["y"])(0.5)


def test_refusals():
    """What lanes and functions cannot do is said, with what can."""

    class Plain(hy.Automaton):
        y = hy.state()

        @hy.mode(initial=True)
        def only(self, t, s):
            return -s.y

    for function in (hy.ensemble, _called):
        with pytest.raises(hy.OptionError, match="looks into the past"):
            function(Plain(), {"y": 1.0}, (0.0, 1.0), history={"y": 1.0})
        with pytest.raises(hy.OptionError, match="memory='lose'"):
            function(Decay(), {"y": 1.0}, (0.0, 1.0), memory="lose")
        with pytest.raises(hy.OptionError, match="history of 'z'; the states are y"):
            function(Decay(), {"y": 1.0}, (0.0, 1.0), history={"z": 1.0})


class Unseen(hy.Automaton):
    """A bead on a table, and a speed that is seen later than the run lasts."""

    x = hy.state()
    v = hy.state()
    g: float = hy.parameter(6.8)
    amplitude: float = hy.parameter(0.3)
    omega: float = hy.parameter(5.1)

    @hy.mode
    def flight(self, t, s, past):
        return s.v, -self.g + 0.0 * past(2.0).v

    table = hy.contact(
        flight,
        gap=lambda self, t, s: s.x - self.amplitude * jnp.sin(self.omega * t),
        restitution=0.14,
    )


class Plain(Unseen):
    """The same without a delay."""

    @hy.mode
    def flight(self, t, s):
        return s.v, -self.g

    table = hy.contact(
        flight,
        gap=lambda self, t, s: s.x - self.amplitude * jnp.sin(self.omega * t),
        restitution=0.14,
    )


@pytest.mark.parametrize(("amplitude", "omega"), [(0.39, 3.0), (0.39, 5.1), (0.3, 5.1)])
def test_a_limit_has_its_derivative_though_its_last_flights_are_not_resolved(
    wide, amplitude, omega
):
    """Flights that later delays may see are carried one by one, as far as the time resolves the
    speeds of their impacts: 4e-10 at ``t = 1``. Beyond, there was no derivative. What has no delay
    has the same one, by the rule for sums."""
    start, found = {"x": 1.0, "v": 0.0}, []
    for model in Unseen, Plain:
        fall = hy.as_function(model(), t=(0.0, 0.85), max_jumps=400, solver="taylor")

        def limit(g, model=model, fall=fall):
            return fall(model(g=g, amplitude=amplitude, omega=omega), start).zeno.t

        found.append(float(jax.jacfwd(limit)(6.8)))
    assert found[0] == pytest.approx(found[1], rel=1e-9)
