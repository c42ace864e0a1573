"""What is kept of a run with signals: impulses, forces, outputs, pictures, files."""

import numpy as np
import pytest

import hybrid as hy

SOLVERS = ["taylor", "scipy", "diffrax"]


class Measured(hy.Automaton):
    """A bead of mass m on a road, and its height over that."""

    x = hy.state()
    v = hy.state()
    m = hy.parameter(2.0)
    road = hy.signal()

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.v, -10.0

    impact = hy.contact(
        flight,
        gap=lambda self, t, s: s.x - self.road(t),
        restitution=0.5,
        inverse_mass=lambda self, t, s: 1.0 / self.m,
    )

    @hy.output
    def height(self, t, s):
        return s.x - self.road(t)


ROAD = [0.0, 1.0, 3.0, 4.0], [0.0, 2.0, 2.0, 1.0]


@pytest.mark.parametrize("solver", SOLVERS)
def test_what_an_impact_gives_is_measured_on_the_road_as_it_is_there(solver):
    run = hy.simulate(Measured(road=ROAD), {"x": 1.0, "v": 2.0}, (0.0, 3.7), solver=solver)
    given = 2.0 * (run.jumps.after.v - run.jumps.before.v)
    struck = run.jumps.edge == "impact"
    assert given[0] > 10.0
    # to rounding of speeds up to 4, and of the road's slope in them
    np.testing.assert_allclose(run.jumps.impulse[struck], given[struck], atol=1e-13)


def test_an_impact_at_a_knot_gives_what_the_road_before_it_gives():
    """From rest on the rising road, released where it ends; and a start on it, where it begins."""
    model = Measured(road=([0.0, 1.0, 2.0, 4.0], [0.0, 0.0, 0.0, 8.0]))
    falls = hy.simulate(model, {"x": 5.0, "v": 0.0}, (0.0, 1.5), solver="taylor")
    assert falls.jumps.t[0] == 1.0
    assert falls.jumps.impulse[0] == pytest.approx(2.0 * 15.0, rel=1e-14)
    begins = hy.simulate(model, {"x": 0.0, "v": 1.0}, (2.0, 2.5), solver="taylor")
    assert begins.jumps.t[0] == 2.0
    assert begins.jumps.impulse[0] == pytest.approx(2.0 * 1.5 * 3.0, rel=1e-14)


def test_a_run_with_signals_is_saved(tmp_path):
    """States, the data, and with the model its outputs, forces and impulses; it goes on as well."""
    model = Measured(road=ROAD)
    run = hy.simulate(model, {"x": 1.0, "v": 2.0}, (0.0, 3.0), solver="taylor")
    run.save(tmp_path / "run.nc")
    alone = hy.load(tmp_path / "run.nc")
    assert alone.parameters["road"] == model.road
    assert alone(2.5).x == run(2.5).x
    again = hy.load(tmp_path / "run.nc", Measured)
    t = np.array([0.1, 2.5, 2.9])
    np.testing.assert_array_equal(again(t).height, run(t).height)
    np.testing.assert_array_equal(again.force("impact", t), run.force("impact", t))
    np.testing.assert_array_equal(again.jumps.impulse, run.jumps.impulse)
    more, other = (hy.simulate(model, r, (3.0, 3.7), solver="taylor") for r in (run, again))
    assert more.jumps.t.tolist() == other.jumps.t.tolist()
    np.testing.assert_array_equal(more.final, other.final)
    assert "road" not in alone.to_xarray().attrs


def test_a_file_is_not_read_with_a_model_of_another_signal(tmp_path):
    class Other(Measured):
        road = hy.signal(kind="previous")

    run = hy.simulate(Measured(road=ROAD), {"x": 1.0, "v": 2.0}, (0.0, 1.0), solver="taylor")
    run.save(tmp_path / "run.nc")
    with pytest.raises(hy.StoreError, match="the model given is Other"):
        hy.load(tmp_path / "run.nc", Other)


def test_the_picture_of_a_run_shows_the_road():
    run = hy.simulate(Measured(road=ROAD), {"x": 1.0, "v": 2.0}, (0.0, 3.7), solver="taylor")
    ax = run.plot(["x"], panels=("time",)).axes[0]
    drawn = next(line for line in ax.lines if line.get_label() == "obstacle")
    t, x = drawn.get_data()
    np.testing.assert_allclose(x, np.interp(t, *ROAD), atol=1e-14)
