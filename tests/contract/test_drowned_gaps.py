"""Flights over a table that falls hardly faster than the body: their gaps drown in rounding."""

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy

WAYS = ["Kvaerno5", "DOP853", "taylor"]


class Falling(hy.Automaton):
    """A body on a table that swings so fast that for a moment it falls faster than the body."""

    x = hy.state()
    v = hy.state()
    amplitude: float = hy.parameter(1.0)

    @hy.mode
    def flight(self, t, s):
        return s.v, -1.0

    table = hy.contact(
        flight, gap=lambda self, t, s: s.x - self.amplitude * jnp.sin(t), restitution=0.5
    )


@pytest.mark.parametrize("excess", [5e-7, 1e-6, 2e-6, 3e-6])
def test_a_flight_lower_than_rounding_ends_on_the_table(way, excess):
    """It leaves the table by 1e-12 at most, and then in ever lower flights; at 2 it rests."""
    amplitude = 1.0 + excess
    result = way.run(Falling(amplitude=amplitude), {"x": 0.0, "v": amplitude}, (0.0, 2.0))
    assert result.mode == "flight.rest(table)"
    # Held by Newton's method to the rounding of the gap.
    assert float(result.final.x) == pytest.approx(amplitude * np.sin(2.0), rel=1e-14)
