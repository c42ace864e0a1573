"""Taylor jets of a model that is a tape, beside the same recurrences written out as Python.

``first`` is from the traces of the class to the first jet at order 16 (rules loaded, nothing of
the model made), ``jet`` one jet as the driver gets it, ``rule`` the rule alone; ``code`` is that
with the program's own machine code, and what it takes to compile (too long ones are not). Written
out, ``first`` has the generation and compilation of the source in it, and where contacts are held
the tracing of their forces. ``apart`` is the largest difference of a coefficient, relative to the
largest of its row.

    python benchmarks/jets.py
"""

import time

import jax.numpy as jnp
import numpy as np

import hybrid as hy
from hybrid.lowering import native
from hybrid.lowering.arithmetic import OPERATIONS
from hybrid.lowering.lowered import ORDER, Lowered
from hybrid.rules import unit
from tests import recurrences

#: What the written-out recurrences ask for besides.
PLAIN = {**OPERATIONS, "select": lambda c, a, b: a if c else b, "barrier": lambda names: names}

#: States of the chain, modes of the many, contacts of the column.
STATES, MODES, BEADS = 200, 170, 10


class Example(hy.Automaton):
    """Example 1 of the paper: a ball on a table that shakes."""

    x = hy.state()
    v = hy.state()
    r = hy.parameter(0.5)

    @hy.mode
    def flight(self, t, s):
        return s.v, -1.0 - 0.1 * s.v + 0.1 * jnp.sin(t)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x, restitution="r")


class Duffing(hy.Automaton):
    """A driven double well above a wall."""

    x = hy.state()
    v = hy.state()
    r = hy.parameter(0.8)

    @hy.mode
    def flight(self, t, s):
        return s.v, -0.05 * s.v + s.x - s.x**3 + 4.0 * jnp.cos(t)

    impact = hy.contact(flight, gap=lambda self, t, s: s.x + 2.0, restitution="r")


class Chain(hy.Automaton):
    """Nonlinear springs between neighbours."""

    q = hy.state(shape=(STATES // 2,))
    v = hy.state(shape=(STATES // 2,))
    k = hy.parameter(2.0)

    @hy.mode
    def flow(self, t, s):
        q = jnp.pad(s.q, 1)
        return s.v, self.k * (q[2:] - 2.0 * q[1:-1] + q[:-2]) - s.q**3


def many(modes):
    """A clock of so many modes: in each a relaxation to another level."""

    def flow(level):
        return lambda self, t, s: (level - s.x, 1.0)

    def guard(end):
        return lambda self, t, s: end - s.c

    body = {"x": hy.state(), "c": hy.state()}
    for i in range(modes):
        body[f"m{i}"] = hy.mode(initial=i == 0)(flow(float(i % 3)))
    for i in range(modes):
        edge = hy.edge(f"m{i}", to=f"m{(i + 1) % modes}", guard=guard(i + 1.0))
        body[f"e{i}"] = edge(lambda self, t, s: s)
    return type("Many", (hy.Automaton,), body)


def column(beads):
    """Beads on each other and a floor."""

    def gap(i):
        return lambda self, t, s: s.q[i] - s.q[i - 1] if i else s.q[0]

    def falls(self, t, s):
        return s.v, -9.81 + 0.0 * s.q

    body = {"q": hy.state(shape=(beads,)), "v": hy.state(shape=(beads,))}
    body["falls"] = hy.mode(falls)
    for i in range(beads):
        body[f"c{i}"] = hy.contact("falls", gap=gap(i), restitution=0.5)
    return type("Column", (hy.Automaton,), body)


def timed(call, least=0.2):
    """The shortest time of a call, in seconds."""
    best, end = float("inf"), time.perf_counter() + least
    while time.perf_counter() < end:
        begin = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - begin)
    return best


def recorded(cls, modes, held):
    """Time to the first jet of all modes, by the tape; the last one's jets."""
    code = Lowered(cls, ()) if not cls.spec.parameters else Lowered(cls, ((),))
    values = [p.default for p in cls.spec.parameters]
    x = np.linspace(0.1, 1.0, cls.spec.dimension).tolist()
    begin = time.perf_counter()
    for mode in modes:
        graph = code.mode(mode)
        jets = code.tape(mode, held).bind([*values, *[float(held)] * len(graph.resting)])
        jets(0.3, x, [0] * len(jets.watched), ORDER)
    return time.perf_counter() - begin, jets, x


def written(cls, modes, held):
    """The same, written out."""
    code = Lowered(cls, ()) if not cls.spec.parameters else Lowered(cls, ((),))
    values = [p.default for p in cls.spec.parameters]
    x = np.linspace(0.1, 1.0, cls.spec.dimension).tolist()
    begin = time.perf_counter()
    for mode in modes:
        names = tuple(e.name for e in cls.spec.leaving(mode)) if held else ()
        guards = code.trace(lambda p, t, x: jnp.zeros(1))
        field = code.field_closed(mode, names)
        jets = recurrences.written(code, field, guards, ORDER, PLAIN).bind(values)
        jets(0.3, x)
    return time.perf_counter() - begin, jets, x


def rule_alone(jets, x, programs):
    """Time of the rule, without what is put around it."""
    tape = jets.tape
    sides, work = np.zeros(len(tape.kinks), dtype=np.int64), np.empty(tape.room)
    c, start = np.empty((tape.rows, ORDER + 1)), np.array(x)
    rule = unit("jets").jets
    return timed(lambda: rule(programs, 0, ORDER, 0.3, start, sides, c, work))


def coded(jets, x):
    """Time to compile the program, and of the rule with its code; NaN where it is too long."""
    programs = jets.alone._replace(code=np.zeros(1, dtype=np.int64))
    begin = time.perf_counter()
    native.compile_all(programs)
    took = time.perf_counter() - begin
    return (took, rule_alone(jets, x, programs)) if programs.code[0] else (np.nan, np.nan)


def row(cls, modes, held):
    """The figures of a model."""
    first, jets, x = recorded(cls, modes, held)
    other, out, _ = written(cls, modes, held)
    sides = [0] * len(jets.watched)
    jet = timed(lambda: jets(0.3, x, sides, ORDER))
    plain = timed(lambda: out(0.3, x))
    ours, theirs = np.array(jets(0.3, x, sides, ORDER)[0]), np.array(out(0.3, x)[0])
    apart = np.max(np.abs(ours - theirs) / np.abs(ours).max(axis=1, keepdims=True))
    alone = 1e6 * rule_alone(jets, x, jets.alone)
    compiled, code = coded(jets, x)
    tape = 1e3 * first, 1e6 * jet, alone, 1e3 * compiled, 1e6 * code
    return *tape, 1e3 * other, 1e6 * plain, apart


def main():
    models = {
        "Example 1": (Example, ["flight"], False),
        "Duffing": (Duffing, ["flight"], False),
        f"{STATES} states": (Chain, ["flow"], False),
        f"{MODES} modes": (many(MODES), [f"m{i}" for i in range(MODES)], False),
        f"{BEADS} contacts held": (column(BEADS), ["falls"], True),
    }
    unit("jets").jets  # noqa: B018  the rules are loaded once for a process
    native.operations()
    heads = "first ms", "jet us", "rule us", "code ms", "code us", "first ms", "jet us", "apart"
    print(f"{'':>18} {'tape':>54} {'written out':>21}")
    print(f"{'':>18}" + "".join(f" {head:>10}" for head in heads))
    for name, model in models.items():
        print(f"{name:>18}" + "".join(f" {value:10.3g}" for value in row(*model)), flush=True)


if __name__ == "__main__":
    main()
