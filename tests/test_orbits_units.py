"""Periodic orbits: units, offsets, sections of a switching, and orbits that do not exist."""

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy

#: Period of van der Pol's oscillator for mu = 1, from the literature.
VAN_DER_POL = 6.6632868593231301897


class Slow(hy.Automaton):
    """Van der Pol's oscillator in any unit of time, about any point."""

    x = hy.state()
    v = hy.state()
    unit: float = hy.parameter(1.0)
    at: float = hy.parameter(0.0)

    @hy.mode
    def flow(self, t, s):
        x = s.x - self.at
        return s.v / self.unit, ((1 - x**2) * s.v - x) / self.unit


@pytest.mark.parametrize("unit", [1e-9, 1e-6, 1e-3, 30.0])
def test_the_unit_of_time_does_not_matter(unit):
    """As long as a turn is shorter than ``t_max``."""
    orbit = hy.periodic_orbit(Slow(unit=unit), {"x": 2.0, "v": 0.1})
    assert orbit.period == pytest.approx(VAN_DER_POL * unit, rel=1e-12)


def test_an_orbit_far_from_zero():
    """1e5 amplitudes away: its numbers have five digits less."""
    orbit = hy.periodic_orbit(Slow(at=1e5), {"x": 1e5 + 2.0, "v": 0.1})
    assert orbit.period == pytest.approx(VAN_DER_POL, rel=1e-7)


class Band(hy.Automaton):
    """A relay that keeps a temperature in a band."""

    T = hy.state()
    half: float = hy.parameter(1e-6)
    at: float = hy.parameter(0.0)

    @hy.mode(initial=True)
    def up(self, t, s):
        return (1.0,)

    @hy.mode
    def down(self, t, s):
        return (-1.0,)

    @hy.edge(up, to=down, guard=lambda self, t, s: self.at + self.half - s.T)
    def off(self, t, s):
        return s

    @hy.edge(down, to=up, guard=lambda self, t, s: s.T - self.at + self.half)
    def on(self, t, s):
        return s


@pytest.mark.parametrize("section", [None, "off"])
@pytest.mark.parametrize(("half", "at"), [(1e-6, 0.0), (1e-3, 300.0), (1e-4, 300.0), (1e-5, 300.0)])
def test_a_narrow_band_about_a_large_number(half, at, section):
    """Up and down through it, four times its half width; 300 is known to 6e-14 only."""
    orbit = hy.periodic_orbit(Band(half=half, at=at), [at], section=section)
    assert orbit.period == pytest.approx(4 * half, abs=16 * np.spacing(at) + 1e-11 * half)
    assert orbit.jumps == 2


class Damped(hy.Automaton):
    """An oscillator that loses, or gains, very little."""

    x = hy.state()
    v = hy.state()
    d: float = hy.parameter(0.0)

    @hy.mode
    def flow(self, t, s):
        return s.v, -s.x - self.d * s.v


@pytest.mark.parametrize("d", [3e-12, 1e-11, -1e-11, 1e-10, 1e-9])
def test_a_spiral_is_no_orbit(d):
    """Its amplitude changes by ``pi d`` a turn: less than ``tol``, and no orbit all the same."""
    with pytest.raises(hy.OrbitError, match="no periodic orbit"):
        hy.periodic_orbit(Damped(d=d), {"x": 1.0, "v": 0.0})


def test_a_centre_is_neutral_and_says_what_it_cannot_exclude():
    """Every amplitude closes, to rounding; a drift below that is not told from none."""
    orbit = hy.periodic_orbit(Damped(), {"x": 1.0, "v": 0.0})
    assert orbit.period == pytest.approx(2 * np.pi, rel=1e-12)
    assert not orbit.stable
    assert "not distinguishable from a motion that drifts by" in str(orbit)


class Belt(hy.Automaton):
    """Stick and slip on a belt, with friction that falls with the speed of slip."""

    x = hy.state()
    v = hy.state()
    belt: float = hy.parameter(0.2)

    @hy.mode(initial=True)
    def fast(self, t, s):
        return s.v, -s.x - 1.0 / (1.0 + 3.0 * (s.v - self.belt))

    @hy.mode
    def slow(self, t, s):
        return s.v, -s.x + 1.0 / (1.0 - 3.0 * (s.v - self.belt))

    grip = hy.switching(fast, slow, surface=lambda self, t, s: s.v - self.belt)


@pytest.mark.parametrize("section", ["grip", "grip.negative", None])
def test_the_jumps_of_a_switching_are_sections(section):
    """From a guess that sticks at once: no start lies on the section, none is an equilibrium."""
    orbit = hy.periodic_orbit(Belt(), {"x": 0.9, "v": 0.2}, section=section, t_max=50.0)
    named = hy.periodic_orbit(Belt(), {"x": 0.9, "v": 0.2}, mode="slide(grip)", t_max=50.0)
    assert orbit.period == pytest.approx(named.period, rel=1e-10)
    assert {stick.mode for stick in orbit.sticks} == {"slide(grip)"}
    assert sorted(np.abs(orbit.multipliers)) == pytest.approx([0.0, 1.0], abs=1e-9)


class Wheel(hy.Automaton):
    """A rimless wheel walks down a slope."""

    th = hy.state()
    w = hy.state()
    slope: float = hy.parameter(0.08)
    half: float = hy.parameter(0.4)

    @hy.mode
    def stance(self, t, s):
        return s.w, jnp.sin(s.th)

    @hy.edge(stance, to=stance, guard=lambda self, t, s: self.slope + self.half - s.th)
    def strike(self, t, s):
        return s.replace(th=self.slope - self.half, w=jnp.cos(2 * self.half) * s.w)


@pytest.mark.parametrize("section", [None, "strike"])
def test_a_wheel_walks(section):
    """A step loses ``1 - cos^2`` of the energy: the other multiplier is ``cos(2 half)^2``."""
    orbit = hy.periodic_orbit(Wheel(), {"th": 0.0, "w": 0.4}, section=section)
    assert orbit.jumps == 1
    assert orbit.multipliers[1].real == pytest.approx(np.cos(0.8) ** 2, rel=1e-9)


def test_a_reason_is_given_once():
    """Where the guess and what it leads to fail in the same way."""
    with pytest.raises(hy.OrbitError, match="does not return") as raised:
        hy.periodic_orbit(Slow(unit=1e3), {"x": 2.0, "v": 0.1}, t_max=100.0)
    assert str(raised.value).count("does not return") == 1
