"""Random numbers in resets: the same ones for the same seed, lane, jump and call."""

import json

import jax
import numpy as np
import pytest
from typer.testing import CliRunner

import hybrid as hy
from hybrid.automaton.chance import KEY_STEPS, MULTIPLIERS, PHILOX_ROUNDS, mixed
from hybrid.cli import app
from hybrid.lowering.jit import jit

SOLVERS = ["taylor", "scipy", "diffrax"]
START = {"x": 0.0, "u": 0.0, "n": 0.0}


class Walk(hy.Automaton):
    """A clock that shows numbers: x flows between, from what was drawn."""

    x = hy.state()
    u = hy.discrete(0.0)
    n = hy.discrete(0.0)

    @hy.mode(initial=True)
    def go(self, t, s):
        return s.u

    @hy.edge(go, every=1.0)
    def draws_two(self, t, s, draw):
        return s.replace(u=draw.uniform(), n=draw.normal())


class Ball(hy.Automaton):
    """It bounces off a rough floor, to a height of its own each time."""

    x = hy.state()
    v = hy.state()
    push: float = hy.parameter(0.5)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -9.81

    @hy.edge(flight, to=flight, guard=lambda self, t, s: s.x)
    def bounce(self, t, s, draw):
        return s.replace(x=0.0, v=self.push + draw.uniform())


class Losing(Ball):
    """Its impacts accumulate, but nobody can say where."""

    @hy.edge("flight", to="flight", guard=lambda self, t, s: s.x)
    def bounce(self, t, s, draw):
        return s.replace(x=0.0, v=-(0.5 + 0.4 * draw.uniform()) * s.v)

    @hy.mode(limit_of=("bounce",))
    def rest(self, t, s):
        return 0.0, 0.0


class Rough(hy.Automaton):
    """A ball on a floor that returns a random part of its speed."""

    x = hy.state()
    v = hy.state()
    floor: float = hy.parameter(0.0)
    least: float = hy.parameter(0.3)

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -9.81

    impact = hy.contact(
        flight,
        gap=lambda self, t, s: s.x - self.floor,
        restitution=lambda self, t, s, u, draw: self.least + 0.5 * draw.uniform(),
    )


def fallen(seed, lane, impacts=400):
    """Times of the impacts of a Rough ball that falls from 1, and their limit, by closed forms."""
    fall = (2.0 / 9.81) ** 0.5
    shares = [0.3 + 0.5 * drawn(seed, lane, jump)[0] for jump in range(1, impacts)]
    return fall + np.append(0.0, np.cumsum(2.0 * fall * np.cumprod(shares)))


def philox(counter, key):
    """The same with Python's whole numbers."""
    (a, b, c, d), (k, m) = counter, key
    for _ in range(PHILOX_ROUNDS):
        p, q = a * int(MULTIPLIERS[0]), c * int(MULTIPLIERS[1])
        a, b, c, d = (
            ((q >> 26) + b + k) % 2**26,
            q % 2**26,
            ((p >> 26) + d + m) % 2**26,
            p % 2**26,
        )
        k, m = (k + int(KEY_STEPS[0])) % 2**26, (m + int(KEY_STEPS[1])) % 2**26
    return a, b, c, d


def drawn(seed, lane, jump):
    """What Walk draws, by whole numbers."""
    first, second = (philox((jump, 0, call, 0), (seed, lane)) for call in (0, 1))
    u = ((first[0] << 26) + first[1] + 0.5) / 2**52
    one, other = (((second[i] << 26) + second[i + 1] + 0.5) / 2**52 for i in (0, 2))
    return u, np.sqrt(-2.0 * np.log(one)) * np.cos(2.0 * np.pi * other)


@pytest.fixture(params=SOLVERS)
def solver(request):
    return request.param


def test_numbers_are_those_of_seed_lane_jump_and_call(solver):
    run = hy.simulate(Walk(), START, (0.0, 5.5), solver=solver, seed=7)
    due = np.array([drawn(7, 0, jump) for jump in range(1, 6)])
    assert run.jumps.after.u.tolist() == due[:, 0].tolist()
    # functions of two libraries, each to a few roundings
    assert run.jumps.after.n == pytest.approx(due[:, 1], rel=1e-14)
    assert run.final.draws == 5
    assert run.final.x == pytest.approx(due[:4, 0].sum() + 0.5 * due[4, 0], rel=1e-9)


