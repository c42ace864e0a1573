"""Loading the rules: as machine code that is compiled once and kept, or as plain Python.

The rule files of a package are copied, all of them and nothing else, into one folder of the
user's cache whose name is a hash of their text, of this file, of numba, llvmlite, Python and the
processor. There machine code is kept beside them (:mod:`.code`). A file is a unit: it is compiled
when it is first asked for, with the files that it calls and those that are needed together with it,
in processes beside each other. A change in any file makes a new folder, so that no caller is kept
that has an old callee in it. A process that finds all compiled imports no numba.
"""

from __future__ import annotations

import ast
import atexit
import contextlib
import gc
import hashlib
import inspect
import os
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from functools import cache, cached_property
from graphlib import TopologicalSorter
from importlib import import_module, machinery, util
from importlib.metadata import version
from pathlib import Path
from queue import SimpleQueue
from types import SimpleNamespace
from typing import Any

from . import calls, code

#: Modules of a package of rules that are no rules.
APART = ("__init__", "__main__", "calls", "code", "load", "references")

#: What an annotation of an argument means to numba.
TYPES = {
    "float": "float64",
    "int": "int64",
    "bool": "boolean",
    "Floats": "float64[::1]",
    "Matrix": "float64[:, ::1]",
    "Ints": "int64[::1]",
    "Table": "int64[:, ::1]",
}

#: Settings of numba that change the machine code.
SETTINGS = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_OPT", "NUMBA_BOUNDSCHECK")

#: Folders that are kept beside a new one, and the time in seconds (a day) for which any is kept.
KEPT, FRESH = 4, 86400.0

#: How hard LLVM tries in a process that compiles, unless the user's setting says otherwise. Its
#: higher levels take half as long again, and the rules, short loops full of branches, do not run
#: faster for it.
LEVEL = {"NUMBA_OPT": "1"}

#: A process that compiles the units whose names it is told, and answers when each is done.
COMPILER = "from {loader} import Library; Library({package!r}).serve()"

#: What is put below the text of a rule file. A product and a sum may be contracted to one
#: operation where the file does not say ``EXACT = True``; nothing may assume that there is no NaN
#: and no infinity. What Python calls has an explicit signature, so that a wrong array is refused,
#: and is kept: other files call it at its address. What stands in no ``__all__`` is compiled into
#: its callers. Nothing is allocated, so that arrays need not be counted: that took more than half
#: of the time of a jet.
FOOTER = """

from numba import njit as _njit

from {loader} import made as _made
from {loader} import outside as _outside

_options = {{"fastmath": {fast!r}, "error_model": "numpy", "nogil": True, "_nrt": False}}
_options |= {{"no_cfunc_wrapper": True, "no_cpython_wrapper": True}}
_plain = {{name: globals()[name] for name in {functions!r}}}
_rules = {{name: _njit(forceinline=True, **_options)(rule) for name, rule in _plain.items()}}
_rules |= _outside(_rules)
globals().update(_rules)
_public = {{name: (_plain[name], kinds) for name, kinds in {arguments!r}.items()}}
globals().update(_made(__file__, _public, {imports!r}, {package!r}, {text!r}, _options))
"""


