"""Machine code for single programs, for long runs.

A rule reads a program operation by operation (:mod:`hybrid.rules.jets`). Here the text of one
operation, as LLVM has it from numba, is put in once for each of the program's with its numbers: all
that they decide falls away, and the lengths of loops are left. For one order, that of a run's
steps, and that of its short flights the program may be written out, and no loop is left either.
Nothing is contracted and nothing is reckoned in another order, so that the code gives the bits that
the rule gives (``docs/notes/tape.md``). It is kept beside the rules' own, by the content of the
operations, and another process has it at once.
"""

from __future__ import annotations

import contextlib
import hashlib
import marshal
import warnings
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..rules import library
from ..rules.arrays import Programs
from ..rules.code import binding, engine, keep, kept, machine, missing
from ..rules.jets import FLOW, OPS
from ..rules.lengths import short_order
from ..rules.operations import INTEGRAL

#: A longer program is left to the rule: compiling takes 5 to 10 ms an operation, and a process that
#: ends should not wait more than a second.
LONGEST_PROGRAM = 64

#: Longer programs, and those without a flow, are not unrolled for an order: that takes 10 to 20 ms
#: an operation, and the code would exceed the processor's cache.
WRITTEN_OUT = 24

#: Arguments of an operation, by numba's names: its row, the arrays, and the parts of an array.
#: Indices are never negative, so the number of matrix rows is the only length that is read.
ROW_NUMBERS = ("out", "a", "b", "d", "e")
ARRAYS = ("more", "s", "sides", "c", "work")
ARRAY_PARTS = {"0": "null", "1": "null", "2": "0", "3": "8", "5.0": "0", "6.0": "8"}
GIVEN = {
    **dict.fromkeys(("retptr", "excinfo"), "%unused"),
    **{f"arg.{name}.{part}": value for name in ARRAYS for part, value in ARRAY_PARTS.items()},
    **{f"arg.{name}.4": f"%{name}" for name in ARRAYS},
    **{f"arg.{name}": f"%{name}" for name in (*ROW_NUMBERS, "k")},
    **{"arg.c.5.1": "%columns", "arg.c.6.0": "%stride", "arg.c.6.1": "8"},
}

#: Arguments of a specialised operation: numbers of its row, the order, and the arrays.
TAKES = ", ".join(f"i64 %{name}" for name in (*ROW_NUMBERS, "k", "columns", "stride"))
TAKES += "".join(f", ptr noalias %{name}" for name in ARRAYS)

#: A specialised operation, for order 0 and for higher orders.
OPERATION_TEXT = """
define void @first{op}({takes}) {{
  %unused = alloca i64
  call i32 @{operation}({first})
  ret void
}}
define void @later{op}({takes}) {{
  %unused = alloca i64
  %positive = icmp sgt i64 %k, 0
  call void @llvm.assume(i1 %positive)
  call i32 @{operation}({later})
  ret void
}}
"""

#: The code of a program: for each order all operations, then the next order of the states.
PROGRAM_TEXT = """
{declarations}
define void @program(i64 %order, i64 %columns, {arrays}) {{
entry:
  %stride = mul i64 %columns, 8
  br label %is{orders}
{written}
is0:
{first}
  %none = icmp slt i64 %order, 1
  br i1 %none, label %done, label %second
second:
{flow}
  br label %loop
loop:
  %k = phi i64 [1, %second], [%next, %more.orders]
{ops}
  %on = icmp slt i64 %k, %order
  br i1 %on, label %more.orders, label %done
more.orders:
{flows}
  %next = add nuw nsw i64 %k, 1
  br label %loop
done:
  ret void
}}
"""

#: What is written out for an order, the last of so many.
WRITTEN_TEXT = """
is{place}:
  %order{place} = icmp eq i64 %order, {order}
  %wide{place} = icmp eq i64 %columns, {columns}
  %both{place} = and i1 %order{place}, %wide{place}
  br i1 %both{place}, label %written{place}, label %is{next}
written{place}:
{calls}
  br label %done
"""


