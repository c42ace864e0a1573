"""What derivatives cost beside values: the accumulation of Example 1, by all that it depends on.

    python -m benchmarks.derivatives [rows]

Least of many calls, in turns; times of one machine, of which only ratios mean anything. Then many
rows under ``vmap``, a row against one call alone.
"""

import sys
import time

import jax
import numpy as np

import hybrid as hy
from models.hard_spring import HardSpring

#: Turns, and calls in each.
TURNS, CALLS = 9, 20


def least(calls, clock=time.process_time, times=CALLS):
    """The least time of each of some calls, in milliseconds."""
    found = dict.fromkeys(calls, np.inf)
    for _ in range(TURNS):
        for name, call in calls.items():
            for _ in range(times):
                begin = clock()
                jax.block_until_ready(call())
                found[name] = min(found[name], 1e3 * (clock() - begin))
    return found


def main(rows):
    jax.config.update("jax_enable_x64", True)
    chatter = hy.as_function(HardSpring(), t=(0.0, 5.0), max_jumps=64, outputs=("zeno",))
    t_inf = lambda r, x: chatter(HardSpring(r=r), {"x": x, "v": 0.0}).zeno.t  # noqa: E731
    forward, reverse = jax.jacfwd(t_inf, (0, 1)), jax.jacrev(t_inf, (0, 1))
    calls = {"value": t_inf, "forward": forward, "reverse": reverse}
    calls |= {f"{name}, in jit": jax.jit(call) for name, call in calls.items()}
    for name, call in calls.items():
        begin = time.perf_counter()
        jax.block_until_ready(call(0.8, 2.1))
        print(f"{name:16} first call {time.perf_counter() - begin:6.2f} s")
    alone = least({name: lambda call=call: call(0.8, 2.1) for name, call in calls.items()})
    for name, took in alone.items():
        print(f"{name:16} {took:7.3f} ms, {took / alone['value, in jit']:5.2f} values")
    r, x = np.linspace(0.6, 0.8, rows), np.linspace(2.05, 2.2, rows)
    many = {"value, in jit": jax.jit(jax.vmap(t_inf))}
    many["reverse, in jit"] = jax.jit(jax.vmap(jax.grad(t_inf, (0, 1))))
    together = {name: lambda call=call: call(r, x) for name, call in many.items()}
    for call in together.values():
        jax.block_until_ready(call())
    for clock in (time.process_time, time.perf_counter):
        for name, took in least(together, clock, times=1).items():
            share = took / rows / alone[name]
            print(
                f"{rows} rows: {name:16} {took / rows:6.3f} ms each ({clock.__name__}), "
                f"{share:.2f} of one alone"
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1000)
