"""Lanes of a map, in blocks: what they are asked for, and a block flown."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from functools import cached_property
from hashlib import sha256
from types import CodeType, FunctionType
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from ..automaton.captured import values
from ..automaton.chance import STREAM
from ..automaton.digest import digest
from ..automaton.reals import reals
from ..automaton.spec import Spec
from ..automaton.trace import instance
from ..ensembles import ensemble
from ..ensembles.measures import NAMED
from ..ensembles.processes import Unfit
from ..errors import OptionError, StoreError
from ..lowering import scene_of
from ..run.options import times_of
from ..run.sections import Period, section_of
from ..trajectory.stats import versions
from ..trajectory.trajectory import Status

if TYPE_CHECKING:
    import xarray

#: Lanes in a block, at least and, in maps that are not large, at most; how many blocks there are
#: where both allow it; and how many at most: a block is what an interrupt costs, and in a store a
#: file for each column, of which there are some thirty.
LEAST_BLOCK, MOST_BLOCK, BLOCKS, MOST_BLOCKS = 16, 1024, 64, 256

#: Of so many periods the rounding of their number is no more than this share.
PERIODS_ROUNDING = 1e-9

#: Options with which lanes go one after another through the loop of a run.
ONE_BY_ONE = ("save", "certify")


@attrs.frozen(eq=False, slots=False)
class AskedLanes:
    """Lanes of a model, in blocks.

    Attributes
    ----------
    points : dict
        By name of a parameter or a state its value in each lane.
    start : dict, or callable ``(self)`` that gives it
        The other states.
    t : (t0, t1), or callable ``(self)`` that gives it
    options : dict
        As :func:`hybrid.ensemble` takes them.
    block : int
        Lanes in a block.
    follow : bool
        Whether each begins where the one before has ended.
    before : Dataset, optional
        The lanes before these: the first one follows the last of them.
    """

    model: Any
    points: Mapping[str, np.ndarray]
    start: Any
    t: Any
    options: Mapping[str, Any]
    block: int
    follow: bool = False
    before: xarray.Dataset | None = None

    @property
    def spec(self) -> Spec:
        return self.model.spec  # type: ignore[no-any-return]

    @property
    def count(self) -> int:
        """How many lanes there are."""
        return len(next(iter(self.points.values())))

    @property
    def blocks(self) -> int:
        """How many blocks there are."""
        return -(-self.count // self.block)

    @property
    def one_by_one(self) -> bool:
        """Whether another process saves time: lanes that threads of machine code fly together have
        all cores already, those of which jumps are asked among them."""
        asked, measured = self.options, self.options.get("measure", ())
        looks = any(asked.get(name) is not None for name in ONE_BY_ONE)
        named = () if callable(measured) else [m for m in measured if m in NAMED]
        section = asked.get("section")
        jumps = isinstance(section, str) and asked.get("skip", 0) is not None
        return looks or bool(named) or not (section is None or jumps)

    def rows(self, number: int) -> slice:
        """The lanes of a block."""
        return slice(number * self.block, min((number + 1) * self.block, self.count))

    def only(self, number: int) -> AskedLanes:
        """A block alone: what a worker is sent."""
        rows = self.rows(number)
        return attrs.evolve(self, points={name: v[rows] for name, v in self.points.items()})

    def fly(self, progress: Callable[[int], None] | None = None) -> xarray.Dataset:
        """All lanes as a table over ``lane``."""
        if self.follow:
            return self._followed()
        begun, span = self.start, self.t
        if callable(begun):
            rows = [begun(model) for model in self._models()]
            begun = {name: np.array([row[name] for row in rows], float) for name in rows[0]}
        if callable(span):
            span = tuple(self.spans.T)
        states = {**begun, **{n: v for n, v in self.points.items() if n in self.spec.names}}
        if self.spec.chances and STREAM not in states:
            raise OptionError(
                f"{self.spec.model}: {self.spec.chances[0]} draws: say from which streams, "
                f'over={{"{STREAM}": range(100)}}, or which all have, start={{"{STREAM}": 0}}'
            )
        given = {name: v for name, v in self.points.items() if name not in self.spec.names}
        asked = {"progress": progress, **self.options}
        return ensemble(self.model, states, span, given, **asked)

    @property
    def spans(self) -> np.ndarray:
        """First and last time of each lane."""
        rows = map(self.t, self._models()) if callable(self.t) else [times_of(self.t)] * self.count
        return np.array([*rows], dtype=float).reshape(self.count, 2)

    def require_followed(self) -> None:
        """Refuse lanes that cannot follow each other."""
        spec, section = self.spec, self.options.get("section")
        where = f"{spec.model}: follow=True"
        if len(self.points) > 1 or set(self.points) & set(spec.names):
            raise OptionError(f"{where} goes over one parameter, not over {', '.join(self.points)}")
        if spec.lags:
            raise OptionError(f"{where}: it looks into the past, which is not passed on to a lane")
        if self.options.get("max_jumps") is not None:
            raise OptionError(f"{where}: what is passed on is the last time's: leave out max_jumps")
        for model, (t0, t1) in zip(self._models(), self.spans, strict=True):
            met = None if section is None else section_of(model, scene_of(model), section)
            if not isinstance(met, Period):
                return
            turns = (t1 - t0) / met.period
            if abs(turns - round(turns)) > PERIODS_ROUNDING * turns:
                raise OptionError(
                    f"{where}: t=({t0:.9g}, {t1:.9g}) are {turns:.9g} periods of section=; a whole "
                    "number is due, so that the next lane begins at the same phase"
                )

    def _followed(self) -> xarray.Dataset:
        """Lanes one after another."""
        tables, asked = [], attrs.evolve(self, block=1)
        for number, model in enumerate(self._models()):
            start = self.start(model) if callable(self.start) else self.start
            given = {"start": start, **asked._going_on()}
            tables.append(attrs.evolve(asked.only(number), follow=False, **given).fly())
            asked = attrs.evolve(asked, before=tables[-1])
        return joined(tables)

    def _going_on(self) -> dict[str, Any]:
        """Start and options of a lane that goes on from the one before; none where that one has not
        come to its end."""
        last = None if self.before is None else self.before.isel(lane=-1)
        if last is None or str(last.status.values) != Status.REACHED_END.name.lower():
            return {}
        start = {name: last[name].values for name in self.spec.names}
        return {"start": start, "options": {**self.options, "mode": str(last.mode.values)}}

    def _models(self) -> list[Any]:
        """The model of each lane."""
        alike = {name: getattr(self.model, name) for name in self.spec.given}
        rows = ({n: v[i] for n, v in self.points.items() if n in alike} for i in range(self.count))
        return [instance(type(self.model), [*alike], [*(alike | r).values()]) for r in rows]

    @cached_property
    def key(self) -> dict[str, str]:
        """What the numbers depend on, by name: a digest of each."""
        own = [getattr(self.model, name) for name in self.spec.given]
        parts = {
            "model": (digest(type(self.model)), own),
            "values": (dict(self.points), self.start, self.t),
            "options": (sorted(self.options.items()), self.block, self.follow),
        }
        digests = {name: sha256(_text(part).encode()).hexdigest() for name, part in parts.items()}
        return digests | {"versions": _text(versions())}


def joined(tables: list[xarray.Dataset]) -> xarray.Dataset:
    """Tables of lanes as one."""
    import xarray

    return xarray.concat(tables, dim="lane", data_vars="minimal", coords="minimal", compat="equals")


def points_of(spec: Spec, over: Any) -> dict[str, np.ndarray]:
    """The values by name that a map goes over."""
    known = [*(p.name for p in spec.parameters), *spec.names]
    if not isinstance(over, Mapping) or not over:
        raise OptionError(f'{spec.model}: over={over!r}: values by name, {{"{known[0]}": values}}')
    found = {}
    for name, row in over.items():
        if name in spec.given and name not in known:
            raise OptionError(
                f"{spec.model}: over {name!r}: a signal, whose data are no number; lanes have one "
                f'each by hy.ensemble(..., parameters={{"{name}": [(times, values), ...]}})'
            )
        if name not in known:
            there = ", ".join(known)
            raise OptionError(f"{spec.model}: over {name!r}: a parameter or a state: {there}")
        try:
            found[name] = reals(row)
        except ValueError:
            found[name] = np.empty(0)
        if found[name].ndim != 1 or not found[name].size or not np.isfinite(found[name]).all():
            raise OptionError(f"{spec.model}: over {name}={row!r}: numbers in a row")
        if len(set(found[name].tolist())) < found[name].size:
            raise OptionError(f"{spec.model}: over {name}: a value occurs twice")
    return found


def dimension(spec: Spec, name: str) -> str:
    """The dimension of a map that goes over a parameter, or over the start of a state."""
    return f"{name}_start" if name in spec.names else name


def block_of(count: int, block: Any) -> int:
    """Lanes in a block."""
    if block is None:
        return max(LEAST_BLOCK, min(MOST_BLOCK, -(-count // BLOCKS)), -(-count // MOST_BLOCKS))
    if not (isinstance(block, int | np.integer) and block >= 1):
        raise OptionError(f"block={block!r}: a number of lanes, 1 or more")
    return int(block)


def flier(known: str, asked: AskedLanes) -> Callable[[int], xarray.Dataset]:
    """What flies a block, by its number, in another process; ``known`` is the model's digest."""
    if digest(type(asked.model)) != known:
        raise Unfit(f"{asked.spec.model} is another class there: its file has changed")
    return lambda number: asked.only(number).fly()


