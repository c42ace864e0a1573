"""Programs as machine code of their own, for runs that are long.

A rule reads a program operation by operation (:mod:`hybrid.rules.jets`). Here the text of one
operation, as LLVM has it from numba, is put in once for each of the program's with its numbers: all
that they decide falls away, and the lengths of loops are left. Nothing is contracted and nothing is
reckoned in another order, so that the code gives the bits that the rule gives
(``docs/notes/tape.md``). It is kept beside the rules' own, by the content of the operations, and
another process has it at once.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
import warnings
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..rules import library
from ..rules.arrays import Programs
from ..rules.code import binding, engine, machine, missing
from ..rules.jets import FLOW, OPS
from ..rules.operations import INTEGRAL

#: A longer program is left to the rule: an operation takes 5 to 10 ms to compile, so that a process
#: that ends never waits for a second.
LONGEST = 64

#: What an operation is given, by numba's names: its row, the arrays, and what makes up an array. As
#: no index is below zero, of all lengths that of the matrix's rows alone is looked at.
NUMBERS = tuple(f"arg.{name}" for name in ("op", "out", "a", "b", "d", "e"))
ARRAYS = ("more", "s", "sides", "c", "work")
PARTS = {"0": "null", "1": "null", "2": "0", "3": "8", "5.0": "0", "6.0": "8"}
GIVEN = {
    **dict.fromkeys(("retptr", "excinfo"), "%unused"),
    **{f"arg.{name}.{part}": value for name in ARRAYS for part, value in PARTS.items()},
    **{f"arg.{name}.4": f"%{name}" for name in ARRAYS},
    **{"arg.c.5.1": "%columns", "arg.c.6.0": "%stride", "arg.c.6.1": "8"},
}

#: The code of a program: for each order all its operations, then the next order of the states.
PROGRAM = """
declare i32 @{operation}({types})

