"""What a model's author calls an output is there by name, and is what the method says."""

import pickle
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from tests.contract.ways import SOLVERS

START, UNTIL = {"x": 1.0, "v": 0.0}, (0.0, 1.5)


class Ball(hy.Automaton):
    """A ball with its energy, and with what it would do next."""

    x = hy.state(unit="m")
    v = hy.state(unit="m/s")
    g: float = hy.parameter(10.0)
    m: float = hy.parameter(2.0)
    r: float = hy.parameter(0.5)

    @hy.mode
    def flight(self, t, s):
        return s.v, -self.g

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")

    @hy.output(unit="J", doc="energy")
    def energy(self, t, s):
        return self.m * (self.g * s.x + 0.5 * s.v**2)

    @hy.output
    def ahead(self, t, s):
        """Where it were, and when, a second later without the floor."""
        return jnp.array([s.x + s.v - 0.5 * self.g, t + 1.0])


class Late(hy.Automaton):
    """A flow that looks back, with an output that does not."""

    x = hy.state()

    @hy.mode
    def flow(self, t, s, past):
        return -past(1.0).x

    @hy.output
    def square(self, t, s):
        return s.x**2


@cache
def flown(name="taylor"):
    return hy.simulate(Ball(), START, UNTIL, **SOLVERS[name])


def test_an_output_is_the_methods_own_value(solver):
    """At a time and at many, by every solver: the formula on the states that the run gives."""
    run = hy.simulate(Ball(), START, UNTIL, **solver)
    times = np.linspace(*UNTIL, 7).reshape(7, 1) * np.ones((1, 3))
    seen = run(times)
    exact = 2.0 * (10.0 * seen.x + 0.5 * seen.v**2)
    np.testing.assert_allclose(seen.energy, exact, rtol=4e-16)  # two roundings of another order
    assert (seen.energy.shape, seen.ahead.shape) == ((7, 3), (7, 3, 2))
    assert seen.energy.dtype == np.float64
    np.testing.assert_array_equal(seen.ahead[..., 1], times + 1.0)
    assert run(0.0).energy == 20.0
    assert run(0.0).energy.shape == ()


def test_energy_falls_by_the_square_of_the_restitution_at_an_impact():
    """20 J are 5 J behind the first; each side of a jump, and the final state, has its own."""
    run = flown()
    assert run.jumps.before.energy[0] == pytest.approx(20.0, rel=1e-14)  # steps to rounding
    np.testing.assert_allclose(run.jumps.after.energy, run.jumps.before.energy / 4, rtol=1e-12)
    assert run.jumps[0].after.energy == run.jumps.after.energy[0]
    t = run.jumps[0].t
    sides = run(t, side="left").energy, run(t, 0).energy, run(t).energy
    assert sides == pytest.approx((20.0, 20.0, 5.0))
    assert run.final.energy == run(run.t1).energy


def test_a_record_unpacks_to_its_states():
    """An output is none of what a record iterates over, counts, or is compared by."""
    seen = flown()(0.1)
    x, v = seen
    assert (x, v) == (seen.x, seen.v)
    assert (len(seen), seen.keys()) == (2, ("x", "v"))
    assert seen["energy"] == seen.energy
    assert seen == {"x": x, "v": v}
    with pytest.raises(AttributeError, match=r"no state named 'speed'.*outputs: energy, ahead"):
        _ = seen.speed
    with pytest.raises(KeyError, match="speed"):
        _ = seen["speed"]


def test_no_time_gives_no_value():
    """An output at no times has its own shape behind them."""
    assert flown()(np.empty(0)).ahead.shape == (0, 2)


def test_outputs_are_columns_of_a_dataset():
    """``to_xarray`` has them with unit and words, at its own times and at those given."""
    run = flown()
    table = run.to_xarray([0.0, 0.2])
    np.testing.assert_array_equal(table.energy, run(np.array([0.0, 0.2])).energy)
    assert table.energy.attrs == {"units": "J", "long_name": "energy"}
    assert table.ahead.dims == ("time", "ahead_0")
    assert table.ahead.attrs["long_name"].startswith("Where it were")
    assert run.to_xarray().energy.shape == run.to_xarray().x.shape


def test_states_asked_for_have_outputs():
    """With ``save=times`` an output is worked out from the states kept."""
    times = np.linspace(*UNTIL, 5)
    run = hy.simulate(Ball(), START, UNTIL, save=times)
    np.testing.assert_array_equal(run(times).energy, run.to_xarray().energy)


def test_one_element_of_an_output_is_drawn():
    """By its name, as one of a state is; one that is not there is refused with what there is."""
    pytest.importorskip("matplotlib")
    axes = flown().plot(["ahead[1]"]).axes
    assert any("ahead[1]" in axis.get_ylabel() for axis in axes)
    assert not any("ahead[0]" in axis.get_ylabel() for axis in axes)
    with pytest.raises(hy.OptionError, match=r"no state or output 'ahead\[2\]'"):
        flown().plot(["ahead[2]"])