def _text(value: Any) -> str:
    """All that a value says, the same in every process.

    Raises
    ------
    StoreError
        If that is not known.
    """
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key!r}: {_text(each)}' for key, each in value.items())}}}"
    if isinstance(value, CodeType):
        return f"{value.co_code.hex()} {value.co_names} {_text(value.co_consts)}"
    if isinstance(value, FunctionType):
        seen = {name: _inner(each) for name, each in values(None, value)}
        return f"{_text(value.__code__)} {_text(value.__defaults__)} {_text(seen)}"
    if hasattr(value, "__array__"):
        array = np.ascontiguousarray(value)
        known = array.dtype.kind in "biufc"
        said = sha256(array.tobytes()).hexdigest() if known else array.tolist()
        return f"{array.shape} {array.dtype} {said}"
    if isinstance(value, list | tuple):
        return f"({', '.join(map(_text, value))})"
    if isinstance(value, str | bytes | int | float | complex | type(None)):
        return repr(value)
    try:
        return sha256(pickle.dumps(value)).hexdigest()
    except Exception as fault:  # whatever an object's own reduction raises
        raise StoreError(f"store=: what {value!r} is cannot be told ({fault})") from None


def _inner(value: Any) -> Any:
    """A value that a function reads; what a function that it calls reads stands beside it."""
    if isinstance(value, FunctionType):
        return value.__code__
    return getattr(value, "__name__", value)  # of modules and classes