def test_lanes_have_numbers_of_their_own(solver):
    lanes = hy.ensemble(Walk(), {**START, "x": np.zeros(3)}, (0.0, 2.5), solver=solver, seed=7)
    assert lanes["u"].values.tolist() == [drawn(7, lane, 2)[0] for lane in range(3)]
    run = hy.simulate(Walk(), {**START, "stream": 7 * 2**26 + 2}, (0.0, 2.5), solver=solver)
    assert run.final.u == lanes["u"][2]


def test_maps_are_told_which_streams(tmp_path):
    over = {"u": [0.0, 1.0], "stream": [0, 1]}
    start, span = {"x": 0.0, "n": 0.0}, (0.0, 1.5)
    table = hy.sweep(Walk(), over=over, start=start, t=span, block=1)
    assert table["u"].values.tolist() == [[drawn(0, lane, 1)[0] for lane in range(2)]] * 2
    with pytest.raises(hy.OptionError, match="draws_two draws: say from which streams"):
        hy.sweep(Walk(), over={"u": [0.0, 1.0]}, start=start, t=span)


def test_a_run_goes_on_with_the_numbers_that_come_next(solver):
    whole = hy.simulate(Walk(), START, (0.0, 5.5), solver=solver, seed=7)
    first = hy.simulate(Walk(), START, (0.0, 2.5), solver=solver, seed=7)
    more = hy.simulate(Walk(), first, (2.5, 5.5), solver=solver)
    assert (first + more).jumps.after.u.tolist() == whole.jumps.after.u.tolist()


def test_files_keep_them(tmp_path):
    run = hy.simulate(Walk(), START, (0.0, 2.5), seed=7)
    run.save(tmp_path / "run.nc")
    loaded = hy.load(tmp_path / "run.nc", Walk)
    assert loaded.final == run.final
    assert loaded.final.stream == 7 * 2**26


def test_derivatives_take_them_for_constants():
    """x = (push + u) tau - g tau^2 / 2 after the bounce at the start's fall time."""
    fall = (2.0 / 9.81) ** 0.5
    with jax.enable_x64(True):
        f = hy.as_function(Ball(), t=(0.0, fall + 0.05), max_jumps=10)
        start = {"x": 1.0, "v": 0.0, "stream": 5 * 2**26}
        slope = jax.grad(lambda push: f(Ball(push=push), start).final["x"])(0.5)
        final = f(Ball(), start).final
    u, _ = drawn(5, 0, 1)
    assert slope == pytest.approx(0.05, rel=1e-12)
    assert final["x"] == pytest.approx((0.5 + u) * 0.05 - 9.81 * 0.05**2 / 2, rel=1e-12)


def test_no_limit_is_believed_of_what_is_drawn(solver):
    """It is said, with the edge's name, where no time passes any more; until then each is flown."""
    run = hy.simulate(Losing(), {"x": 1.0, "v": 0.0}, (0.0, 1.5), solver=solver)
    assert not run.zeno
    with pytest.raises(hy.JumpLoopError, match=r"bounce; .*which those that draw do not"):
        hy.simulate(Losing(), {"x": 1.0, "v": 0.0}, (0.0, 5.0), solver=solver)


def test_impacts_with_random_restitution_come_to_rest(solver):
    """Where the sum of the flights says, each speed a drawn part of the one before; the same on a
    high floor, where low flights drown in the rounding of the position."""
    due = fallen(3, 0)
    for floor in (0.0, 2.0):
        run = hy.simulate(
            Rough(floor=floor), {"x": floor + 1.0, "v": 0.0}, (0.0, 5.0), solver=solver, seed=3
        )
        (point,) = run.zeno
        assert run.arcs[-1].mode == point.mode == "flight.rest(impact)"
        assert abs(point.t - due[-1]) <= point.t_error < 1e-11
        assert point.state.x == floor
        assert abs(point.state.v) <= point.state_error.v < 1e-40
        assert point.state_error.draws == np.inf
        assert point.verdict == "estimated"
        assert np.isnan(point.ratio)
        assert run.final.draws == len(run.jumps)
        # times of up to 1.5, after up to a hundred flights
        np.testing.assert_allclose(run.jumps.t, due[: len(run.jumps)], rtol=0, atol=1e-12)
    assert "fall at random" in run.explain()


