"""Random lanes of the gallery, and whether they equal their runs.

For ``test_ensemble.py`` and ``benchmarks/lanes.py``.
"""

from functools import partial

import attrs
import numpy as np

import hybrid as hy
from hybrid import gallery
from hybrid.functions.batch import values
from hybrid.functions.function import runs_of

#: Impacts, rests, releases, cycles of edges, sliding, and a lag.
NAMES = [
    *("bouncing_ball", "bead_on_table", "hard_spring", "moon_holmes"),
    *("two_tanks", "relay", "ball_on_circle", "delay_bounce"),
]

#: By how much starts and parameters differ from those of the gallery.
SPREAD = 0.1

#: No restitution is larger: it would have to be below 1.
LESS = 0.97


def draw(name, count, seed):
    """A model, its start, time and parameters for ``hy.ensemble``; some starts are outside."""
    entry, random = gallery.find(name), np.random.default_rng(seed)
    factor = lambda shape: random.uniform(1.0 - SPREAD, 1.0 + SPREAD, (count, *shape))  # noqa: E731
    start = {key: factor(np.shape(v)) * np.asarray(v) for key, v in entry.start.items()}
    first = next(iter(start.values()))
    first[::8] *= -1.0
    model, parameters = entry.cls(), {}
    for parameter in entry.cls.spec.parameters:
        value = np.asarray(getattr(model, parameter.name), float)
        drawn = factor(value.shape) * value
        parameters[parameter.name] = np.minimum(drawn, LESS) if parameter.name == "r" else drawn
    t0, t1 = entry.until
    return model, start, (t0, t0 + 0.8 * (t1 - t0)), parameters


def alone(model, start, t, solver, **options):
    """What a lane says, from a run of its own."""
    try:
        run = hy.simulate(model, start, t, solver=solver, save="jumps", **options)
    except hy.HybridError as fault:
        return {"status": fault.status, "reason": str(fault)}
    last = run.own_jumps.get(len(run.parts) - 1)
    final = run.parts[-1].last if last is None else last.after
    told = {"t": run.t1, "jumps": len(run.own_jumps), "accumulations": len(run.zeno)}
    told |= {"status": run.status.name.lower(), "reason": str(run.status), "final": final}
    told["t_inf"] = run.zeno[0].t if run.zeno else np.nan
    told["ratio"] = run.zeno[0].ratio if run.zeno else np.nan
    told["verdict"] = (lambda: run.zeno[0].verdict) if run.zeno else str
    return told


def differences(name, count, seed=0, **options):
    """Names of what differs to the last bit between lanes and their runs, with the lane."""
    model, start, t, parameters = draw(name, count, seed)
    lanes = hy.ensemble(model, start, t, parameters, **options)
    certify = options.pop("certify", False)
    for i in range(count):
        at = partial(lambda i, values: {k: v[i] for k, v in values.items()}, i)
        solver = "scipy" if model.spec.lags else "taylor"
        run = alone(attrs.evolve(model, **at(parameters)), at(start), t, solver, **options)
        verdict, final = run.pop("verdict", str), run.pop("final", None)
        if certify:
            run["verdict"] = verdict()
        for key, value in run.items():
            if not np.array_equal(lanes[key].values[i], value, equal_nan=key in ("t_inf", "ratio")):
                yield i, key
        states = [np.ravel(lanes[key].values[i]) for key in model.spec.names]
        if final is not None and not np.array_equal(np.concatenate(states), final):
            yield i, "final"


#: Jumps of a lane whose events are compared: it ends behind them.
EVENTS = 64


def events_apart(name, count, seed=0):
    """Lanes whose events are not their runs', to the last bit: edges, times, and the states before
    and after; with the status, and where they ended."""
    model, start, (t0, t1), parameters = draw(name, count, seed)
    runs = runs_of(model, ("final", "jumps", "zeno"), max_jumps=EVENTS, max_steps=4096)
    given = [*parameters.values(), *start.values()]
    rows = np.column_stack([*(np.reshape(v, (count, -1)) for v in given), *np.full((2, count), t0)])
    rows[:, -1] = t1
    together = values(runs, rows)
    for i, row in enumerate(rows):
        for lane, run in zip(together, runs.values(row), strict=True):
            if not np.array_equal(lane[i], run, equal_nan=True):
                yield i
                break