class Library:
    """The rules of a package.

    The variable ``HYBRID_RULES`` chooses how they run: ``machine`` (what is meant if it is not
    set), ``python``, or ``checked``, which is Python that refuses indices below zero.

    Parameters
    ----------
    package : str
        Name of a package that can be imported and whose modules are rule files.
    together : sequence of sequence of str
        Units of which none is needed without the others: they are compiled together.
    """

    def __init__(self, package: str, together: Sequence[Sequence[str]] = ()) -> None:
        self.package, self.together = package, together
        self.unit = cache(self._unit)

    def how(self) -> str:
        """How rules run: ``machine``, ``python`` or ``checked``."""
        how = os.environ.get("HYBRID_RULES", "machine")
        if how not in ("machine", "python", "checked"):
            raise ValueError(f"HYBRID_RULES={how!r}: choose machine, python or checked")
        return how if how != "machine" or self._works else "python"

    @cached_property
    def _works(self) -> bool:
        """Whether there is machine code, or what makes it."""
        with contextlib.suppress(ImportError, OSError, RuntimeError):
            if (cache_folder() / self.key).is_dir():  # numba was there
                return True
        return _has_numba()

    def text(self, name: str) -> str:
        """What a unit that says ``TEXT = True`` is in LLVM's language."""
        if not self._mark(name).exists():
            with locked(self.folder / "lock"):
                self._build_for(name)
        return (self.folder / f"{name}.ll").read_text(encoding="utf-8")

    def _unit(self, name: str) -> Any:
        """The rules of one file that Python calls (those in its ``__all__``), by name."""
        how = self.how()
        if how == "machine":
            return SimpleNamespace(**self._compiled(name))
        module = import_module(f"{self.package}.{name}")
        plain = {rule: getattr(module, rule) for rule in module.__all__}
        return SimpleNamespace(**{k: _plainly(f, how == "checked") for k, f in plain.items()})

    @cached_property
    def sources(self) -> dict[str, str]:
        """The text of each rule file."""
        found = util.find_spec(self.package)
        if found is None or not found.submodule_search_locations:
            raise ImportError(f"{self.package} is no package")
        files = sorted(Path(found.submodule_search_locations[0]).glob("*.py"))
        return {f.stem: f.read_text(encoding="utf-8") for f in files if f.stem not in APART}

    @cached_property
    def key(self) -> str:
        """A name for everything on which the machine code depends."""
        own = [Path(__file__).with_name(f"{name}.py") for name in ("load", "code", "references")]
        parts = [self.package, *(path.read_text(encoding="utf-8") for path in own)]
        parts += [text for pair in self.sources.items() for text in pair]
        parts += [*map(version, ("numba", "llvmlite")), sys.version, sys.platform]
        parts += code.processor()
        parts += [{**LEVEL, **os.environ}.get(setting, "") for setting in SETTINGS]
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:24]

    @cached_property
    def folder(self) -> Path:
        """Where the copies and their machine code are; they are written here if need be."""
        try:
            return self._written(cache_folder())
        except (OSError, RuntimeError) as error:  # the latter where there is no home
            warnings.warn(
                f"the rules' machine code cannot be kept ({error}): it is compiled again in each "
                "process; set HYBRID_CACHE to a folder that can be written",
                stacklevel=2,
            )
            own_folder = Path(tempfile.mkdtemp(prefix="hybrid-"))
            atexit.register(shutil.rmtree, own_folder, ignore_errors=True)
            return self._written(own_folder)

    def _written(self, base: Path) -> Path:
        folder = base / self.key
        if not folder.is_dir():
            base.mkdir(parents=True, exist_ok=True)
            tidy(base)
            draft = Path(tempfile.mkdtemp(prefix="draft-", dir=base))
            for name, text in {"__init__": "", **self.sources}.items():
                whole = text + footer(text, self.package)
                (draft / f"{name}.py").write_text(whole, encoding="utf-8")
            try:
                os.replace(draft, folder)
            except OSError:  # another process was first
                shutil.rmtree(draft, ignore_errors=True)
                if not folder.is_dir():
                    raise
        with tempfile.TemporaryFile(dir=folder):  # others are kept here
            os.utime(folder)
        return folder

    def _compiled(self, name: str) -> dict[str, Any]:
        if name not in self.sources:
            raise ImportError(f"{self.package} has no rule file {name!r}")
        if not self._mark(name).exists():
            with locked(self.folder / "lock"):
                self._build_for(name)
        return {placed.rule.name: calls.Call(placed) for placed in code.placed(self._mark(name))}

    def _build_for(self, name: str) -> None:
        """Compile a unit, and what is needed together with it, unless another process has.

        That is done beside this process, one unit alone too: numba may be at another level here,
        which gives a unit that is kept as text other last bits.
        """
        if self._mark(name).exists():
            return
        said = f"hybrid: compiling the rules {name!r}, once, into {self.folder}"
        print(said, file=sys.stderr, flush=True)
        names = next((group for group in self.together if name in group), (name,))
        self._in_processes(self._calls(names))
        if not self._mark(name).exists():
            self.compile(name)  # what failed fails here again, and says why

    def build(self) -> bool:
        """Compile every unit that is not compiled yet; whether that went well."""
        with locked(self.folder / "lock"):
            return self._in_processes(self._calls(self.sources))

    def serve(self) -> None:
        """Compile the units whose names come in, a line each; a line goes out for each."""
        for line in sys.stdin:
            self.compile(line.strip())
            print(flush=True)

    def compile(self, name: str) -> None:
        """Compile a unit, and what it calls that is not compiled, in this process."""
        with uncollected():
            import_module(f"{_package(self.folder)}.{name}")

    def _mark(self, name: str) -> Path:
        """The file in which a unit is kept that is compiled."""
        return self.folder / f"{name}.built"

    def _units(self, names: Iterable[str]) -> set[str]:
        """Which of these files are units that are not compiled."""
        public = {name for name in names if _public(ast.parse(self.sources[name]))}
        return {name for name in public if not self._mark(name).exists()}

    def _calls(self, names: Iterable[str]) -> dict[str, set[str]]:
        """For files, and all that they import from, those that they import from."""
        calls: dict[str, set[str]] = {}
        left = set(names)
        while left:
            name = left.pop()
            calls[name] = {node.module or "" for node in _imports(ast.parse(self.sources[name]))}
            left |= calls[name] - set(calls)
        return calls

    def _in_processes(self, calls: dict[str, set[str]]) -> bool:
        """Compile files, callees first, as many at once as processors; whether that went well.

        ``calls``: for each the files from which it imports. Where one fails, the rest is left.
        """
        units, order = self._units(calls), TopologicalSorter(calls)
        order.prepare()
        running: dict[Future[bool], str] = {}
        with self._beside() as compiled, ThreadPoolExecutor(os.cpu_count()) as pool:
            while order.is_active():
                for name in order.get_ready():
                    running[pool.submit(lambda n: n not in units or compiled(n), name)] = name
                for done in wait(running, return_when=FIRST_COMPLETED).done:
                    if not done.result():
                        pool.shutdown(cancel_futures=True)
                        return False
                    order.done(running.pop(done))
        return True

    @contextlib.contextmanager
    def _beside(self) -> Iterator[Callable[[str], bool]]:
        """What compiles a unit in a process beside this one; whether that went well.

        The processes, as many as there are processors, are kept from unit to unit: to start one
        takes as long as a small unit.
        """
        idle: SimpleQueue[subprocess.Popen[str] | None] = SimpleQueue()
        for _ in range(os.cpu_count() or 1):
            idle.put(None)

        def compiled(name: str) -> bool:
            process, answer = idle.get(), ""
            with contextlib.suppress(OSError):  # there may be no such program, or no room for it
                process = process or self._serving()
                print(name, file=process.stdin, flush=True)
                answer = process.stdout.readline() if process.stdout else ""
            idle.put(process)
            return bool(answer)

        try:
            yield compiled
        finally:
            while not idle.empty():
                if process := idle.get():
                    process.communicate()

    def _serving(self) -> subprocess.Popen[str]:
        """A process that compiles units."""
        code = COMPILER.format(loader=__name__, package=self.package)
        env = {**LEVEL, **os.environ, "HYBRID_CACHE": str(self.folder.parent)}
        env["PYTHONPATH"] = os.pathsep.join(map(os.path.abspath, sys.path))
        command, pipe = [sys.executable or "python", "-P", "-c", code], subprocess.PIPE
        return subprocess.Popen(
            command, env=env, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True
        )