#: Passes that inline the operations, and those that simplify a program with loops. The code is as
#: fast as after all passes, in a quarter of their time.
INLINED = ("always_inliner", "global_dead_code_eliminate")
SIMPLIFIED = (*INLINED, "sroa", "simplify_cfg", "instruction_combine", "new_gvn", "simplify_cfg")


class Native:
    """Compiles programs in the background, one after another.

    At most one compilation is running, so a process that ends waits for at most one.

    Attributes
    ----------
    order : int
        The order for which programs are unrolled; 0 if none.
    """

    def __init__(self) -> None:
        self.order = self.asked = 0
        self._going: tuple[int, Future[int]] | None = None

    def go_on(self, programs: Programs, order: int = 0) -> None:
        """Install code that has been compiled, and start compiling the next program, unrolled for
        ``order`` unless that is 0."""
        if order and order != self.order:
            self.order, self.asked = order, 0
        if (going := self._going) is not None:
            number, code = going
            if not code.done():
                return
            programs.code[number] = code.result()
            self._going = None
        while self.asked < len(programs.code) and self._going is None:
            content = _content(programs, self.asked, self.order)
            if (known := _known(content)) is None:
                self._going = self.asked, _thread().submit(address, *content)
            else:
                programs.code[self.asked] = known.address
            self.asked += 1


def compile_all(programs: Programs, numbers: Iterable[int] | None = None, order: int = 0) -> None:
    """Compile the given programs (by default all) now, unrolled for ``order`` unless that is 0."""
    for number in range(len(programs.code)) if numbers is None else numbers:
        programs.code[number] = address(*_content(programs, number, order))


def recall(programs: Programs, first: int, order: int = 0) -> None:
    """Install existing code, of other runs or processes, for programs from number ``first`` on."""
    if library.how() == "machine":
        for number in range(first, len(programs.code)):
            contents = {_content(programs, number, given): None for given in (order, 0)}
            found = (code for content in contents if (code := _known(content)))
            programs.code[number] = next(found, NO_CODE).address


@cache
def _thread() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, "hybrid-native")


#: Key of a program's code: its operations, the rows of its flow, and the order for which it is
#: unrolled.
Content = tuple[bytes, bytes, int]


def _content(programs: Programs, number: int, order: int) -> Content:
    index = programs.index[number]
    ops, flow = (slice(*index[begin : begin + 2]) for begin in (OPS, FLOW))
    short = flow.start < flow.stop and ops.stop - ops.start <= WRITTEN_OUT
    written = order if short else 0
    return programs.ops[ops].tobytes(), programs.flow[flow].tobytes(), written


class Code(NamedTuple):
    """The address of a program's code, and the object that owns the memory."""

    address: int
    owner: Any


#: Stands for a program that is left to the rule.
NO_CODE = Code(0, None)

#: All code of this process, by program content.
_MADE: dict[Content, Code] = {}


def address(ops: bytes, flow: bytes, order: int) -> int:
    """The address of a program's code, valid in this process; 0 if the rule runs it."""
    if library.how() != "machine":
        return 0
    content = ops, flow, order
    made = _known(content) or _made(content)
    return _MADE.setdefault(content, made).address  # another thread may have been first


def _known(content: Content) -> Code | None:
    """Existing code of a program, compiled by this or another process; None if there is none."""
    if content in _MADE:
        return _MADE[content]
    code = _kept(content)
    return _MADE.setdefault(content, code) if code else None


def _made(content: Content) -> Code:
    """Compile a program, if it is short enough, and store its code on disk."""
    *arrays, order = content
    ops, flow = (np.frombuffer(part, dtype=np.int64) for part in arrays)
    rows = ops.reshape(-1, 6).tolist()
    if len(rows) > LONGEST_PROGRAM or (known := operations()) is None:
        return NO_CODE
    own = [known[code] for code in sorted({INTEGRAL, *(row[0] for row in rows)})]
    try:
        called, code = _compiled(own, _text(rows, flow.tolist(), order), order > 0)
        made = _loaded(called, code)
    except RuntimeError as error:
        warnings.warn(f"LLVM makes no code of a model ({error})", stacklevel=2)
        return NO_CODE
    _keep(_name(content), " ".join(called).encode() + b"\n" + code)
    return made


