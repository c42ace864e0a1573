"""Arrays have the numbers and dimensions that annotations say."""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any

import jaxtyping
import numpy as np
import pytest

import hybrid as hy
from hybrid.automaton import shapes
from hybrid.solvers import maker
from models import bead_on_table, dry_friction, hard_spring, pyragas, two_tanks

from .contract.ways import spread
from .oscillators import Lorenz, VanDerPol
from .systems import Oscillator

NAMES = {name: kind for name, kind in vars(shapes).items() if name[0].isupper()}


def modules() -> list[ModuleType]:
    """The modules of the package, but for those that machine code is made of."""
    found = pkgutil.walk_packages(hy.__path__, "hybrid.")
    names = [module.name for module in found]
    left_out = (".rules", ".models", "__main__")
    return [importlib.import_module(n) for n in names if not any(part in n for part in left_out)]


def kind_of(annotation: Any) -> Any:
    """What an annotation says of an array, or of a tuple of such; None where it says nothing."""
    tree = ast.parse(annotation, mode="eval").body if isinstance(annotation, str) else None
    return None if tree is None else _kind(tree)


def _kind(tree: ast.expr) -> Any:
    match tree:
        case ast.Name(id=name):
            return NAMES.get(name)
        case ast.BinOp(left=left, op=ast.BitOr(), right=ast.Constant(value=None)):
            kind = _kind(left)
            return None if kind is None else kind | None
        case ast.Subscript(value=ast.Name(id="tuple"), slice=ast.Tuple(elts=parts)):
            kinds = tuple(_kind(part) for part in parts)
            return kinds if any(kind is not None for kind in kinds) else None
    return None


def holds(value: Any, kind: Any) -> bool:
    """Whether a value is what an annotation says."""
    if isinstance(kind, tuple):
        return all(holds(v, k) for v, k in zip(value, kind, strict=False))
    return kind is None or isinstance(value, kind)


def checked(function: Callable[..., Any]) -> Callable[..., Any] | None:
    """The same function, which refuses arrays of other shapes; None where it names none."""
    kinds = {name: kind_of(a) for name, a in getattr(function, "__annotations__", {}).items()}
    kinds = {name: kind for name, kind in kinds.items() if kind is not None}
    if not kinds or inspect.isgeneratorfunction(function):
        return None
    signature = inspect.signature(function)

    @jaxtyping.jaxtyped(typechecker=None)
    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        for name, value in signature.bind(*args, **kwargs).arguments.items():
            assert holds(value, kinds.get(name)), said(function, name, value)
        result = function(*args, **kwargs)
        assert holds(result, kinds.get("return")), said(function, "return", result)
        seen.add(function)
        return result

    return call


seen: set[Any] = set()


def said(function: Any, name: str, value: Any) -> str:
    shape = f"{getattr(value, 'dtype', '')}{list(np.shape(value))}"
    return f"{function.__module__}.{function.__qualname__}, {name}: {shape}"


def places() -> Iterator[tuple[Any, str, Any, Callable[[Any], Any]]]:
    """Every function that names a shape: where it is kept, as what, and what makes it anew."""
    for module in modules():
        for name, thing in list(vars(module).items()):
            if inspect.isfunction(thing):
                yield module, name, thing, lambda own: own
            elif inspect.isclass(thing) and thing.__module__ == module.__name__:
                for inner, own in list(vars(thing).items()):
                    if inspect.isfunction(own):
                        yield thing, inner, own, lambda made: made
                    elif isinstance(own, property) and own.fget is not None:
                        yield thing, inner, own.fget, functools.partial(property, fset=own.fset)
                    elif isinstance(own, staticmethod | classmethod):
                        yield thing, inner, own.__func__, type(own)


@pytest.fixture(scope="module")
def watched() -> Iterator[int]:
    """Functions of the package check their arrays while the tests of this module run."""
    made: dict[Any, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        for owner, name, function, again in list(places()):
            if function not in made:
                made[function] = checked(function)
            if made[function] is not None:
                patch.setattr(owner, name, again(made[function]))
        yield sum(call is not None for call in made.values())


RUNS = {
    hard_spring.HardSpring: hard_spring,
    bead_on_table.BeadOnTable: bead_on_table,
    dry_friction.DryFriction: dry_friction,
    two_tanks.TwoTanks: two_tanks,
    pyragas.Pyragas: pyragas,
}


@pytest.mark.parametrize(("model", "solver"), spread([*RUNS], ["taylor", "scipy", "diffrax"]))
def test_a_run_passes_arrays_of_these_shapes(watched, model, solver, tmp_path):
    scene = RUNS[model]
    history = scene.START if model.spec.lags else None
    run = hy.simulate(model(), scene.START, scene.UNTIL, solver=solver, history=history)
    run(np.linspace(run.t0, run.t1, 7))
    run.to_xarray()
    run.save(tmp_path / "run.nc")
    assert hy.load(tmp_path / "run.nc").final == run.final


def test_orbits_pass_arrays_of_these_shapes(watched):
    hy.periodic_orbit(VanDerPol(), {"x": 2.0, "v": 0.0})
    hy.lyapunov(Lorenz(), {"x": 1.0, "y": 1.0, "z": 20.0}, (0.0, 5.0))
    run = hy.simulate(Oscillator(), {"x": 0.0, "v": 1.0}, (0.0, 40.0), solver="taylor")
    assert run.settles() is not None


def test_lanes_and_derivatives_pass_arrays_of_these_shapes(watched):
    lanes = hy.ensemble(hard_spring.HardSpring(), {"x": np.array([2.1, 2.2]), "v": 0.0}, (0.0, 6.0))
    assert lanes.t_inf.notnull().all()


def test_a_shape_that_is_wrong_is_seen(watched):
    with pytest.raises(AssertionError, match="x0"):
        maker("scipy")(None, 1e-8, 1e-8).begin(None, 0.0, np.zeros((2, 2)), 1.0, None)


def test_shapes_are_said_of_most_functions(watched):
    """And functions that name one are found by the walk: they are not checked otherwise."""
    assert watched > 300
