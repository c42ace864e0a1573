"""Whether a reset turns the motion round decides if its guard bounds the mode, for each value of a
parameter anew."""

import numpy as np
import pytest

import hybrid as hy


class Turned(hy.Automaton):
    """A body that falls onto a surface: by default it is turned round there."""

    x = hy.state()
    v = hy.state()

    share: float = hy.parameter(-0.5)

    @hy.mode(initial=True)
    def falling(self, t, s):
        return s.v, 0.0 * s.x - 1.0

    @hy.edge(falling, to=falling, guard=lambda self, t, s: s.x)
    def hit(self, t, s):
        return s.replace(v=self.share * s.v)


class Slowed(Turned):
    """The same, which by default is slowed and goes on through."""

    share: float = hy.parameter(0.5)


MODELS = pytest.mark.parametrize("model", [Turned, Slowed], ids=["turned", "slowed"])
BELOW = {"x": -1.0, "v": 0.0}


@MODELS
@pytest.mark.parametrize("solver", ["taylor", "scipy"])
def test_a_start_below_is_judged_by_the_values_of_the_run(model, solver):
    """Where the guard bounds the mode it is outside, whatever the defaults say; else it is not."""
    with pytest.raises(hy.StartError, match="outside"):
        hy.simulate(model(share=-0.5), BELOW, (0.0, 1.0), solver=solver)
    run = hy.simulate(model(share=0.5), BELOW, (0.0, 1.0), solver=solver)
    assert run.final.x == pytest.approx(-1.5, rel=1e-8)  # the tolerance of the steps


@MODELS
def test_lanes_are_judged_by_their_own_values(model):
    """Lanes that are turned round stand beside lanes that go through, as their runs do."""
    shares, start, t = np.array([-0.5, 0.5, -0.25, 0.25]), {"x": 1.0, "v": 0.0}, (0.0, 2.0)
    lanes = hy.ensemble(model(), start, t, parameters={"share": shares}, solver="taylor")
    runs = [hy.simulate(model(share=s), start, t, solver="taylor") for s in shares.tolist()]
    assert lanes["x"].values.tolist() == [run.final.x for run in runs]
    below = hy.ensemble(model(), BELOW, (0.0, 1.0), parameters={"share": shares}, solver="taylor")
    assert below.status.values.tolist() == ["outside", "reached_end"] * 2
