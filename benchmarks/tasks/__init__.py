"""What is timed: a file for each kind of task, a task by its name."""

from __future__ import annotations

from functools import partial
from importlib import import_module
from typing import Any

from hybrid.solvers.base import FINEST

#: The file of each task.
TASKS = {
    "ball": "impacts",
    "example_1": "impacts",
    "table": "impacts",
    "moon_holmes": "impacts",
    "chaotic_table": "impacts",
    "duffing": "impacts",
    "example_1_and_on": "accumulations",
    "slow_accumulation": "accumulations",
    "thrown": "accumulations",
    "lanes": "lanes",
    "lanes_to_rest": "lanes",
    "pyragas": "delays",
    "pyragas_lifted": "delays",
    "relay": "others",
    "stiff": "others",
    "chain": "others",
    "no_edge": "others",
}


def task_of(name: str, quick: bool = False) -> Any:
    """A task; ``quick``: a small one, to see that all works."""
    return import_module(f"tasks.{TASKS[name]}").task(name, quick)


#: Peers that fly bodies over walls: a module of ``peers``, and the least tolerance it takes.
PEERS: dict[str, tuple[str, float | None]] = {
    "solve_ivp {}, begun anew": ("solve_ivp_restarts", FINEST),
    "CVODE {}, begun anew": ("cvode_roots", 1e-14),
    "diffeqsolve {}, nested": ("diffeqsolve_nested", 1e-13),
    "heyoka, callback": ("heyoka_events", None),
    "numba, Taylor by hand": ("numba_taylor", None),
}

#: Methods of those that have several, for what is not stiff.
PLAIN = {"solve_ivp_restarts": "DOP853", "cvode_roots": "Adams", "diffeqsolve_nested": "Tsit5"}


def peers(tasks: dict[str, Any], methods: dict[str, str] = PLAIN) -> dict[str, Any]:
    """Ways of the peers, by what each is to fly: slow ones less."""
    found = {}
    for name, (module, finest) in PEERS.items():
        if module in tasks:
            method = methods.get(module)
            make = partial(prepared, module, tasks[module], finest, method)
            found[name.format(method)] = make
    return found


def prepared(module: str, task: Any, finest: float | None, method: str | None, rtol: Any) -> Any:
    """A call of a peer at a tolerance."""
    peer = import_module(f"peers.{module}")
    options = {} if method is None else {"method": method}
    return peer.prepare(task, finest if rtol is None else rtol, **options)


def tolerances(solver: str, rtol: float | None) -> dict[str, float]:
    """What a solver of this package is given; None is its least."""
    least = {"taylor": 1e-14, "scipy": FINEST, "diffrax": 1e-13}[solver]
    given = least if rtol is None else rtol
    return {"rtol": given, "atol": given}