def test_lanes_with_random_restitution_come_to_rest_each_in_its_time(solver):
    lanes = hy.ensemble(Rough(), {"x": np.ones(3), "v": 0.0}, (0.0, 5.0), solver=solver, seed=7)
    due = [fallen(7, lane)[-1] for lane in range(3)]
    np.testing.assert_allclose(lanes["t_inf"], due, rtol=1e-12)


def test_what_is_done_at_the_limit_of_drawn_impacts_is_a_choice():
    start, span = {"x": 1.0, "v": 0.0}, (0.0, 5.0)
    stopped = hy.simulate(Rough(), start, span, seed=3, zeno="stop")
    assert stopped.status is hy.Status.ZENO_STOPPED
    assert stopped.t1 == stopped.zeno[0].t
    with pytest.raises(hy.ZenoError, match="gaps that fall at random"):
        hy.simulate(Rough(), start, span, seed=3, zeno="raise")
    with pytest.raises(hy.OptionError, match="the impacts of impact, whose restitution draws"):
        hy.simulate(Rough(), start, span, seed=3, zeno="truncate", max_jumps=5)
    first = hy.simulate(Rough(), start, (0.0, 1.2), seed=3)
    whole = first + hy.simulate(Rough(), first, (1.2, 5.0))
    # the run starts anew at 1.2, in the middle of a flight
    assert whole.zeno[0].t == pytest.approx(stopped.t1, rel=1e-13)


def test_beads_with_random_restitution_come_to_rest_together():
    """They touch when they land: impacts at one instant, each with a restitution of its own, that
    no constant share sums; and low flights behind them, until nothing moves."""

    class Column(hy.Automaton):
        x = hy.state(shape=(3,))
        v = hy.state(shape=(3,))

        @hy.mode(initial=True)
        def fall(self, t, s):
            return s.v, np.full(3, -9.81)

        impact = hy.contact(
            fall,
            gap=lambda self, t, s: s.x - np.eye(3, k=-1) @ s.x,
            restitution=lambda self, t, s, u, draw: 0.2 + 0.3 * draw.uniform(),
        )

    start = {"x": [1.0, 1.0, 1.0], "v": [0.0, 0.0, 0.0]}
    run = hy.simulate(Column(), start, (0.0, 1.0), solver="taylor", seed=1)
    assert run.arcs[-1].mode == "fall.rest(impact[0], impact[1], impact[2])"
    assert 0.0 <= run.zeno[0].t - (2.0 / 9.81) ** 0.5 < 0.1
    np.testing.assert_allclose(run.final.v, 0.0, atol=1e-40)  # rounding of the last, 1e-31


@pytest.mark.long
def test_derivatives_take_drawn_restitutions_for_constants():
    """Between the first impact and the second v = r g fall - g tau, and r has slope 1 in least."""
    fall = (2.0 / 9.81) ** 0.5
    with jax.enable_x64(True):
        f = hy.as_function(Rough(), t=(0.0, fall + 0.05), max_jumps=10)
        start = {"x": 1.0, "v": 0.0, "stream": 5.0 * 2**26}
        v = lambda least: f(Rough(least=least), start).final.v  # noqa: E731
        slope = float(jit(jax.grad(v))(0.3))
        bend = float(jit(jax.hessian(lambda least: v(least) ** 2))(0.3))
    assert slope == pytest.approx(9.81 * fall, rel=1e-12)
    assert bend == pytest.approx(2.0 * slope**2, rel=1e-9)


def test_a_drawn_restitution_below_zero_is_refused():
    class Wild(Rough):
        impact = hy.contact(
            "flight",
            gap=lambda self, t, s: s.x,
            restitution=lambda self, t, s, u, draw: draw.uniform() - 1.0,
        )

    with pytest.raises(hy.FlowError, match="the restitution of impact gives the speed -"):
        hy.simulate(Wild(), {"x": 1.0, "v": 0.0}, (0.0, 1.0))


def test_the_command_line_takes_a_seed(tmp_path):
    """Another seed falls another time; JSON has no number for a ratio that is none."""
    path = tmp_path / "stony.py"
    path.write_text(
        "import hybrid as hy\n\n\nclass Stony(hy.Automaton):\n    x, v = hy.state(), hy.state()\n\n"
        "    @hy.mode\n    def flight(self, t, s):\n        return s.v, -9.81\n\n"
        "    impact = hy.contact(\n        flight,\n        gap=lambda self, t, s: s.x,\n"
        "        restitution=lambda self, t, s, u, draw: 0.3 + 0.5 * draw.uniform(),\n    )\n\n\n"
        "START, UNTIL = {'x': 1.0, 'v': 0.0}, (0.0, 5.0)\n"
    )
    found = CliRunner().invoke(app, ["run", str(path), "--json", "--seed", "3"])
    (point,) = json.loads(found.stdout)["zeno"]
    assert point["ratio"] is None
    assert point["t"] == pytest.approx(fallen(3, 0)[-1], rel=1e-12)


