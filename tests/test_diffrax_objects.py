"""Diffrax's solvers and step size controllers as objects."""

import diffrax
import pytest

import hybrid as hy
from hybrid.solvers import diffrax_objects
from models.hard_spring import HardSpring

#: Example 1's accumulation, from 40 digits.
T_INF = 1.32961738383844857732

CONSTANT = diffrax.ConstantStepSize()


def run(**options):
    return hy.simulate(HardSpring(), [2.1, 0.0], (0.0, 5.0), solver="diffrax", **options)


@pytest.mark.parametrize(
    "method", [diffrax.Tsit5(), diffrax.Dopri8(), diffrax.Kvaerno5(), diffrax.Sil3]
)
def test_a_method_may_be_an_object(method):
    """Its steps, our events: the accumulation is told within its error."""
    if method is diffrax.Sil3:
        with pytest.raises(hy.OptionError, match=r"Sil3.*ODETerm"):
            run(method=method())
        return
    found = run(method=method, rtol=1e-9, atol=1e-11)
    (point,) = found.zeno
    assert abs(point.t - T_INF) <= point.t_error < 1e-7
    assert found.options["method"] == type(method).__name__
    assert found.arcs[-1].mode == "flight.rest(impact)"


def test_a_controller_chooses_the_steps():
    """Ten times the tolerances, fewer steps; its name is kept."""
    loose, tight = (
        run(method="Tsit5", controller=diffrax.PIDController(rtol=rtol, atol=1e-2 * rtol))
        for rtol in (1e-4, 1e-10)
    )
    assert loose.stats.steps < tight.stats.steps
    assert abs(tight.zeno[0].t - T_INF) < 1e-9
    assert tight.options["controller"] == "PIDController"


def test_steps_of_one_length():
    """Heun's method is of order two: half the step, a quarter of the error."""
    errors = [
        abs(run(method=diffrax.Heun(), controller=CONSTANT, first_step=h).zeno[0].t - T_INF)
        for h in (4e-3, 2e-3, 1e-3)
    ]
    assert errors[1] < 0.4 * errors[0]
    assert errors[2] < 0.4 * errors[1]


def test_what_cannot_be_used_is_refused():
    """The error names the method or the option."""
    with pytest.raises(hy.OptionError, match=r"Euler.*error estimate"):
        run(method=diffrax.Euler())
    with pytest.raises(hy.OptionError, match="controller"):
        run(method="Tsit5", controller=3)
    with pytest.raises(hy.OptionError, match=r"scipy.*controller"):
        hy.simulate(HardSpring(), [2.1, 0.0], (0.0, 5.0), controller=CONSTANT)
    with pytest.raises(hy.OptionError, match="series"):
        run(method="Taylor", controller=CONSTANT)


def test_objects_with_the_same_numbers_are_one():
    """So the second run is not compiled."""
    one, other = (diffrax_objects.solver_of(diffrax.Bosh3(), 1e-8, 1e-10) for _ in range(2))
    assert one.key == other.key
    tight = diffrax_objects.solver_of(diffrax.Kvaerno5(), 1e-9, 1e-11)
    assert tight.key != diffrax_objects.solver_of(diffrax.Kvaerno5(), 1e-8, 1e-10).key
