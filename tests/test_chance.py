"""Random numbers in resets: the same ones for the same seed, lane, jump and call."""

import jax
import numpy as np
import pytest

import hybrid as hy
from hybrid.automaton.chance import KEY_STEPS, MULTIPLIERS, PHILOX_ROUNDS, mixed

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
    with pytest.raises(hy.OptionError, match="its resets draw: say from which streams"):
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
    law = hy.contact(mode, gap=gap, restitution=lambda self, t, s, u, draw: draw.uniform())
    with pytest.raises(hy.DeclarationError, match="restitution: draw is for resets as yet"):
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
    plain = declared(m=mode)
    with pytest.raises(hy.OptionError, match="no reset of it takes draw"):
        hy.simulate(plain(), {"x": 0.0}, (0.0, 1.0), seed=7)
