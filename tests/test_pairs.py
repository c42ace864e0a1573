"""Lanes by explicit Runge-Kutta pairs: steps of the library that has them, made by machine code."""

import attrs
import diffrax
import numpy as np
import pytest
from scipy.integrate import RK45

import hybrid as hy
from hybrid.ensembles import runs
from hybrid.solvers import choose
from models.hard_spring import HardSpring

from .contract.ways import later
from .lanes import alone, draw
from .test_pace import Swinging

SCIPY, DIFFRAX = ("DOP853", "RK45", "RK23"), ("Dopri8", "Tsit5", "Dopri5", "Bosh3")
PAIRS = [("scipy", method) for method in SCIPY] + [("diffrax", method) for method in DIFFRAX]

#: Some of them have impacts, sums and rests, others events, cycles of edges or a switching.
GALLERY = ["bouncing_ball", "hard_spring", "moon_holmes", "two_tanks"]


@pytest.fixture
def alongside(monkeypatch):
    """Lanes that are flown one by one, by their starts."""
    seen, row = [], runs._Runs.row

    def watched(self, lane):
        seen.append(lane.x)
        return row(self, lane)

    monkeypatch.setattr(runs._Runs, "row", watched)
    return seen


def test_tables_are_consistent():
    """Each stage lies where its weights sum to; dense output ends where the step does."""
    for solver, method in PAIRS:
        table = choose(solver, method, 1e-8, 1e-10).tables
        np.testing.assert_allclose(table.matrix.sum(axis=1), table.fractions, atol=1e-13)
        end = table.errors.shape[1] - 1
        np.testing.assert_allclose(table.dense.sum(axis=1), table.matrix[end], atol=1e-12)
        np.testing.assert_allclose(table.errors.sum(axis=1), 0.0, atol=1e-14)


#: A step's rounding moves its successors: times and states agree as far as the tolerance, 1e-8.
NEAR = 1e-7


def equal(one, other, near=0.0):
    """Whether two numbers or names are the same, but for so much."""
    if isinstance(one, str):
        return one == other
    return bool(np.allclose(one, other, rtol=0.0, atol=near, equal_nan=True))


def differences(model, start, t, parameters, **options):
    """What differs between lanes and their runs; the text of a fault tells times and states."""
    lanes = hy.ensemble(model, start, t, parameters, **options)
    for i in range(lanes.sizes["lane"]):
        at = lambda values, i=i: {key: value[i] for key, value in values.items()}  # noqa: E731
        run = alone(attrs.evolve(model, **at(parameters)), at(start), t, **options)
        run.pop("verdict", None)
        final = run.pop("final", None)
        for key, value in run.items():
            near = NEAR if key in ("t", "t_inf", "ratio") else 0.0
            if not equal(lanes[key].values[i].item(), value, near):
                yield i, key, lanes[key].values[i], value
        states = [np.ravel(lanes[key].values[i]) for key in model.spec.names]
        if final is not None and not equal(np.concatenate(states), final, NEAR):
            yield i, "final", states, final


@pytest.mark.parametrize(
    ("name", "pair"),
    [("bead_on_table", pair) for pair in PAIRS]
    + [(name, PAIRS[0]) for name in GALLERY]
    + later(*((name, pair) for name in GALLERY for pair in PAIRS[1:])),
    ids=lambda case: case if isinstance(case, str) else case[1],
)
def test_lanes_are_the_runs_of_the_same_solver(alongside, name, pair):
    """Where each ended, and how; those that nothing has to be weighed in by machine code."""
    drawn = draw(name, 12, seed=5)
    options = {"solver": pair[0], "method": pair[1], "rtol": 1e-6}
    assert not list(differences(*drawn, **options))
    assert len(alongside) < 12


def test_steps_are_those_of_the_library():
    """As many, refused ones and the landings included, for they follow from each other."""
    model, start, t, parameters = draw("bead_on_table", 8, seed=11)
    for solver, method in PAIRS:
        options = {"solver": solver, "method": method, "rtol": 1e-5}
        lanes = hy.ensemble(model, start, t, parameters, **options)
        for i in np.flatnonzero(lanes.status == "reached_end"):
            own = {key: value[i] for key, value in parameters.items()}
            first = {key: value[i] for key, value in start.items()}
            run = hy.simulate(attrs.evolve(model, **own), first, t, save="jumps", **options)
            assert run.stats.steps == lanes.steps[i]


class Stepped(RK45):
    """A method of a user's, with tables of SciPy's."""


@pytest.mark.parametrize(
    "options",
    [
        {"solver": "scipy", "method": Stepped},
        {"solver": "scipy", "method": "Radau"},
        {"solver": "scipy", "method": "DOP853", "max_step": 0.1},
        {"solver": "diffrax", "method": "Kvaerno3"},
        {"solver": "diffrax", "controller": diffrax.PIDController(1e-6, 1e-8, pcoeff=0.3)},
        {"solver": "diffrax", "method": diffrax.Dopri5(scan_kind="lax")},
    ],
    ids=["subclass", "implicit", "max_step", "Kvaerno3", "controller", "changed"],
)
def test_other_methods_are_not_taken_for_a_pair(alongside, options):
    """They run lane by lane."""
    hy.ensemble(HardSpring(), {"x": [2.05, 2.1], "v": 0.0}, (0.0, 0.3), **options)
    assert len(alongside) == 2


@pytest.mark.long
@pytest.mark.parametrize(("solver", "method"), [PAIRS[4], *later(PAIRS[0])])
def test_steps_that_become_ever_shorter_are_the_runs(solver, method):
    """Their lane says why there are no more, as the run does."""
    start, options = {"x": np.array([1.0])}, {"solver": solver, "method": method, "rtol": 1e-5}
    lanes = hy.ensemble(Swinging(), start, (0.0, 1e3), **options)
    assert lanes.status.values.tolist() == ["not_finite"]
    assert not list(differences(Swinging(), start, (0.0, 1e3), {}, **options))


def test_max_steps_ends_a_lane():
    """After as many steps, with that status; it is a run's own there."""
    given = draw("bead_on_table", 6, seed=5)
    lanes = hy.ensemble(*given, solver="scipy", method="RK23", max_steps=40)
    assert "max_steps" in lanes.status
    assert set(lanes.steps.values[lanes.status == "max_steps"]) == {40}
