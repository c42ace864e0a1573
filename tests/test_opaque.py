"""Flows that cannot be written as scalar code are called as compiled JAX functions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.errors import DeclarationError, JumpLoopError, OptionError, TraceError

from .contract.ways import spread

SOLVERS = {
    "DOP853": {"solver": "scipy"},
    "Radau": {"solver": "scipy", "method": "Radau"},
    "diffrax": {"solver": "diffrax"},
}


def drag(v, called=True):
    """An eighth of ``v |v|``, by halves as long as a count asks for them, or at once."""
    if not called:
        return 0.125 * v * jnp.abs(v)
    begin = v * jnp.abs(v), 0.0
    return jax.lax.while_loop(lambda c: c[1] < 3.0, lambda c: (0.5 * c[0], c[1] + 1.0), begin)[0]


def ball(called, floor=lambda t: 0.0, restitution=0.7):
    class Ball(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def flight(self, t, s):
            return s.v, -9.81 - drag(s.v, called)

        impact = hy.contact(flight, gap=lambda self, t, s: s.x - floor(t), restitution=restitution)

    return Ball()


def pair(make, start, until, **options):
    """The run with the called function, and the same in arithmetic."""
    return [hy.simulate(make(called), start, (0.0, until), **options) for called in (True, False)]


@pytest.mark.parametrize("name", SOLVERS)
def test_impacts_are_those_of_the_arithmetic(name):
    """Within a hundred times the tolerance: the steps are others."""
    called, written = pair(ball, [1.0, 0.0], 1.3, **SOLVERS[name])
    assert len(called.jumps) == len(written.jumps) == 2
    np.testing.assert_allclose(called.jumps.t, written.jumps.t, rtol=0, atol=1e-6)


def test_all_impacts_are_summed():
    """To rounding, with the error of the run's own tolerance; nothing is proved."""
    options = {"solver": "scipy", "rtol": 1e-12, "atol": 1e-12}
    called, written = pair(ball, [1.0, 0.0], 3.0, **options)
    ((one,), (other,)) = called.zeno, written.zeno
    assert abs(one.t - other.t) <= min(one.t_error + other.t_error, 1e-11)
    assert one.verdict == "estimated"
    assert called.arcs[-1].mode == "flight.rest(impact)"


def test_a_sum_at_loose_tolerances_says_how_wrong_it_is():
    """The error covers the distance to the limit that is known to 1e-11."""
    (found,) = hy.simulate(ball(True), [1.0, 0.0], (0.0, 3.0), solver="scipy").zeno
    exact = hy.simulate(ball(False), [1.0, 0.0], (0.0, 3.0), solver="taylor").zeno[0].t
    assert abs(found.t - exact) <= found.t_error <= 1e-6


@pytest.mark.parametrize(("at", "width"), spread([0.7, 3.1], [2e-2, 2e-3], of=2))
def test_the_bound_knows_of_a_force_that_the_method_passes_over(at, width):
    """The narrow ones, a two hundredth of the longest step, are passed over; the bound says so."""

    def pushed(called):
        def pulse(t):
            force = 0.3 / (width * np.sqrt(np.pi)) * jnp.exp(-(((t - at) / width) ** 2))
            once = lambda c: (c[0] + 1.0, force)  # noqa: E731
            begin = (0.0, 0.0 * t)
            return jax.lax.while_loop(lambda c: c[0] < 1.0, once, begin)[1] if called else force

        class Pushed(hy.Automaton):
            x = hy.state()
            v = hy.state()

            @hy.mode
            def flight(self, t, s):
                return s.v, -1.0 + pulse(t)

            impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)

        return Pushed()

    true = hy.simulate(pushed(False), [1.0, 0.0], (0.0, 9.0), solver="taylor").zeno[0]
    found = hy.simulate(pushed(True), [1.0, 0.0], (0.0, 9.0), max_step=0.4).zeno[0]
    error = abs(found.t - true.t)
    assert (error > 1e-3) == (width < 1e-2)  # else there is nothing to know of
    assert error <= found.t_error + true.t_error


def test_a_body_rests_on_a_table_and_is_thrown_off():
    """Accumulations and releases are those of the arithmetic, to 1e-7."""

    def table(called):
        return ball(called, lambda t: 0.1 * jnp.sin(12.0 * t), 0.2)

    called, written = pair(table, [0.3, 0.0], 2.0, solver="scipy")
    times = [[z.t for z in run.zeno] for run in (called, written)]
    thrown = [
        [jump.t for jump in run.jumps if jump.edge == "impact.release"] for run in (called, written)
    ]
    assert len(times[0]) == 4
    assert len(thrown[0]) >= 3
    np.testing.assert_allclose(*times, rtol=0, atol=1e-7)
    np.testing.assert_allclose(*thrown, rtol=0, atol=1e-7)


