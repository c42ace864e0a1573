"""What a newcomer writes by mistake is refused in words of the model, never of JAX or numpy."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.solvers.base import METHOD_NAMES
from hybrid.solvers.diffrax_objects import DEGREES as DIFFRAX
from hybrid.solvers.scipy_backend import METHODS as SCIPY
from models.bouncing_ball import BouncingBall

START, SPAN = {"x": 1.0, "v": 0.0}, (0.0, 3.0)
VALUES = {"r": [0.5, 0.6]}


def ball(flow=lambda self, t, s: (s.v, -9.81), **more):
    """A class with this flow and these members besides."""
    body = {"x": hy.state(), "v": hy.state(), "fall": hy.mode(flow), **more}
    return type("Ball", (hy.Automaton,), body)


def refused(make, kind=hy.DeclarationError):
    """What is said."""
    with pytest.raises(kind) as caught:
        make()
    return " ".join(str(caught.value).split())


# -- a class ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("flow", "words"),
    [
        (lambda self, s, t: (s.v, 0.0), "takes (self, s, t) where (self, t, s) is due"),
        (lambda self, t, y: (y[1], 0.0), "a record is read by name, s.x or s['x']"),
        (lambda self, t, s: (t.v, 0.0), "the arguments are (self, t, s), in this order"),
        (lambda self, t, s: (math.sin(s.x), 0.0), "use that of jax.numpy"),
        (lambda self, t, s: (np.sin(s.x), 0.0), "use the one of jax.numpy"),
        (lambda self, t, s: (max(s.x, 0.0), 0.0), "jnp.maximum for `max`"),
        (lambda self, t, s: (sum(s.x for _ in range(self.n)), 0.0), "fixed with the class (N = 3)"),
        (lambda self, t, s: ("a", 0.0), "it returns something that is no number"),
        (lambda self, t, s: setattr(self, "n", 1), "declare what changes as a state or hy.disc"),
    ],
)
def test_a_flow_is_refused_in_the_authors_words(flow, words):
    """And names the mode."""
    said = refused(lambda: ball(flow, n=hy.parameter(2.0)))
    assert "Ball has a fault in its declaration: - mode fall: " in said
    assert words in said


def test_a_method_without_its_decorator_is_named():
    """``@hy.mode`` left out, and ``@hy.edge`` without its arguments."""

    def slide(self, t, s):
        return s.v, 0.0

    edge = hy.edge("fall", to=slide, guard=lambda self, t, s: s.x)
    assert "edge over: to=slide is no mode: write @hy.mode over it" in refused(
        lambda: ball(over=edge, slide=slide)
    )

    def bare(self, t, s):
        return s

    said = refused(lambda: ball(bare=hy.edge(bare)))
    assert said.endswith(
        "fault in its declaration: - edge bare: write @hy.edge(source, to=mode, guard=...) over it"
    )


def test_a_parameter_in_place_of_its_name_is_named():
    """``restitution=r`` for ``restitution="r"``."""
    r = hy.parameter(0.5)
    wall = hy.contact("fall", gap=lambda self, t, s: s.x, restitution=r)
    said = refused(lambda: ball(r=r, wall=wall))
    assert 'contact wall: restitution is the parameter itself; give its name, "r"' in said


def test_a_start_is_no_unit():
    """``hy.state(1.0)``."""
    assert "h: unit=1.0; give text. A state's value at the start is for" in refused(
        lambda: ball(lambda self, t, s: (s.v, 0.0, 0.0), h=hy.state(1.0))
    )


def test_an_attribute_of_the_class_is_no_parameter():
    """It has the remedy, with its value."""
    said = refused(lambda: ball(k=3.0)(k=4.0), hy.ParameterError)
    assert said == (
        "Ball.k is an attribute of the class, not a parameter: declare it as k = hy.parameter(3.0)"
    )


def test_a_model_does_not_change():
    """And says what to do."""
    with pytest.raises(AttributeError, match=r"attrs\.evolve\(model, r=\.\.\.\)"):
        BouncingBall().r = 0.5


# -- a run --------------------------------------------------------------------------------


def test_a_method_given_as_a_solver_says_whose_it_is():
    """And the other way round."""
    run = lambda **o: lambda: hy.simulate(BouncingBall(), START, SPAN, **o)  # noqa: E731
    assert refused(run(solver="RK45"), hy.OptionError).endswith(
        "RK45 is a method: solver='scipy', method='RK45'"
    )
    assert refused(run(method="Tsit5"), hy.OptionError).endswith("one of solver='diffrax'")
    assert refused(run(method="taylor"), hy.OptionError).endswith("write solver='taylor'")
    assert {name: tuple(own) for name, own in METHOD_NAMES.items()} == {
        "scipy": tuple(SCIPY),
        "diffrax": tuple(DIFFRAX),
    }


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: hy.simulate(BouncingBall(), START, np.linspace(0, 3, 99)), "go to save="),
        (lambda: hy.simulate(BouncingBall(), START, SPAN, save=True), "save=True: 'dense'"),
        (lambda: hy.simulate(BouncingBall(), START, SPAN, save=100), "save=100: increasing times"),
        (lambda: hy.simulate(BouncingBall(g=[9.0, 8.0]), START, SPAN), "BouncingBall.g has shape"),
        (lambda: hy.simulate(BouncingBall(), {"x": -1.0, "v": 0.0}, SPAN), "where the gap is pos"),
        (lambda: hy.ensemble(BouncingBall(), START, SPAN, {"r": ["a", "b"]}), "parameters r=['a'"),
        (lambda: hy.ensemble(BouncingBall(), START, SPAN, {"r": []}), "no value, so no lane"),
        (lambda: hy.ensemble(BouncingBall(), START, SPAN, [0.5]), "values by name"),
        (lambda: hy.ensemble(BouncingBall(), START, SPAN, {"r": [2.0]}), "r = 2.0: must lie in"),
        (lambda: hy.ensemble(BouncingBall(), START, SPAN, progress=3), "progress=3: a function"),
        (lambda: hy.ensemble(BouncingBall(), START, SPAN, certify="yes"), "certify='yes': True"),
        (
            lambda: hy.ensemble(BouncingBall(), START, SPAN, VALUES, measure=lambda table: 1.0),
            "it gives an array of shape (), and (2,) is due",
        ),
        (lambda: hy.return_map(BouncingBall(), "impact")({"x": 1.0}), "no value for v"),
        (lambda: hy.return_map(BouncingBall(), "impact")(START, "a"), "t='a': a finite time"),
        (lambda: hy.return_map(BouncingBall(), lambda s: s.x), "a surface is a function (self"),
        (lambda: hy.periodic_orbit(BouncingBall(), START, section="floor"), "section='floor'"),
        (lambda: hy.periodic_orbit(BouncingBall(), START, period="a"), "period='a': a finite"),
        (lambda: hy.periodic_orbit(BouncingBall(), START, settle=-1), "settle=-1: a whole"),
        (lambda: hy.periodic_orbit(BouncingBall(), START, t=SPAN), "t=(0.0, 3.0): a finite"),
        (lambda: hy.periodic_orbit(BouncingBall(), START, mode="rest"), "mode='rest'; there are"),
        (lambda: hy.periodic_orbit(BouncingBall(), START, solver="x"), "solver='x': there are"),
        (lambda: hy.periodic_orbit(BouncingBall(), START, tolerance=1), "tolerance= is no option"),
        (lambda: hy.lyapunov(BouncingBall(), START, (3.0, 0.0)), "the first before the last"),
        (lambda: hy.lyapunov(BouncingBall(), START, SPAN, rtoll=1e-9), "rtoll= is no option of hy"),
        (lambda: hy.return_map(BouncingBall(), "impact", tmax=9.0), "tmax= is no option of hy.sim"),
        (
            lambda: hy.sweep(BouncingBall(), VALUES, START, SPAN, folow=True),
            "BouncingBall: folow= is no option of hy.sweep; is follow= meant?",
        ),
        (
            lambda: hy.bifurcation(BouncingBall(), VALUES, START, SPAN, section="impact", kep=3),
            "kep=",
        ),
    ],
)
def test_a_mistake_is_refused_with_its_value(make, words):
    """On each way in, before anything runs."""
    kinds = hy.OptionError, hy.StartError, hy.ParameterError
    assert words in refused(make, kinds)


@pytest.mark.parametrize(
    ("options", "start", "words"),
    [
        ({"t": (3.0, 0.0)}, START, "the first before the last"),
        ({"max_jumps": -1}, START, "max_jumps=-1: a whole number, 0 or more"),
        ({"outputs": "zeno"}, START, "outputs='zeno': a tuple of some of"),
        ({"zeno": "raise"}, START, "for 'truncate' and 'raise' use hy.simulate"),
        ({}, {"x": 1.0}, "no value for v"),
        ({}, {"x": "a", "v": 0.0}, "start x = 'a' is no number"),
    ],
)
def test_a_function_refuses_as_a_run_does(options, start, words):
    """With the same sentences."""
    given = {"t": SPAN, "max_jumps": 4, **options}
    with jax.enable_x64(True):
        call = lambda: hy.as_function(BouncingBall(), **given)(BouncingBall(), start)  # noqa: E731
        assert words in refused(call, (hy.OptionError, hy.StartError))


def test_a_state_that_is_0_needs_no_absolute_tolerance():
    """SciPy divides 0 by 0 there, and chooses steps that are no number, for ever."""

    class Pushed(hy.Automaton):
        x = hy.state()
        v = hy.state()

        @hy.mode
        def swing(self, t, s):
            return s.v, 1.0 - s.x

    for method in ("DOP853", "Radau", "BDF"):
        run = hy.simulate(Pushed(), [0.0, 0.0], (0.0, 1.0), atol=0, rtol=1e-8, method=method)
        assert abs(run.final.x - (1.0 - math.cos(1.0))) < 1e-6  # hundreds of steps of 1e-8


# -- what comes back ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def run():
    """A dropped ball."""
    return hy.simulate(BouncingBall(), START, SPAN)


def test_a_run_says_where_its_states_are(run):
    """``run.x``, ``run.t``, ``run("a")``, ``run(1.0)[0]`` and ``run.jumps["t"]``."""
    with pytest.raises(AttributeError, match=r"run\(t\)\.x at a time"):
        run.x  # noqa: B018
    with pytest.raises(AttributeError, match=r"run\.jumps\.t the times of the jumps"):
        run.t  # noqa: B018
    with pytest.raises(hy.OptionError, match=r"t='a': a time, or an array of times"):
        run("a")
    with pytest.raises(TypeError, match=r"\[0\]: a record is read by name, s\.x"):
        run(1.0)[0]
    with pytest.raises(hy.OptionError, match=r"columns are attributes, jumps\.t"):
        run.jumps["t"]
    with pytest.raises(IndexError, match=r"accumulation 1: the run has 1 accumulation$"):
        run.zeno[1]
    with pytest.raises(IndexError, match="jump 1000: the run has 103 jumps"):
        run.jumps[1000]
    assert run.jumps[-1].j == len(run.jumps) - 1


def test_a_picture_that_cannot_be_written_is_refused_before_it_is_drawn(run, tmp_path):
    """By its name, its folder or its size."""
    for path, options, words in (
        ("run.xyz", {}, r"end the name in \.png"),
        ("none/run.png", {}, "no such folder"),
        ("run.png", {"size": 3}, r"size=3: \(width, height\), in inches"),
    ):
        with pytest.raises(hy.OptionError, match=words):
            run.plot(tmp_path / path, **options)
    assert not list(tmp_path.iterdir())


def test_a_run_is_not_saved_under_the_name_of_another_format(run, tmp_path):
    """A table of jumps is something else; a folder that is not there is named."""
    with pytest.raises(hy.OptionError, match=r"end the name in \.nc"):
        run.save(tmp_path / "run.csv")
    with pytest.raises(hy.StoreError, match="no such folder"):
        run.save(tmp_path / "none" / "run.nc")


def test_a_state_named_as_a_column_is_refused_by_the_table_only():
    """It took the place of the column: ``t`` was the state's value."""

    class Clock(hy.Automaton):
        t = hy.state()
        time = hy.state()

        @hy.mode
        def go(self, t, s):
            return 2.0, 1.0

    run = hy.simulate(Clock(), [0.0, 0.0], (0.0, 1.0))
    assert run.final.t == pytest.approx(2.0, abs=1e-12)  # a straight line, to rounding
    with pytest.raises(hy.OptionError, match="Clock: 't' is a state or a parameter of it, and a"):
        hy.ensemble(Clock(), [0.0, 0.0], (0.0, 1.0))
    with pytest.raises(hy.OptionError, match="Clock: 'time' is a state or an output of it, and"):
        run.to_xarray()