def test_the_generator_has_no_pattern():
    """Means, variances and correlations of 2^14 numbers, over lanes, jumps and calls; and one bit
    of what goes in changes half of what comes out. Bounds are five standard deviations, and six
    where there are thousands of shares; numbers that a bit below 14 makes come in pairs, so half
    of them count."""
    count = 2**14
    with jax.enable_x64(True):
        mix = jax.jit(lambda c, k: mixed(c, k))
        line = np.arange(count, dtype=float)
        for place in range(6):
            words = [line if i == place else np.zeros(count) for i in range(6)]
            out = np.array(mix(tuple(words[:4]), tuple(words[4:])))
            share = (out + 0.5) / 2**26
            assert np.all(np.abs(share.mean(axis=1) - 0.5) < 5 * (1 / 12 / count) ** 0.5)
            assert np.all(np.abs(share.var(axis=1) - 1 / 12) < 5 * (1 / 180 / count) ** 0.5)
            apart = [*share, *(row[1:] for row in share)]
            pairs = [(a, b) for i, a in enumerate(apart) for b in apart[:i]]
            least = [np.corrcoef(a[: count - 1], b[: count - 1])[0, 1] for a, b in pairs]
            assert np.abs(least).max() < 5 / count**0.5
            for bit in range(26):
                words[place] = (line.astype(int) ^ (1 << bit)).astype(float)
                other = np.array(mix(tuple(words[:4]), tuple(words[4:])))
                changed = out.astype(int) ^ other.astype(int)
                flipped = np.array([[(row >> b & 1).mean() for b in range(26)] for row in changed])
                assert np.abs(flipped - 0.5).max() < 6 * 0.5 / (count / 2) ** 0.5


def declared(**body):
    return type("Faulty", (hy.Automaton,), {"x": hy.state(), "__module__": __name__, **body})


def test_wrong_use_is_refused():
    mode = hy.mode(initial=True)(lambda self, t, s: 1.0)
    mode.name = "m"
    gap = lambda self, t, s: s.x  # noqa: E731
    edge = hy.edge(mode, to=mode, guard=gap)(lambda self, t, s, draw: s.replace(x=draw.uniform()))
    with pytest.raises(hy.DeclarationError, match="draws: a name in use here"):
        declared(m=mode, e=edge, draws=hy.discrete(0))
    law = hy.contact(mode, gap=gap, restitution=lambda self, t, s, draw: draw.uniform())
    with pytest.raises(hy.DeclarationError, match=r"\(self, t, s, u\) is due.*draw for random"):
        declared(m=mode, c=law)
    law = hy.contact(mode, gap=lambda self, t, s, draw: s.x, restitution=0.5)
    with pytest.raises(hy.DeclarationError, match="contact c, gap: takes"):
        declared(m=mode, c=law)
    odd = hy.edge(mode, to=mode, guard=lambda self, t, s, draw: s.x)(lambda self, t, s: s)
    with pytest.raises(hy.DeclarationError, match="edge e, guard: takes"):
        declared(m=mode, e=odd)
    for seed in (-1, 0.5, 2**26, "a", None):
        with pytest.raises(hy.OptionError, match="seed="):
            hy.simulate(Walk(), START, (0.0, 1.0), seed=seed)
    run = hy.simulate(Walk(), START, (0.0, 1.5), seed=7)
    with pytest.raises(hy.OptionError, match="the start has a stream; leave seed out"):
        hy.simulate(Walk(), run, (1.5, 2.0), seed=7)
    with pytest.raises(hy.OptionError, match="draws, stream: impact draws random numbers; let it"):
        hy.lyapunov(Rough(), {"x": 1.0, "v": 0.0}, (0.0, 5.0))
    plain = declared(m=mode)
    with pytest.raises(hy.OptionError, match="nothing of it takes draw"):
        hy.simulate(plain(), {"x": 0.0}, (0.0, 1.0), seed=7)