define void @program(i64 %order, i64 %columns, {arrays}) {{
entry:
  %unused = alloca i64
  %stride = mul i64 %columns, 8
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


class Operation(NamedTuple):
    """One operation in LLVM's language.

    Attributes
    ----------
    name : str
    code : bytes
    arguments : list of (type, name)
        As numba has arranged them; an array is several.
    """

    name: str
    code: bytes
    arguments: list[tuple[str, str]]


class Native:
    """Has programs compiled behind a run, one after another.

    One at a time, so that a process that ends waits for one at most.
    """

    def __init__(self) -> None:
        self.asked = 0
        self._going: tuple[int, Future[int]] | None = None

    def go_on(self, programs: Programs) -> None:
        """Take up the code that is done, and ask for that of the next program."""
        if (going := self._going) is not None:
            number, code = going
            if not code.done():
                return
            programs.code[number] = code.result()
            self._going = None
        if self.asked < len(programs.code):
            code = _thread().submit(address, *_content(programs, self.asked))
            self._going = self.asked, code
            self.asked += 1


def compile_all(programs: Programs, numbers: Iterable[int] | None = None) -> None:
    """Compile programs now: all, or those with some numbers."""
    for number in range(len(programs.code)) if numbers is None else numbers:
        programs.code[number] = address(*_content(programs, number))


def recall(programs: Programs, first: int) -> None:
    """Take up code that there is, of other runs and processes, from a program on."""
    if library.how() == "machine":
        for number in range(first, len(programs.code)):
            programs.code[number] = (_known(_content(programs, number)) or NONE).address


@cache
def _thread() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, "hybrid-native")


#: What a program is known by.
Content = tuple[bytes, bytes]


def _content(programs: Programs, number: int) -> Content:
    """The operations of a program, and the places of its flow."""
    index = programs.index[number]
    ops, flow = (slice(*index[begin : begin + 2]) for begin in (OPS, FLOW))
    return programs.ops[ops].tobytes(), programs.flow[flow].tobytes()


class Code(NamedTuple):
    """Where a program's code is, and what owns it."""

    address: int
    owner: Any


#: What a program has that is left to the rule.
NONE = Code(0, None)

#: All code of the process, by the content of the programs.
_MADE: dict[Content, Code] = {}


def address(ops: bytes, flow: bytes) -> int:
    """Where the code of a program is, as long as the process lasts; 0: it is left to the rule."""
    if library.how() != "machine":
        return 0
    made = _known((ops, flow)) or _made((ops, flow))
    return _MADE.setdefault((ops, flow), made).address  # another thread may have been first


def _known(content: Content) -> Code | None:
    """The code of a program that has been compiled, here or in another process."""
    if content in _MADE:
        return _MADE[content]
    code = _kept(content)
    return _MADE.setdefault(content, code) if code else None


def _made(content: Content) -> Code:
    """Compile a program, if it is short enough, and keep the code."""
    ops, flow = (np.frombuffer(part, dtype=np.int64) for part in content)
    rows = ops.reshape(-1, 6).tolist()
    if len(rows) > LONGEST or (rule := operation()) is None:
        return NONE
    try:
        called, code = _compiled(rule, _text(rule, rows, flow.tolist()))
        made = _loaded(called, code)
    except RuntimeError as error:
        warnings.warn(f"LLVM makes no code of a model ({error})", stacklevel=2)
        return NONE
    _keep(content, called, code)
    return made


# -- files -----------------------------------------------------------------------------------


#: Bytes of the hash of a file's content.
DIGEST = 32


def folder() -> Path:
    """Where code is kept: what changes the rules, LLVM or the processor changes it."""
    return library.folder / "programs"


@cache
def _own() -> bytes:
    return Path(__file__).read_bytes()


def _name(content: Content) -> str:
    """The name of a program's file: a hash of all that the code depends on, the folder apart."""
    parts = (hashlib.sha256(part).digest() for part in (_own(), *content))
    return hashlib.sha256(b"".join(parts)).hexdigest()[:32]


def _kept(content: Content) -> Code | None:
    """The code in a program's file, if that is as it was written; LLVM does not look."""
    try:
        written = (folder() / _name(content)).read_bytes()
    except OSError:
        return None
    digest, body = written[:DIGEST], written[DIGEST:]
    if hashlib.sha256(body).digest() != digest:
        return None
    called, _, code = body.partition(b"\n")
    return _loaded(called.decode().split(), code)


def _keep(content: Content, called: Sequence[str], code: bytes) -> None:
    """Write a program's file, whole or not at all: a hash, the names of the functions that it
    calls in a line, and the code."""
    body = " ".join(called).encode() + b"\n" + code
    with contextlib.suppress(OSError):
        folder().mkdir(exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder(), delete=False) as draft:
            draft.write(hashlib.sha256(body).digest() + body)
        os.replace(draft.name, folder() / _name(content))


# -- text ------------------------------------------------------------------------------------


def _text(operation: Operation, rows: Sequence[Sequence[int]], flow: Sequence[int]) -> str:
    """A program in LLVM's language."""
    growth = [(INTEGRAL, i, place, 0, 0, 0) for i, place in enumerate(flow)]
    return PROGRAM.format(
        operation=operation.name,
        types=", ".join(kind for kind, _ in operation.arguments),
        arrays=", ".join(f"ptr noalias %{name}" for name in ARRAYS),
        first=_calls(operation, rows, "0"),
        flow=_calls(operation, growth, "0"),
        ops=_calls(operation, rows, "%k"),
        flows=_calls(operation, growth, "%k"),
    )


def _calls(operation: Operation, rows: Sequence[Sequence[int]], k: str) -> str:
    """Operations at one order."""
    lines = []
    for row in rows:
        values = {**GIVEN, **dict(zip(NUMBERS, row, strict=True)), "arg.k": k}
        given = ", ".join(f"{kind} {values[name]}" for kind, name in operation.arguments)
        lines.append(f"  call i32 @{operation.name}({given})")
    return "\n".join(lines)


# -- compiling -------------------------------------------------------------------------------


@cache
def operation() -> Operation | None:
    """The operation, as the loader of the rules keeps it; None where numba has it otherwise."""
    module = binding().parse_assembly(library.text("operation"))
    own = [f for f in module.functions if not f.is_declaration]
    if len(own) != 1:
        return None
    arguments = [(str(argument.type), argument.name) for argument in own[0].arguments]
    if {name for _, name in arguments} - {*GIVEN, *NUMBERS, "arg.k"}:
        return None
    for function in module.functions:
        if not function.is_declaration and function.name != own[0].name:
            function.linkage = "internal"
    own[0].add_function_attribute("alwaysinline")
    return Operation(own[0].name, module.as_bitcode(), arguments)


def _compiled(operation: Operation, text: str) -> tuple[list[str], bytes]:
    """The names of the functions that a program calls, and its code."""
    llvm = binding()
    module = llvm.parse_assembly(text)
    module.link_in(llvm.parse_bitcode(operation.code))
    for function in module.functions:
        if not function.is_declaration and function.name != "program":
            function.linkage = "internal"
    made_for = machine()
    _optimise(module, made_for)
    others = (f.name for f in module.functions if f.is_declaration)
    called = [name for name in others if not name.startswith("llvm.")]
    return called, made_for.emit_object(module)


def _loaded(called: Sequence[str], code: bytes) -> Code:
    """A program's code, put where it can run; none where it calls a function that is not there."""
    if missing(called):
        return NONE
    own = engine([code])
    return Code(int(own.get_function_address("program")), own)


def _optimise(module: Any, machine: Any) -> None:
    """Put the operations in, and simplify what is left; no loop is unrolled or made of vectors."""
    llvm = binding()
    options = llvm.create_pipeline_tuning_options(speed_level=1)
    options.loop_unrolling = options.loop_interleaving = False
    options.loop_vectorization = options.slp_vectorization = False
    builder = llvm.create_pass_builder(machine, options)
    first = llvm.create_new_module_pass_manager()
    first.add_always_inliner_pass()
    first.add_global_dead_code_eliminate_pass()
    first.run(module, builder)
    builder.getModulePassManager().run(module, builder)