def footer(text: str, package: str) -> str:
    """What turns the functions of a rule file into machine code; nothing if it has none."""
    tree = ast.parse(text)
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    if not functions:
        return ""
    public = _public(tree)
    return FOOTER.format(
        loader=__name__,
        package=package,
        fast=False if _said(tree, "EXACT") else {"contract"},
        text=bool(_said(tree, "TEXT")),
        functions=[f.name for f in functions],
        arguments={f.name: _annotations(f) for f in functions if f.name in public},
        imports=sorted({node.module or "" for node in _imports(tree)}),
    )


def _imports(tree: ast.Module) -> list[ast.ImportFrom]:
    """What a file imports from others of its package."""
    return [node for node in tree.body if isinstance(node, ast.ImportFrom) and node.level]


def _public(tree: ast.Module) -> tuple[str, ...]:
    """What a file's ``__all__`` says."""
    return tuple(_said(tree, "__all__") or ())


def _said(tree: ast.Module, name: str) -> Any:
    """The value of a name that a file gives itself."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            return ast.literal_eval(node.value)
    return None


def _annotations(function: ast.FunctionDef) -> list[str]:
    return [ast.unparse(a.annotation) for a in function.args.args if a.annotation]


def kinds_of(annotations: Iterable[str], package: str) -> tuple[code.Kind, ...]:
    """The kinds of arguments, from their annotations.

    An annotation is a name in :data:`TYPES`, or that of a tuple of such with names, a class in the
    file ``arrays`` of the package.
    """

    def of(name: str) -> code.Kind:
        if name in TYPES:
            return name
        named = getattr(import_module(f"{package}.arrays"), name)
        return name, kinds_of((p.__forward_arg__ for p in named.__annotations__.values()), package)

    return tuple(map(of, annotations))


def signature(kinds: Iterable[code.Kind], package: str, referred: bool = False) -> tuple[Any, ...]:
    """The types of arguments; tuples may be referred to by their addresses."""
    import numba

    def of(kind: code.Kind) -> Any:
        if isinstance(kind, str):
            return numba.core.sigutils.normalize_signature(f"({TYPES[kind]},)")[0][0]
        named, parts = getattr(import_module(f"{package}.arrays"), kind[0]), tuple(map(of, kind[1]))
        if referred:
            from .references import reference

            return reference(named, parts)
        if len(set(parts)) == 1:
            return numba.types.NamedUniTuple(parts[0], len(parts), named)
        return numba.types.NamedTuple(parts, named)

    return tuple(map(of, kinds))


def made(
    file: str,
    rules: dict[str, tuple[Callable[..., Any], list[str]]],
    imports: Iterable[str],
    package: str,
    text: bool,
    options: dict[str, Any],
) -> dict[str, Any]:
    """The rules of a file that other machine code calls; they are compiled and kept, if need be.

    ``rules``: each with the annotations of its arguments. ``text``: whether they are kept in LLVM's
    language, too.
    """
    path = Path(file).with_suffix(".built")
    if not path.exists():
        kept = []
        for rule, annotations in rules.values():
            found, written = compiled(rule, kinds_of(annotations, package), package, options)
            kept.append(found)
            if text:
                draft = path.with_suffix(f".{os.getpid()}")
                draft.write_text(written, encoding="utf-8")
                os.replace(draft, path.with_suffix(".ll"))
        called = (name for name in imports if path.with_name(f"{name}.built").exists())
        code.write(path, code.Unit(tuple(called), tuple(kept)))
    return {
        rule.name: declared(rule, code.symbol(path, rule.name), rules[rule.name][0], package)
        for rule, *_ in code.placed(path)
    }


def compiled(
    rule: Callable[..., Any], kinds: tuple[code.Kind, ...], package: str, options: dict[str, Any]
) -> tuple[code.Rule, str]:
    """A rule compiled by numba, as it is kept and in LLVM's language."""
    import numba

    function = numba.njit(signature(kinds, package, True), **options)(rule)
    (own,) = function.overloads.values()
    written = function.inspect_llvm(own.signature.args)
    module = code.binding().parse_assembly(written)
    others = [f.name for f in module.functions if f.is_declaration]
    needs = tuple(name for name in others if not name.startswith("llvm."))
    result, plain = own.signature.return_type, numba.types.unliteral
    names = {signature([kind], package)[0]: kind for kind in code.LLVM_TYPES} | {
        numba.types.none: ""
    }
    several = isinstance(result, numba.types.BaseTuple)
    returned = tuple(names[plain(part)] for part in result) if several else names[plain(result)]
    name = own.fndesc.llvm_func_name
    module.link_in(code.binding().parse_assembly(code.entry(name, kinds)))
    made = own.library.codegen._tm.emit_object(module)
    return code.Rule(rule.__name__, name, kinds, returned, needs, made), written