def test_pictures_have_outputs(tmp_path):
    """``run.plot`` draws states and outputs by name; a path alone is a path."""
    run = flown()
    axes = run.plot(["x", "energy"]).axes
    assert [each.get_ylabel() for each in axes] == ["x [m]", "energy [J]"]
    assert axes[1].lines[0].get_ydata()[0] == 20.0
    assert len(run.plot(["ahead"]).axes) == 2
    run.plot(["energy"], tmp_path / "energy.png")
    run.plot(str(tmp_path / "run.png"))
    assert {path.name for path in tmp_path.iterdir()} == {"energy.png", "run.png"}
    with pytest.raises(hy.OptionError, match="no state or output 'heat'; there are: x, v, energy"):
        run.plot(["heat"])


def test_a_lanes_output_is_that_of_its_end():
    """``measure`` is a column over the lanes: each with its own parameters and last time."""
    m, until = np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.6, 3.0])
    lanes = hy.ensemble(Ball(), START, (0.0, until), {"m": m}, measure=["energy", "x", "ahead"])
    exact = m * (10.0 * lanes.x + 0.5 * lanes.v**2)
    np.testing.assert_allclose(lanes.energy, exact, rtol=4e-16)  # another order of the products
    np.testing.assert_array_equal(lanes.ahead[:, 1], lanes.t + 1.0)
    assert lanes.ahead.dims == ("lane", "ahead_0")
    for given, said in ((["heat"], "output or measure 'heat'"), ("energy", "names in a list")):
        with pytest.raises(hy.OptionError, match=said):
            hy.ensemble(Ball(), START, UNTIL, measure=given)


def test_a_column_keeps_its_name():
    """An output named as a column of the table is refused where it is measured."""

    class Named(Ball):
        @hy.output
        def steps(self, t, s):
            return s.x

    with pytest.raises(hy.OptionError, match="Named: output 'steps': the table has another column"):
        hy.ensemble(Named(), START, UNTIL, measure=["steps"])


def test_the_method_itself_goes_into_a_function():
    """A derivative through ``as_function`` calls the method on the state that it gives."""
    after = hy.as_function(Ball(), t=(0.0, 0.3), max_jumps=4)
    with jax.enable_x64(True):
        slope = jax.grad(lambda m: m.energy(0.3, after(m, START).final))(Ball())
    assert slope.g == pytest.approx(2.0, rel=1e-12)  # m g x(0): no impact before 0.3


def test_delays_leave_outputs_alone():
    """A model with delays has outputs; one that looks back itself is refused."""
    run = hy.simulate(Late(), [1.0], (0.0, 1.0))
    np.testing.assert_allclose(run(np.array([0.5])).square, 0.25, rtol=1e-7)  # x = 1 - t, to 1e-8
    with pytest.raises(hy.DeclarationError, match="output late: takes past"):

        class _Bad(Late):
            @hy.output
            def late(self, t, s, past):
                return past(1.0).x


def test_a_run_is_pickled_with_its_outputs():
    """Runs, their jumps and their records, asked for before or not."""
    run = flown()
    for each in (run, run.jumps, run(0.1)):  # the record is pickled before it is asked
        again = pickle.loads(pickle.dumps(each))
        np.testing.assert_array_equal(_energy(again), _energy(each))


def _energy(found):
    if isinstance(found, hy.Trajectory):
        return found(0.1).energy
    return getattr(found, "before", found).energy


def test_a_file_needs_the_model_for_outputs(tmp_path):
    """They are worked out again; another model, or none, is told."""
    run, path = flown(), tmp_path / "run.nc"
    run.save(path)
    again = hy.load(path, Ball)
    np.testing.assert_array_equal(again.to_xarray().energy, run.to_xarray().energy)
    assert hy.load(path, Ball()).jumps.before.energy[0] == run.jumps.before.energy[0]
    bare = hy.load(path)
    assert bare(0.1) == run(0.1)
    assert "energy" not in bare.to_xarray()
    with pytest.raises(hy.OptionError, match=r"Ball: energy is .* hy.load\(path, Ball\)"):
        _ = bare(0.1).energy
    with pytest.raises(hy.StoreError, match="a run of Ball with states x, v"):
        hy.load(path, Late)
    with pytest.raises(hy.StoreError, match="give a subclass"):
        hy.load(path, "Ball")


def _hides():
    class Hides(hy.Automaton):
        x = hy.state()

        @hy.mode
        def flow(self, t, s):
            return (1.0,)

        @hy.output
        def x(self, t, s):  # noqa: F811
            return s.x


def _hides_inherited():
    class Below(Ball):
        @hy.output(unit="m")
        def v(self, t, s):
            return s.x


def _becomes_a_state():
    class Below(Ball):
        energy = hy.state()


def _keys():
    class Below(Ball):
        @hy.output
        def keys(self, t, s):
            return s.x


def _arguments():
    class Below(Ball):
        @hy.output
        def height(self, s):
            return s.x


def _fails():
    class Below(Ball):
        @hy.output
        def height(self, t, s):
            return s.height


FAULTS = {
    _hides: "output x: x is a state; give the output another name",
    _hides_inherited: "output v: v is a state",
    _becomes_a_state: "output energy: energy is a state",
    _keys: "keys: a name in use here",
    _arguments: r"output height: takes \(self, s\) where \(self, t, s\) is due",
    _fails: "output height: AttributeError: no state named 'height'",
}


@pytest.mark.parametrize("declare", FAULTS, ids=lambda each: each.__name__.strip("_"))
def test_wrong_outputs_are_faults_of_the_class(declare):
    """One sentence when the class is made."""
    with pytest.raises(hy.DeclarationError, match=FAULTS[declare]):
        declare()