# -- files -----------------------------------------------------------------------------------


def folder() -> Path:
    """The folder for code; it changes with the rules, LLVM and the processor."""
    return library.folder / "programs"


@cache
def _own() -> bytes:
    return Path(__file__).read_bytes()


def _name(content: Content) -> str:
    """The file name of a program: a hash of the code's inputs, the folder's excepted."""
    *arrays, order = content
    parts = (hashlib.sha256(part).digest() for part in (_own(), *arrays, b"%d" % order))
    return hashlib.sha256(b"".join(parts)).hexdigest()[:32]


def _kept(content: Content) -> Code | None:
    """The code in a program's file, which holds a line of called names and the object code."""
    if (body := _read(_name(content))) is None:
        return None
    called, _, code = body.partition(b"\n")
    return _loaded(called.decode().split(), code)


def _read(name: str) -> bytes | None:
    """The intact content of a file; None if it is missing or damaged."""
    with contextlib.suppress(OSError):
        return kept(folder() / name)
    return None


def _keep(name: str, body: bytes) -> None:
    """Write a file if possible."""
    with contextlib.suppress(OSError):
        folder().mkdir(exist_ok=True)
        keep(folder() / name, body)


# -- text ------------------------------------------------------------------------------------


def _text(rows: Sequence[Sequence[int]], flow: Sequence[int], order: int) -> str:
    """A program as LLVM text."""
    growth = [(INTEGRAL, i, place, 0, 0, 0) for i, place in enumerate(flow)]
    codes = {row[0] for row in (*rows, *growth)}
    names = [f"{when}{code}" for code in codes for when in ("first", "later")]
    orders = sorted({order, short_order(order)}) if order else []
    written = (_written(rows, growth, *each) for each in enumerate(orders, 1))
    return PROGRAM_TEXT.format(
        declarations="\n".join(f"declare void @{name}({TAKES})" for name in names),
        arrays=", ".join(f"ptr noalias %{name}" for name in ARRAYS),
        orders=len(orders),
        written="\n".join(written),
        first=_calls(rows, 0),
        flow=_calls(growth, 0),
        ops=_calls(rows, "%k"),
        flows=_calls(growth, "%k"),
    )


def _written(
    rows: Sequence[Sequence[int]], growth: Sequence[Sequence[int]], place: int, order: int
) -> str:
    """A program at all orders up to one."""
    wide = order + 1
    calls = [
        _calls(each, k, str(wide), str(8 * wide))
        for k in range(wide)
        for each in ((rows, growth) if k < order else (rows,))
    ]
    given = {"place": place, "next": place - 1, "order": order, "columns": wide}
    return WRITTEN_TEXT.format(calls="\n".join(calls), **given)


def _calls(
    rows: Sequence[Sequence[int]], k: int | str, columns: str = "%columns", stride: str = "%stride"
) -> str:
    """Calls of all operations at one order."""
    when = "first" if k == 0 else "later"
    arrays = ", ".join(f"ptr %{name}" for name in ARRAYS)
    lines = []
    for code, *numbers in rows:
        given = ", ".join(f"i64 {value}" for value in (*numbers, k, columns, stride))
        lines.append(f"  call void @{when}{code}({given}, {arrays})")
    return "\n".join(lines)


# -- compiling -------------------------------------------------------------------------------


@cache
def operations() -> Sequence[bytes] | None:
    """Bitcode of each operation, specialised to its code.

    None if numba's argument layout is not the expected one. The dispatch between operations is thus
    optimised away once, not in every program.
    """
    name = "operations-" + hashlib.sha256(_own()).hexdigest()[:32]
    if (known := _read(name)) is not None:
        return marshal.loads(known)  # type: ignore[no-any-return]
    if (made := _taken_apart()) is not None:
        _keep(name, marshal.dumps(made))
    return made


