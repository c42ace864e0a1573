"""Steps of a Diffrax method as a compiled program.

Each attempt at a step calls the method's ``step`` and the controller's ``adapt_step_size``. Numbers
(parameters, start, time, tolerances) are arguments of the program, so changing them does not
recompile it. The memory of method and controller is carried from step to step and reset at each
jump.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from ..automaton.trace import again, wide
from ..lowering import Field
from ..lowering.jit import jit
from ..segment import apply, integrals, nodes

if TYPE_CHECKING:
    from ..automaton.shapes import Numbers

#: Most attempts at a step. Diffrax's controllers shrink a rejected step to at least a fifth, so the
#: smallest float would be reached earlier.
ATTEMPTS = 200

#: Most steps made ahead, and most numbers returned for them: clearing and copying that many takes
#: about as long as a call.
AHEAD, NUMBERS = 32, 8192

#: Shortest possible step, relative to the local time.
SHORTEST = 1e-14

#: Most attempts per call when Diffrax's own loop integrates.
ATTEMPTS_AT_ONCE = 100_000

#: Places of the inputs of a program; the state, the absolute tolerances and the parameters follow.
INDEX, T0, ASKED_TAU, ASKED_TO, ASKED_LIMIT, ASKED_LENGTH, ASKED_STEPS = range(7)
FORCED, ASKED_RTOL, ASKED_STATE = range(7, 10)

#: Places of what each step returns before its states: its end, the end of the step to try next, and
#: the number of rejected attempts so far.
MADE_END, MADE_NEXT, MADE_REFUSED, MADE_STATES = range(4)


class MethodMemory(NamedTuple):
    """The memory of a method and a controller."""

    method: Any
    controller: Any


class StepProgram:
    """Successive steps of a method along a field, as a compiled function.

    Parameters
    ----------
    method : diffrax.AbstractSolver
    controller : diffrax.AbstractStepSizeController or None
    degree : int
        Degree of the dense output.
    sweeps : int
        Number of Picard sweeps that raise the dense output to the order of the method.
    halves : bool
        Whether the dense output, of an even degree, goes through the state in the middle of the
        step that a step of half the length gives.

    Attributes
    ----------
    run : callable ``(numbers, memories)``
        Returns an array and new memories. The array holds the number of steps made, the number of
        attempts rejected, and one row per step. The memories are those before each step and after
        the last one. ``numbers[INDEX]`` selects the memory to begin with; -1 is the start of an
        arc.
    whole : callable ``(numbers)``
        Integrates with Diffrax's own loop; returns the time reached, the next step length, the
        numbers of accepted and rejected steps, and the state.
    empty : tree of arrays
        Memories for the start of an arc.
    """

    def __init__(
        self,
        method: Any,
        controller: Any,
        field: Field,
        degree: int,
        sweeps: int,
        halves: bool,
    ) -> None:
        self.method, self.controller = method, controller
        self.sweeps, self.halves = sweeps, halves
        _, closed, given = field.shared
        self.flow, self.n = again(closed), field.code.spec.dimension
        self.shapes = [np.shape(value) for value in given]
        self.parameters = sum(int(np.prod(shape)) for shape in self.shapes)
        self.states = degree + 1
        self.places = min(AHEAD, 1 + NUMBERS // (self.n * self.states))
        self.run, self.whole = jit(self._run), jit(self._whole)
        self._flat: tuple[Any, Any] = None, None
        with wide():
            numbers = np.zeros(ASKED_STATE + 2 * self.n + self.parameters)
            one = jax.eval_shape(lambda given: self._begin(StepInputs(self, given))[0], numbers)
            self.empty = jax.tree.map(
                lambda leaf: jnp.zeros((self.places + 1, *leaf.shape), leaf.dtype), one
            )

    def flat(self, parameters: Sequence[Any]) -> Numbers:
        """The parameters as one row, cached for the previous arc's parameters."""
        same, row = self._flat
        if same is not parameters:
            row = np.concatenate([np.zeros(0), *map(np.ravel, parameters)])
            self._flat = parameters, row
        return row

    def _begin(self, given: StepInputs) -> tuple[MethodMemory, Any]:
        """The memory at the start of an arc, and the end of its first step."""
        begun = given.controller.init(
            given.term,
            given.tau,
            given.length,
            given.x,
            given.wanted - given.tau,
            None,
            given.method.func,
            given.order,
        )
        memory = given.method.init(given.term, given.tau, begun[0], given.x, None)
        return _strong((MethodMemory(memory, begun[1]), begun[0]))

    def _run(self, numbers: Any, memories: Any) -> Any:
        given = StepInputs(self, numbers)
        index = given.index.astype(int)
        memory, wanted = jax.lax.cond(
            index < 0,
            lambda: self._begin(given),
            lambda: (jax.tree.map(lambda leaf: leaf[index], memories), given.wanted),
        )
        rows = jnp.zeros((self.places, MADE_STATES + self.n * self.states))
        zero = jnp.array(0)
        start = Going(zero, zero, zero, given.tau, wanted, given.x, memory, rows, memories)
        start = start._replace(memories=_put(memories, zero, memory))

        def goes_on(going: Going) -> Any:
            return (going.made < given.count) & (going.tau < given.limit) & (going.tries < ATTEMPTS)

        going = jax.lax.while_loop(goes_on, lambda going: self._attempt(given, going), start)
        counts = jnp.stack([going.made, going.refused]).astype(float)
        return jnp.concatenate([counts, going.rows.ravel()]), going.memories

    def _whole(self, numbers: Any) -> Any:
        given = StepInputs(self, numbers)
        solution = diffrax.diffeqsolve(
            given.term,
            given.method,
            given.tau,
            given.limit,
            given.wanted - given.tau,
            given.x,
            stepsize_controller=given.controller,
            max_steps=ATTEMPTS_AT_ONCE,
            throw=False,
        )
        reached, stats = solution.ts[-1], solution.stats
        counts = [stats["num_accepted_steps"], stats["num_rejected_steps"]]
        mean = (reached - given.tau) / stats["num_steps"]
        return jnp.concatenate([jnp.stack([reached, mean, *counts]), solution.ys[-1]])

    def _attempt(self, given: StepInputs, going: Going) -> Going:
        """Attempt one step."""
        tau, x, forced = going.tau, going.x, given.forced
        end = jnp.where(forced, given.limit, jnp.minimum(going.wanted, given.limit))
        y, error, dense, memory, result = given.method.step(
            given.term, tau, end, x, None, going.memory.method, jnp.array(False)
        )
        fit = jnp.all(jnp.isfinite(y)) & (result == diffrax.RESULTS.successful)
        if error is not None:
            error = jnp.where(fit & jnp.isfinite(error), error, jnp.inf)
        kept, begin, stop, _, controller, _ = given.controller.adapt_step_size(
            tau, end, x, y, None, error, given.order, going.memory.controller
        )
        kept = (kept & fit) | forced
        wanted = jnp.where(kept, end, tau) + (stop - begin)
        longer = jnp.maximum(wanted, end + (going.wanted - tau))
        wanted = jnp.where(kept & (end < going.wanted), longer, wanted)
        after = MethodMemory(_where(kept, memory, going.memory.method), controller)
        after = jax.tree.map(lambda new, old: jnp.asarray(new, old.dtype), after, going.memory)
        refused, place = going.refused + ~kept, going.made
        values = self._values(given, tau, end, x, y, dense)
        if self.halves:
            values = jax.lax.cond(
                kept,
                lambda: self._through_middle(given, going, end, values),
                lambda: values,
            )
        row = jnp.concatenate([jnp.stack([end, wanted, refused.astype(float)]), values.ravel()])
        stuck = ~kept & ~(wanted - tau > SHORTEST * jnp.maximum(tau, 1e-300))
        stuck = stuck | (kept & ~jnp.all(jnp.isfinite(y)))
        return Going(
            going.made + kept,
            jnp.where(stuck, ATTEMPTS, jnp.where(kept, 0, going.tries + 1)),
            refused,
            jnp.where(kept, end, tau),
            wanted,
            jnp.where(kept, y, x),
            after,
            _put(going.rows, place, row),
            _put(going.memories, place + 1, after),
        )

    def _values(self, given: StepInputs, tau: Any, end: Any, x: Any, y: Any, dense: Any) -> Any:
        """The states at the nodes of a step.

        Each Picard sweep integrates the flow along the interpolant, which gains an order, and is
        then corrected to meet the end of the step.
        """
        s, h = jnp.asarray(nodes(self.states - 1)), end - tau
        path = given.method.interpolation_cls(t0=tau, t1=end, **dense)
        values = jax.vmap(path.evaluate)(tau + h * s)
        for _ in range(self.sweeps):
            rates = jax.vmap(lambda t, x: given.term.vf(t, x, None))(tau + h * s, values)
            values = x + h * apply(integrals(self.states - 1), rates)
            values = values + s[:, None] * (y - values[-1])
        return jnp.concatenate([x[None], values[1:-1], y[None]])

    def _through_middle(self, given: StepInputs, going: Going, end: Any, values: Any) -> Any:
        """The states at the nodes of a step, moved onto the state in its middle that a step of half
        the length gives: a cubic through both ends becomes a quartic, with the same slopes there.
        """
        s, middle = jnp.asarray(nodes(self.states - 1)), going.tau + (end - going.tau) / 2
        reached, _, _, _, result = given.method.step(
            given.term, going.tau, middle, going.x, None, going.memory.method, jnp.array(False)
        )
        fit = jnp.all(jnp.isfinite(reached)) & (result == diffrax.RESULTS.successful)
        off = jnp.where(fit, reached - values[self.states // 2], 0.0)
        return values + (4.0 * s * (1.0 - s))[:, None] ** 2 * off


class Going(NamedTuple):
    """State of the loop: steps made, attempts at the next one, rejected attempts, local time, end
    of the next step, state, memory, and the rows and memories to return."""

    made: Any
    tries: Any
    refused: Any
    tau: Any
    wanted: Any
    x: Any
    memory: MethodMemory
    rows: Any
    memories: MethodMemory


class StepInputs:
    """The inputs of a program, unpacked."""

    def __init__(self, program: StepProgram, numbers: Any) -> None:
        self.index, self.t0, self.tau, self.wanted, self.limit, self.length = numbers[:ASKED_STEPS]
        self.count, self.forced = numbers[ASKED_STEPS], numbers[FORCED] > 0
        rtol = numbers[ASKED_RTOL]
        self.x, atol, flat = jnp.split(numbers[ASKED_STATE:], [program.n, 2 * program.n])
        ends = np.cumsum([int(np.prod(shape)) for shape in program.shapes])
        parts = jnp.split(flat, ends[:-1]) if len(ends) else []
        parameters = [p.reshape(s) for p, s in zip(parts, program.shapes, strict=True)]
        self.term = diffrax.ODETerm(lambda s, y, args: program.flow(parameters, self.t0 + s, y))
        self.method = _with_tolerances(program.method, rtol, jnp.min(atol))
        self.controller = program.controller or diffrax.PIDController(rtol=rtol, atol=atol)
        self.order = self.method.error_order(self.term)


def _strong(tree: Any) -> Any:
    """A tree of arrays without weak types."""
    arrays = jax.tree.map(jnp.asarray, tree)
    return jax.tree.map(lambda leaf: jax.lax.convert_element_type(leaf, leaf.dtype), arrays)


def _where(condition: Any, one: Any, other: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), one, other)


def _put(rows: Any, place: Any, row: Any) -> Any:
    """A tree of arrays with row ``place`` of each replaced."""
    put = jax.lax.dynamic_update_index_in_dim
    return jax.tree.map(lambda leaf, one: put(leaf, one, place, 0), rows, row)


def _with_tolerances(method: Any, rtol: Any, atol: Any) -> Any:
    """The method, with our tolerances for its root finder if that uses those of the steps."""
    finder = getattr(method, "root_finder", None)
    if finder is None or isinstance(getattr(finder, "rtol", 0.0), (int, float, jax.Array)):
        return method
    given = {"rtol": rtol, "atol": atol, "norm": diffrax.VeryChord(rtol=1.0, atol=1.0).norm}
    return replace(method, root_finder=replace(finder, **given))