def test_a_state_slides_between_two_such_flows():
    """Where it begins, and where it is later, to 1e-7."""

    def slide(called):
        class Slide(hy.Automaton):
            x = hy.state()
            v = hy.state()

            @hy.mode(initial=True)
            def above(self, t, s):
                return s.v, jnp.sin(t) - 1.0 - drag(s.v, called)

            @hy.mode
            def below(self, t, s):
                return s.v, jnp.sin(t) + 1.0 - drag(s.v, called)

            line = hy.switching(above, below, surface=lambda self, t, s: s.x + s.v)

        return Slide()

    called, written = pair(slide, [1.0, 0.0], 2.0, solver="scipy")
    assert called.arcs[-1].mode == written.arcs[-1].mode == "slide(line)"
    np.testing.assert_allclose(called.jumps.t, written.jumps.t, rtol=0, atol=1e-7)
    np.testing.assert_allclose(called.arcs[-1].last, written.arcs[-1].last, rtol=0, atol=1e-7)


def test_taylor_names_the_primitive_and_a_remedy():
    """With model and mode."""
    said = r"Ball, mode flight: a loop .*test_opaque.py:\d+, the primitive 'while'.*'diffrax'"
    with pytest.raises(OptionError, match=said):
        hy.simulate(ball(True), [1.0, 0.0], (0.0, 1.0), solver="taylor")


def test_nothing_is_proved_of_it():
    """A certificate is refused with the primitive's name."""
    with pytest.raises(TraceError, match=r"Ball: nothing can be proved: .*primitive 'while'"):
        hy.certify(ball(True), {"x": (0.0, 1.0), "v": (-0.1, 0.1)})


def test_only_flows_may_call():
    """Gap and restitution are refused when the class is made: with the line, and a remedy."""
    said = r"a loop that ends .*test_opaque.py:\d+, .*'while'\) cannot .*fori_loop"
    with pytest.raises(DeclarationError, match=f"contact impact, gap: {said}"):
        ball(False, lambda t: 0.1 * drag(t))
    with pytest.raises(DeclarationError, match=f"contact impact, restitution: {said}"):
        ball(False, restitution=lambda self, t, s, u: 0.5 + 0.01 * drag(u))


def test_what_is_no_real_number_is_refused_with_its_line():
    """A Fourier transform, and a print, in a flow: when the class is made."""

    def made(force):
        class Made(hy.Automaton):
            x = hy.state()

            @hy.mode
            def flow(self, t, s):
                return force(s.x)

    with pytest.raises(DeclarationError, match=r"mode flow: a complex .*test_opaque.py:\d+"):
        made(lambda x: jnp.abs(jnp.fft.fft(jnp.stack([x, 1.0])))[1])
    with pytest.raises(DeclarationError, match=r"mode flow: a call of .*test_opaque.py:\d+"):
        made(lambda x: (jax.debug.print("{}", x), x)[1])


def test_impacts_that_cannot_be_summed_are_an_error():
    """A function of fifteen numbers: the run does not come to rest as if it had been summed."""

    class Ranked(hy.Automaton):
        x = hy.state()
        v = hy.state()
        z = hy.state(shape=(14,))

        @hy.mode
        def flight(self, t, s):
            return s.v, -9.81 - 0.01 * jnp.sort(s.z + s.x)[3], -s.z

        impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)

    start = [1.0, 0.0, np.linspace(0.0, 1.0, 14)]
    with pytest.raises(JumpLoopError, match=r"impact accumulate, and cannot be summed: .*'sort'"):
        hy.simulate(Ranked(), start, (0.0, 3.0), solver="scipy")


def test_a_force_that_jumps_at_the_contact_is_an_error():
    """Friction that turns round in each flight is no polynomial: its impacts have no sum."""

    class Rubbed(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def flight(self, t, s):
            force = jax.lax.while_loop(lambda f: f > 1.0, lambda f: 0.5 * f, jnp.sign(s.v) + 2.0)
            return s.v, -9.81 - force

        impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution=0.5)

    with pytest.raises(JumpLoopError, match=r"Rubbed, .* cannot be summed"):
        hy.simulate(Rubbed(), [1.0, 0.0], (0.0, 3.0), solver="scipy")


def test_lanes_have_no_other_impacts():
    """Compiled runs of many starts, to 1e-6 of one of them."""
    lanes = hy.ensemble(ball(True), {"x": [1.0, 1.1], "v": [0.0, 0.0]}, (0.0, 1.3))
    one = hy.simulate(ball(False), [1.1, 0.0], (0.0, 1.3), solver="taylor")
    np.testing.assert_allclose(lanes.x.values[1], one.arcs[-1].last[0], rtol=0, atol=1e-6)
