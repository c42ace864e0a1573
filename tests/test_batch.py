"""Values under ``vmap``: many runs at once, and each what it is alone, to the last bit."""

import jax
import numpy as np
import pytest

import hybrid as hy
from hybrid.functions import batch
from hybrid.functions.derivatives import Runs
from hybrid.functions.function import runs_of
from models.bouncing_ball import BouncingBall

from .lanes import NAMES, draw


def asked(name, count, outputs, **options):
    """Runs of a model of the gallery, and random rows for them, of which some cannot be flown."""
    model, start, (t0, t1), parameters = draw(name, count, seed=5)
    runs = runs_of(model, outputs, options.pop("max_jumps", 12), 4096, **options)
    columns = [parameters[p.name] for p in model.spec.parameters]
    columns += [start[name] for name in model.spec.names]
    columns += [np.full(count, t0), np.where(np.arange(count) == 3, t0, t1)]
    found = np.concatenate([np.reshape(column, (count, -1)) for column in columns], axis=1)
    found[5, -3] = np.nan
    return runs, found


@pytest.mark.parametrize("name", [name for name in NAMES if name != "delay_bounce"])
@pytest.mark.parametrize("outputs", [("final", "jumps", "zeno"), ("zeno",)], ids=["all", "zeno"])
def test_rows_are_runs_of_their_own(name, outputs):
    """Jumps, ends, accumulations, statuses: of rows that are cut, fail, rest, or go on."""
    runs, given = asked(name, 40, outputs)
    numbers, ints = batch.values(runs, given.reshape(8, 5, -1))
    for row, *found in zip(given, numbers.reshape(40, -1), ints.reshape(40, -1), strict=True):
        for one, other in zip(found, runs.values(row), strict=True):
            np.testing.assert_array_equal(one, other)


def test_rows_that_need_no_judgement_are_flown_together(monkeypatch):
    """By machine code, on all cores: no run of their own is made."""
    monkeypatch.setattr(Runs, "values", None)
    fall = hy.as_function(BouncingBall(), t=(0.0, 30.0), max_jumps=64)
    r = np.linspace(0.3, 0.9, 500)
    with jax.enable_x64(True):
        out = jax.jit(jax.vmap(lambda r: fall(BouncingBall(r=r), {"x": 1.0, "v": 0.0})))(r)
    exact = np.sqrt(2 / 9.81) * (1 + r) / (1 - r)
    np.testing.assert_allclose(out.zeno.t, exact, rtol=1e-12)
    np.testing.assert_allclose(out.jumps.t[:, 0], np.sqrt(2 / 9.81), rtol=1e-15)
    assert set(np.asarray(out.status)) == {1}
    assert fall.edges[int(out.jumps.edge[7, 0])] == "impact"


# ---------------------------------------------------------------------------------------
# derivatives

#: What machine code and the walk may differ by, against the largest derivative by the same number:
#: a limit is resolved to 1e-11, and an impact's speed near it divides by its own size.
APART = 1e-8


@pytest.mark.parametrize("name", [name for name in NAMES if name != "delay_bounce"])
def test_derivatives_of_rows_are_those_of_the_walk(name):
    """Carried along a log in one call, or piece by piece: the same, and where there is none."""
    runs, given = asked(name, 12, ("final", "jumps", "zeno"))
    numbers, ints, slopes = batch.Gradients(runs)(given.reshape(3, 4, -1))
    for k, row in enumerate(given):
        alone = runs.slopes(row)
        np.testing.assert_array_equal(numbers.reshape(12, -1)[k], alone[0])
        np.testing.assert_array_equal(ints.reshape(12, -1)[k], alone[1])
        size = np.nan_to_num(np.abs(alone[2])).max(axis=0, initial=1e-300)
        found = slopes.reshape(12, *alone[2].shape)[k]
        np.testing.assert_allclose(found / size, alone[2] / size, rtol=0, atol=APART)


def test_derivatives_that_need_no_judgement_are_flown_together(monkeypatch):
    """By machine code, in both modes: no run of their own is made."""
    monkeypatch.setattr(Runs, "slopes", None)
    fall = hy.as_function(BouncingBall(), t=(0.0, 30.0), max_jumps=64)
    t_inf = lambda r, x: fall(BouncingBall(r=r), {"x": x, "v": 0.0}).zeno.t  # noqa: E731
    r, x = np.linspace(0.3, 0.9, 100), np.linspace(0.5, 2.0, 100)
    t = np.sqrt(2 * x / 9.81)
    with jax.enable_x64(True):
        for derivative in (jax.grad, jax.jacfwd):
            by_r, by_x = jax.jit(jax.vmap(derivative(t_inf, (0, 1))))(r, x)
            np.testing.assert_allclose(by_r, 2 * t / (1 - r) ** 2, rtol=1e-11)
            np.testing.assert_allclose(by_x, t * (1 + r) / (1 - r) / (2 * x), rtol=1e-11)