def test_a_functions_final_state_reads_as_that_of_a_run(run):
    """By attribute, by name and unpacked; and it is a pytree."""
    with jax.enable_x64(True):
        fall = hy.as_function(BouncingBall(), t=SPAN, max_jumps=4)
        out = jax.jit(fall)(BouncingBall(), START)
        assert (out.final.x, out.final["v"], *out.final) == (0.0, 0.0, 0.0, 0.0)
        apart = out.jumps.after.v[:2] - run.jumps.after.v[:2]
        assert jnp.abs(apart).max() < 1e-8  # the tolerance of the run


def test_a_function_takes_the_longest_step_as_a_run_does():
    """A brief gust that steps pass over."""

    class Door(hy.Automaton):
        angle = hy.state()

        @hy.mode
        def swings(self, t, s):
            return jnp.exp(-(((t - 5.0) / 0.01) ** 2))

    options = {"solver": "scipy", "max_step": 0.01}
    with jax.enable_x64(True):
        function = hy.as_function(Door(), t=(0.0, 10.0), max_jumps=0, **options)
        found = float(function(Door(), [0.0]).final.angle)
    assert found == hy.simulate(Door(), [0.0], (0.0, 10.0), **options).final.angle
    assert abs(found - 0.01 * math.sqrt(math.pi)) < 1e-9  # a thousand steps of 1e-8 of it
