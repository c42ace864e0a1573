"""Machine code as it is kept in files, and put where it can run (:mod:`.calls` calls it).

numba compiles the rules and does no more: to import it, and to have it load what it keeps itself,
takes longer than most runs. What is kept of a rule is its object file, the symbol under which it
stands there, and the kinds of its arguments and of its result. A kind is an annotation or, of a
tuple with names, its name and the kinds of its parts.
"""

from __future__ import annotations

import hashlib
import marshal
import os
import tempfile
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

#: Numbers, as they are to LLVM; and the axes of arrays.
LLVM_TYPES = {"float": "double", "int": "i64", "bool": "i8"}
AXES = {"Floats": 1, "Matrix": 2, "Ints": 1, "Table": 2}

#: What Python calls of a rule: ``args`` has eight bytes for each number, for the address of the
#: struct of a tuple, and for what makes up an array: its length, where it is, its axes and strides.
#: Two more, which own it, and the size of an element are put in here.
ENTRY = """
declare i32 @{symbol}({types})

define i32 @{symbol}.entry(ptr %out, ptr %args) {{
  %error = alloca ptr
{lines}
  %status = call i32 @{symbol}(ptr %out, ptr %error, {given})
  ret i32 %status
}}
"""

#: Bytes of the hash of a file's content.
DIGEST = 32

Kind = Any


class Rule(NamedTuple):
    """A rule as it is kept.

    Attributes
    ----------
    name, symbol : str
        By which it is called, and what stands in the object file.
    kinds : tuple
    result : str or tuple of str
        Kinds of the numbers that it returns; none where it returns nothing.
    needs : tuple of str
        Functions that it calls, of other rules or of the system.
    code : bytes
    """

    name: str
    symbol: str
    kinds: tuple[Kind, ...]
    result: Any
    needs: tuple[str, ...]
    code: bytes


class Unit(NamedTuple):
    """What is kept of a file: the files that it calls, and its rules."""

    calls: tuple[str, ...]
    rules: tuple[Rule, ...]


# -- files ----------------------------------------------------------------------------------


def keep(path: Path, body: bytes) -> None:
    """Write a file, whole or not at all, with a hash before its content."""
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as draft:
        draft.write(hashlib.sha256(body).digest() + body)
    os.replace(draft.name, path)


def kept(path: Path) -> bytes:
    """The content of such a file.

    Raises
    ------
    OSError
        If it is not as it was written: LLVM does not look.
    """
    written = path.read_bytes()
    digest, body = written[:DIGEST], written[DIGEST:]
    if hashlib.sha256(body).digest() != digest:
        raise OSError(f"{path} is damaged: remove it, and it is made again")
    return body


def write(path: Path, unit: Unit) -> None:
    """Write a unit's file."""
    keep(path, marshal.dumps((unit.calls, tuple(map(tuple, unit.rules)))))


def read(path: Path) -> Unit:
    """A unit's file; errors as for :func:`kept`."""
    calls, rules = marshal.loads(kept(path))
    return Unit(calls, tuple(Rule(*rule) for rule in rules))


# -- LLVM -----------------------------------------------------------------------------------


@cache
def binding() -> Any:
    """LLVM, ready to make code for this machine."""
    from llvmlite import binding

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding


@cache
def processor() -> tuple[str, str]:
    """The name of this processor, and what it can do."""
    llvm = binding()
    return llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()


def machine() -> Any:
    """What makes code for this machine."""
    triple = binding().Target.from_default_triple()
    return triple.create_target_machine(*processor(), opt=1, jit=True)


def engine(codes: Iterable[bytes]) -> Any:
    """Object files put where they can run, as long as this lives; what they call must be there."""
    llvm = binding()
    made = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine())
    for code in codes:
        made.add_object_file(llvm.ObjectFileRef.from_data(code))
    made.finalize_object()
    return made


def missing(needs: Iterable[str]) -> list[str]:
    """Those functions that are not in this process."""
    llvm = binding()
    return [name for name in needs if llvm.address_of_symbol(name) is None]


class Placed(NamedTuple):
    """A rule where it can run, as long as its owner lives; and what Python calls of it."""

    rule: Rule
    entry: int
    owner: Any


@cache
def placed(path: Path) -> tuple[Placed, ...]:
    """The rules of a file, and before them what they call, put where they can run.

    Each has a name in this process under which others call it (:func:`symbol`).

    Raises
    ------
    ImportError
        If a function that they call is not in this process.
    """
    unit = read(path)
    for called in unit.calls:
        placed(path.with_name(called + path.suffix))
    if absent := missing(name for rule in unit.rules for name in rule.needs):
        raise ImportError(f"the rules {path.stem!r} call {', '.join(absent)}: not in this process")
    own = engine(rule.code for rule in unit.rules)
    found = []
    for rule in unit.rules:
        binding().add_symbol(symbol(path, rule.name), own.get_function_address(rule.symbol))
        found.append(Placed(rule, own.get_function_address(f"{rule.symbol}.entry"), own))
    return tuple(found)


def symbol(path: Path, name: str) -> str:
    """The symbol of a rule."""
    return f"{path.parent.name}.{path.stem}.{name}"


# -- entries --------------------------------------------------------------------------------


def entry(symbol: str, kinds: Sequence[Kind]) -> str:
    """What Python calls of a rule, in LLVM's language."""
    lines: list[str] = []
    given: list[str] = []
    for kind in kinds:
        if isinstance(kind, str) and kind in AXES:
            read = ["i64", "ptr", *["i64"] * (2 * AXES[kind])]
            size, *rest = [_read(of, lines) for of in read]
            given += ["ptr null", "ptr null", size, "i64 8", *rest]
        else:
            given.append(_read(LLVM_TYPES[kind] if isinstance(kind, str) else "ptr", lines))
    types = ", ".join(["ptr", "ptr", *(value.split()[0] for value in given)])
    return ENTRY.format(symbol=symbol, types=types, lines="\n".join(lines), given=", ".join(given))


def _read(kind: str, lines: list[str]) -> str:
    """The next of the arguments."""
    place = len(lines) // 2
    lines.append(f"  %place{place} = getelementptr i64, ptr %args, i64 {place}")
    lines.append(f"  %value{place} = load {kind}, ptr %place{place}")
    return f"{kind} %value{place}"