def _taken_apart() -> list[bytes] | None:
    """Specialise the operation stored by the rules' loader to each operation code."""
    llvm = binding()
    module = llvm.parse_assembly(library.text("operation"))
    own = [f for f in module.functions if not f.is_declaration]
    if len(own) != 1:
        return None
    name, arguments = own[0].name, [(str(a.type), a.name) for a in own[0].arguments]
    if {each for _, each in arguments} - {*GIVEN, "arg.op"}:
        return None
    types = ", ".join(kind for kind, _ in arguments)
    text = [f"declare i32 @{name}({types})\ndeclare void @llvm.assume(i1)"]
    for code in range(INTEGRAL + 1):
        first, later = (
            ", ".join(
                f"{kind} {({**GIVEN, 'arg.op': code, **also})[each]}" for kind, each in arguments
            )
            for also in ({"arg.k": "0"}, {})
        )
        given = {"op": code, "takes": TAKES, "operation": name, "first": first, "later": later}
        text.append(OPERATION_TEXT.format(**given))
    for function in _defined(module):
        if function.name != name:
            function.linkage = "internal"
    own[0].add_function_attribute("alwaysinline")
    apart = llvm.parse_assembly("\n".join(text))
    apart.link_in(module)
    for function in _defined(apart):
        if not function.name.startswith(("first", "later")):
            function.linkage = "internal"
    made_for = machine()
    _optimise(apart, made_for)
    for function in _defined(apart):
        function.add_function_attribute("alwaysinline")
    return [_alone(apart, code, made_for) for code in range(INTEGRAL + 1)]


def _alone(apart: Any, code: int, made_for: Any) -> bytes:
    """A module with one specialised operation."""
    own = apart.clone()
    for function in _defined(own):
        if function.name not in (f"first{code}", f"later{code}"):
            function.linkage = "internal"
    _passed(own, made_for, ("global_dead_code_eliminate", "strip_dead_prototype"))
    return bytes(own.as_bitcode())


def _defined(module: Any) -> list[Any]:
    return [function for function in module.functions if not function.is_declaration]


def _compiled(operations: Sequence[bytes], text: str, written: bool) -> tuple[list[str], bytes]:
    """Names of the external functions that a program calls, and its object code."""
    llvm = binding()
    module = llvm.parse_assembly(text)
    for operation in operations:
        module.link_in(llvm.parse_bitcode(operation))
    for function in _defined(module):
        if function.name != "program":
            function.linkage = "internal"
    made_for = machine()
    if written:
        _optimise(module, made_for, True)
    else:
        _passed(module, made_for, SIMPLIFIED)
    others = (f.name for f in module.functions if f.is_declaration)
    called = [name for name in others if not name.startswith("llvm.")]
    return called, made_for.emit_object(module)


def _loaded(called: Sequence[str], code: bytes) -> Code:
    """Load object code; :data:`NO_CODE` if it calls a function that is missing."""
    if missing(called):
        return NO_CODE
    own = engine([code])
    return Code(int(own.get_function_address("program")), own)


def _optimise(module: Any, machine: Any, unrolls: bool = False) -> None:
    """Inline and simplify, without vectorisation; unroll loops of known length on request."""
    llvm = binding()
    options = llvm.create_pipeline_tuning_options(speed_level=1)
    options.loop_unrolling, options.loop_interleaving = unrolls, False
    options.loop_vectorization = options.slp_vectorization = False
    _passed(module, machine, INLINED)
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)


def _passed(module: Any, machine: Any, passes: Iterable[str]) -> None:
    """Run some LLVM passes over a module."""
    llvm = binding()
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options())
    manager = llvm.create_new_module_pass_manager()
    for name in passes:
        getattr(manager, f"add_{name}_pass")()
    manager.run(module, builder)