def declared(kept: code.Rule, symbol: str, rule: Callable[..., Any], package: str) -> Any:
    """A rule as other machine code calls it: at its address, which has a name.

    numba would put a copy of the rule's machine code, and of all that it calls, into that of each
    caller, and optimise it there anew.
    """
    from numba import types
    from numba.core.cgutils import get_or_insert_function
    from numba.core.imputils import impl_ret_untracked
    from numba.extending import intrinsic

    kinds = signature(kept.kinds, package, True)
    if isinstance(kept.result, tuple):
        result = types.BaseTuple.from_types(signature(kept.result, package))
    else:
        result = signature([kept.result], package)[0] if kept.result else types.none

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        convention = context.call_conv
        kind = convention.get_function_type(result, kinds)
        function = get_or_insert_function(builder.module, kind, symbol)
        _, value = convention.call_function(builder, function, result, kinds, arguments)
        return impl_ret_untracked(context, builder, result, value)

    def call(*_: Any) -> Any:
        return result(*kinds), codegen

    call.__name__ = kept.name
    call.__signature__ = _parameters(rule)  # type: ignore[attr-defined]
    return intrinsic(call)


def outside(names: Iterable[str]) -> dict[str, Any]:
    """Those of some rules that machine code has in another way than by their text."""
    return {"run_code": _run_code()} if "run_code" in names else {}


