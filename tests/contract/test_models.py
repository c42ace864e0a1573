"""Each model of the gallery ends where its exact run does, on every way in."""

from functools import cache

import numpy as np
import pytest

import hybrid as hy
from hybrid import gallery

from .ways import later

#: ``tests/test_models.py`` holds the accurate solvers to the models' oracles, and these are held to
#: one of them; ``tests/test_compare.py`` holds to it what SciPy's steps give all along the run.
WAYS = ["ensemble", "as_function", *later("Radau", "LSODA")]

#: Shares of the run at whose end the states are compared, the last time included.
SHARES = [0.13, 0.37, 0.71, 1.0]

#: Tolerances of the ways, and what each then keeps: errors of a step, grown along the run.
OPTIONS = {"rtol": 1e-10, "atol": 1e-12}
KEPT = {"Radau": 1e-6, "LSODA": 1e-5, "ensemble": 1e-7, "as_function": 1e-7}


@cache
def exact(name):
    """Runs in Taylor series, accurate to rounding."""
    entry = gallery.find(name)
    return [
        hy.simulate(entry.cls(), entry.start, (t0, t1), history=entry.history, solver="taylor")
        for t0, t1 in spans(entry)
    ]


def spans(entry):
    t0, t1 = entry.until
    return [(t0, t0 + share * (t1 - t0)) for share in SHARES]


@pytest.mark.parametrize("name", gallery.names())
def test_a_model_ends_where_its_exact_run_does(way, name):
    """State, mode and first accumulation at four times along the run."""
    entry = gallery.find(name)
    ends = np.array([t1 for _, t1 in spans(entry)])
    given = {"history": entry.history} if entry.cls.spec.lags else {}
    starts = [entry.start] * len(ends)
    results = way.many(entry.cls(), starts, (entry.until[0], ends), **OPTIONS, **given)
    for result, run in zip(results, exact(name), strict=True):
        assert result.status == "reached_end"
        for field in entry.cls.spec.names:
            size = 1.0 + np.max(np.abs(run.final[field]))
            error = np.max(np.abs(np.asarray(result.final[field]) - run.final[field]))
            assert error <= KEPT[way.name] * size, field
        if way.tells("mode"):
            assert result.mode == run.mode
        if way.tells("accumulations"):
            assert result.accumulations == len(run.zeno)
        assert np.isnan(result.t_inf) == (not run.zeno)
        if run.zeno:
            assert result.t_inf == pytest.approx(run.zeno[0].t, abs=KEPT[way.name])
