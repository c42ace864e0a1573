"""Lower a unit of the rules, and all that it calls, for CUDA: as far as LLVM's language.

    python tests/for_cuda.py PACKAGE UNIT

That takes neither a GPU nor CUDA's own libraries: a device and the layout of data that they would
tell are said here. Two things stand in for what numba lacks there: ``math.nextafter`` is the
function of that name in CUDA's library, and ``min`` and ``max`` of floats are written out, as the
variadic ones of numba 0.68 are refused.
"""

import inspect
import math
import sys
from importlib import import_module
from types import SimpleNamespace

from numba import cuda
from numba.core.extending import overload
from numba.cuda import dispatcher
from numba.cuda.cudadrv import nvvm
from numba.cuda.libdevice import nextafter

from hybrid.rules.load import Library, kinds_of, signature

#: What CUDA's compiler tells: how data are laid out, and the version of its language.
LAYOUT = (
    "e-p:64:64:64-i1:8:8-i8:8:8-i16:16:16-i32:32:32-i64:64:64-i128:128:128-f32:32:32-f64:64:64-"
    "v16:16:16-v32:32:32-v64:64:64-v128:128:128-n16:32:64"
)
TOLD = {"data_layout": LAYOUT, "get_ir_version": lambda: (2, 0, 3, 1)}


def stand_in():
    """Say what a device would."""
    dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=(8, 0))
    nvvm.NVVM = lambda: SimpleNamespace(**TOLD)

    @overload(math.nextafter, target="cuda")
    def _(a, b):
        return lambda a, b: nextafter(a, b)

    @overload(max, target="cuda")
    def _(a, b):
        return lambda a, b: a if a >= b else b

    @overload(max, target="cuda")
    def _(a, b, c):
        return lambda a, b, c: max(max(a, b), c)

    @overload(min, target="cuda")
    def _(a, b):
        return lambda a, b: a if a <= b else b

    @overload(min, target="cuda")
    def _(a, b, c):
        return lambda a, b, c: min(min(a, b), c)


def devices(package, name):
    """A rule file, with each rule that it has or calls a function for a device."""
    modules = {each: import_module(f"{package}.{each}") for each in Library(package)._calls([name])}
    made = {
        rule: cuda.jit(device=True)(rule)
        for module in modules.values()
        for rule in vars(module).values()
        if inspect.isfunction(rule) and rule.__module__ == module.__name__
    }
    for module in modules.values():
        for own, rule in list(vars(module).items()):
            if inspect.isfunction(rule) and rule in made:
                setattr(module, own, made[rule])
    return modules[name]


def main(package, name):
    stand_in()
    unit = devices(package, name)
    for name in unit.__all__:
        rule = getattr(unit, name)
        kinds = [str(p.annotation) for p in inspect.signature(rule.py_func).parameters.values()]
        lowered = rule.compile_device(signature(kinds_of(kinds, package), package))
        print(name, lowered.signature.return_type)


if __name__ == "__main__":
    main(*sys.argv[1:])