def _parameters(function: Callable[..., Any]) -> inspect.Signature:
    """Those of a function, behind one for numba's context of types."""
    own = inspect.signature(function)
    first = inspect.Parameter("typing", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return own.replace(parameters=[first, *own.parameters.values()])


def _run_code() -> Any:
    """The rule that calls machine code at an address, with a number and the data of arrays.

    Behind the number it gets the length of the matrix's rows. An argument that were a function
    would be slow: 100 us for a call from Python.
    """
    from llvmlite import ir
    from numba import types
    from numba.core.imputils import impl_ret_untracked
    from numba.extending import intrinsic

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        address, order, *values = arguments
        pairs = zip(signature.args[2:], values, strict=True)
        arrays = [context.make_array(kind)(context, builder, value) for kind, value in pairs]
        columns = builder.extract_value(arrays[3].shape, 1)
        given = [order, columns, *(array.data for array in arrays)]
        called = ir.FunctionType(ir.VoidType(), [value.type for value in given])
        builder.call(builder.inttoptr(address, called.as_pointer()), given)
        return impl_ret_untracked(context, builder, types.none, context.get_dummy_value())

    @intrinsic  # type: ignore[untyped-decorator]
    def run_code(
        typing: Any, address: Any, order: Any, more: Any, s: Any, sides: Any, c: Any, work: Any
    ) -> Any:
        return types.none(address, order, more, s, sides, c, work), codegen

    return run_code


def cache_folder() -> Path:
    """The folder for what can be made again: ``HYBRID_CACHE``, or the system's own."""
    env = os.environ
    if own := env.get("HYBRID_CACHE"):
        return Path(own)
    if sys.platform == "win32":
        base = env.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
        return Path(base) / "hybrid" / "cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "hybrid"
    return Path(env.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hybrid"


def tidy(base: Path) -> None:
    """Remove folders of other hashes but for the last few, and those used within a day."""
    now = time.time()
    with contextlib.suppress(OSError):
        folders = [f for f in base.iterdir() if f.is_dir() and _is_ours(f)]
        used = sorted(((f.stat().st_mtime, f) for f in folders), reverse=True)
        for last, folder in used[KEPT:]:
            if now - last > FRESH:
                shutil.rmtree(folder, ignore_errors=True)


def _is_ours(folder: Path) -> bool:
    name = folder.name
    return name.startswith("draft-") or (len(name) == 24 and set(name) <= set("0123456789abcdef"))


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold a file's lock, which the system takes back from a process that dies.

    Where files cannot be locked nothing is lost but time: files are replaced whole, and two
    processes may compile the same.
    """
    with path.open("a+b") as file:
        with contextlib.suppress(OSError):
            _lock(file.fileno())
        yield  # closing the file gives the lock back


@contextlib.contextmanager
def uncollected() -> Iterator[None]:
    """Leave garbage where it is: numba makes millions of objects that stay.

    To look through them again and again takes a fifth of the time where one process compiles the
    longest unit and all that it calls; it then needs 0.8 GB instead of 0.6.
    """
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def _lock(descriptor: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        os.lseek(descriptor, 0, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_LOCK, 1)  # tries for ten seconds, then an OSError
    else:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX)


def _package(folder: Path) -> str:
    """Make a folder importable as a package, and say under which name."""
    name = f"hybrid_rules_{folder.name}"
    spec = machinery.ModuleSpec(name, None, is_package=True)
    spec.submodule_search_locations = [str(folder)]
    sys.modules.setdefault(name, util.module_from_spec(spec))
    return name


@cache
def _has_numba() -> bool:
    try:
        import numba  # noqa: F401
    except ImportError as error:
        warnings.warn(
            f"numba cannot be imported ({error}): the rules run as plain Python, which is much "
            "slower; pip install numba, or set HYBRID_RULES=python to say that this is meant",
            stacklevel=2,
        )
        return False
    return True


def _plainly(rule: Callable[..., Any], checked: bool) -> Callable[..., Any]:
    """A rule as Python that treats numbers as machine code does: ``1/0`` is infinite."""
    import numpy as np

    def convert(value: Any) -> Any:
        if isinstance(value, float):
            return np.float64(value)
        if isinstance(value, tuple):
            return type(value)(*map(convert, value))
        return value.view(_checked()) if checked and isinstance(value, np.ndarray) else value

    def call(*arguments: Any) -> Any:
        with np.errstate(all="ignore"):
            return rule(*map(convert, arguments))

    return call


@cache
def _checked() -> Any:
    """Arrays that refuse indices below zero, which elsewhere silently count from the end."""
    import numpy as np

    class Checked(np.ndarray):
        def __getitem__(self, index: Any) -> Any:
            _not_below_zero(index)
            return super().__getitem__(index)

        def __setitem__(self, index: Any, value: Any) -> None:
            _not_below_zero(index)
            super().__setitem__(index, value)

    return Checked


def _not_below_zero(index: Any) -> None:
    """Raise if any number of an index, the ends of slices included, is below zero."""
    for part in index if isinstance(index, tuple) else (index,):
        ends = (part.start, part.stop) if isinstance(part, slice) else (part,)
        if any(end is not None and end < 0 for end in ends):
            raise IndexError(f"a rule asks for index {index}")
