"""Programs as machine code of their own give what the rule gives, to the last bit."""

import time
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256

import jax.numpy as jnp
import numpy as np
import pytest

import hybrid as hy
from hybrid.lowering import automaton as tables
from hybrid.lowering import native
from hybrid.lowering.lowered import ORDER
from hybrid.lowering.scene import rest_name, scene_of
from hybrid.lowering.tape import linked
from hybrid.rules import unit
from hybrid.rules.code import DIGEST
from hybrid.rules.jets import FLOW
from hybrid.rules.lengths import LOW_ORDER
from hybrid.solvers.taylor_backend import HIGHEST

from .contract.ways import later
from .test_advance import Duffing
from .test_readers import EXPRESSIONS
from .test_tape import CLASSES, _jets, _modes


@pytest.fixture(autouse=True)
def new(monkeypatch, tmp_path):
    """No code is kept, neither by the process nor in files."""
    monkeypatch.setattr(native, "_MADE", {})
    monkeypatch.setattr(native, "folder", lambda: tmp_path / "programs")


#: Models whose programs take longest to compile, and have the operations of others.
LONG = ["BallOnCircle", "DippingCeiling", "Pile", "TwoWalls"]

NOW = [cls for cls in CLASSES if cls.__name__ not in LONG]
LATER = later(*(cls for cls in CLASSES if cls.__name__ in LONG))

#: Programs for values that are longer take most of the time to compile and have nothing new.
SHORT = 20


#: Numbers beside the series: more than the equations of any of the models take.
ROOM = 4096


def _read(programs, number, rows, state, sides, order):
    """All rows of a program along a motion, and the sides of its kinks."""
    t, x, motion = state
    c, work = np.full((rows, order + 1), 0.5), np.empty(ROOM)
    c[: len(x)] = motion[:, : order + 1]
    sides = sides.copy()
    status = unit("jets").jets(programs, number, order, t, x, sides, c, work)
    return status, c, sides


def _bits(c):
    """All of a number but the sign of what is none, which no operation looks at."""
    return np.where(np.isnan(c), np.nan, c).tobytes()


def _held(programs, number, size, draw, orders=(0, 1, 2, 5, LOW_ORDER, ORDER)):
    """Hold the code of a program to the rule, at random states."""
    begin, end = programs.index[number][:2]
    assert begin == end or programs.code[number]
    rows, kinks = 2 + programs.ops[:, 1].max(initial=size), programs.kinks.shape[0]
    for order in orders:
        x = draw.choice([draw.normal(size=size), np.zeros(size), np.arange(1.0, size + 1.0)])
        state = float(draw.uniform(-1, 2)), x, draw.normal(size=(size, ORDER + 1))
        sides = draw.integers(-1, 2, size=kinks)
        made = _read(programs, number, rows + 64, state, sides, order)
        other = programs._replace(code=np.zeros_like(programs.code))
        expected = _read(other, number, rows + 64, state, sides, order)
        assert made[0] == expected[0]
        assert _bits(made[1]) == _bits(expected[1])
        assert made[2].tolist() == expected[2].tolist()


@pytest.mark.parametrize("cls", [*NOW, *LATER], ids=lambda cls: cls.__name__)
def test_every_program_of_a_model_gives_the_bits_of_the_rule(cls):
    """Flows with their guards, contacts held, landings, impulses, at many orders."""
    scene, draw = scene_of(cls()), np.random.default_rng(0)
    own = tables.Tables(scene)
    for name in _modes(scene):
        own.number(scene.field(name))
    programs = own.automaton.programs
    for number, (begin, end, *_, flow, last) in enumerate(programs.index):
        if flow < last or end - begin < SHORT:
            native.compile_all(programs, [number])
            _held(programs, number, scene.spec.dimension, draw)


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_every_operation_gives_the_bits_of_the_rule(name):
    """Functions, powers, vectors and matrices, and kinks on all their sides; also where it is
    written out for an order, at that and at others."""
    programs, draw = linked([_jets(EXPRESSIONS[name])[1]]), np.random.default_rng(0)
    for order in (0, 5):
        native.compile_all(programs, order=order)
        for _ in range(4):
            _held(programs, 0, 2, draw)


@pytest.mark.parametrize("save", ["jumps", "dense"])
def test_a_long_run_is_the_same_with_its_own_machine_code_and_without(save, monkeypatch):
    """Jump by jump to the last bit, whenever the code is done."""
    start, span, options = {"x": 0.3, "v": 0.0}, (0.0, 300.0), {"solver": "taylor", "save": save}
    expected = hy.simulate(Duffing(), start, span, **options)
    scene = scene_of(Duffing())
    monkeypatch.setattr(tables, "HOT_STEPS", 0)
    monkeypatch.setattr(scene, "tables", tables.Tables(scene))
    made = hy.simulate(Duffing(), start, span, **options)
    native.compile_all(scene.tables.automaton.programs)
    own = hy.simulate(Duffing(), start, span, **options)
    native.compile_all(scene.tables.automaton.programs, order=HIGHEST)
    written = hy.simulate(Duffing(), start, span, **options)
    assert len(expected.jumps) > 100
    for run in (made, own, written):
        assert run.jumps.t.tobytes() == expected.jumps.t.tobytes()
        assert run.jumps.table.after.tobytes() == expected.jumps.table.after.tobytes()


def test_programs_are_compiled_behind_a_long_run():
    """One after another; while that goes on the rule reads them."""
    own = tables.Tables(scene_of(Duffing()))
    own.number(own.scene.field("flight"))
    programs = own.automaton.programs
    own.flown(tables.HOT_STEPS, ORDER)
    assert not programs.code.any()
    until = time.monotonic() + 60.0
    while not programs.code.all() and time.monotonic() < until:
        own.flown(1, ORDER)
        time.sleep(0.01)
    assert programs.code.all()


def test_programs_are_written_out_for_the_order_of_the_steps_that_are_many():
    """Those with a flow, of which alone series are made; other orders of few steps leave it so."""
    own = tables.Tables(scene_of(Duffing()))
    own.number(own.scene.field("flight"))
    programs = own.automaton.programs
    native.compile_all(programs)
    before = programs.code.tolist()
    own.flown(tables.HOT_ORDER_STEPS + 1, ORDER)
    until = time.monotonic() + 60.0
    while programs.code.tolist() == before and time.monotonic() < until:
        own.flown(1, ORDER)
        own.flown(1, 3)
        time.sleep(0.01)
    flows = programs.index[:, FLOW] < programs.index[:, FLOW + 1]
    changed = programs.code != before
    assert changed.any()
    assert not changed[~flows].any()
    draw = np.random.default_rng(0)
    for number in np.flatnonzero(changed):
        _held(programs, number, 2, draw)


def test_code_that_is_written_out_is_recalled_for_its_order():
    """By another process; for other orders that which is for all."""
    one = linked([_jets(lambda t, x, y: x * y - jnp.cos(t))[1]])
    found = {}
    for order in (0, 4):
        native.compile_all(one, order=order)
        found[order] = one.code.tolist()
    assert found[0] != found[4]
    for order in (4, 0, 5):
        native.recall(one, 0, order)
        assert one.code.tolist() == found[order if order == 4 else 0]


def test_what_has_been_compiled_is_kept_when_a_field_is_added():
    """The programs are joined anew."""
    own = tables.Tables(scene_of(Duffing()))
    own.number(own.scene.field("flight"))
    native.compile_all(own.automaton.programs)
    code = own.automaton.programs.code.tolist()
    own.number(own.scene.field(rest_name("flight", ("impact",))))
    assert own.automaton.programs.code[: len(code)].tolist() == code


def test_other_values_of_parameters_have_the_code_that_there_is():
    """Nothing is compiled, and nothing asked for."""
    one, other = (tables.Tables(scene_of(Duffing(r=r))) for r in (0.6, 0.5))
    one.number(one.scene.field("flight"))
    native.compile_all(one.automaton.programs)
    other.number(other.scene.field("flight"))
    assert other.automaton.programs.code.all()
    assert other.automaton.programs.code.tolist() == one.automaton.programs.code.tolist()


def test_another_process_has_the_code_at_once(monkeypatch):
    """It is kept in files, and gives the bits that the rule gives."""
    one = linked([_jets(lambda t, x, y: jnp.exp(-x) * y - jnp.cos(t))[1]])
    native.compile_all(one)
    monkeypatch.setattr(native, "_MADE", {})  # as in another process
    monkeypatch.setattr(native, "_compiled", None)
    other = one._replace(code=np.zeros_like(one.code))
    native.recall(other, 0)
    assert other.code.all()
    assert other.code.tolist() != one.code.tolist()
    _held(other, 0, 2, np.random.default_rng(0))


def test_a_file_that_is_no_code_is_passed_over(monkeypatch):
    """The program is compiled again; so is one that calls a function that is not there."""
    programs = linked([_jets(lambda t, x, y: x * y - jnp.sin(t))[1]])
    native.compile_all(programs)
    (file,) = native.folder().iterdir()
    code = file.read_bytes()
    _, _, machine = code[DIGEST:].partition(b"\n")
    missing = b"no_such_function\n" + machine
    for wrong in (b"", code[:-1], code + b"0", sha256(missing).digest() + missing):
        file.write_bytes(wrong)
        monkeypatch.setattr(native, "_MADE", {})
        native.recall(programs, 0)
        assert not programs.code.any()
    native._MADE.clear()
    file.write_bytes(code[:-1])
    native.compile_all(programs)
    assert programs.code.all()
    assert file.read_bytes() == code


def test_long_programs_and_plain_python_have_no_code(monkeypatch):
    """They are left to the rule."""
    programs = linked([_jets(lambda t, x, y: x * y + jnp.sin(t))[1]])
    monkeypatch.setattr(native, "_MADE", {})
    monkeypatch.setattr(native, "LONGEST_PROGRAM", 2)
    native.compile_all(programs)
    assert not programs.code.any()
    monkeypatch.setattr(native, "_MADE", {})
    monkeypatch.setattr(native, "LONGEST_PROGRAM", 64)
    native.compile_all(programs)
    assert programs.code.all()
    monkeypatch.setenv("HYBRID_RULES", "checked")
    native.compile_all(programs)
    assert not programs.code.any()
    native.recall(programs, 0)
    assert not programs.code.any()


def test_two_threads_that_ask_at_once_have_the_same_code():
    """What the other has made is let go: nobody may have its address."""
    programs = linked([_jets(lambda t, x, y: x * y - jnp.cos(t))[1]])
    content = programs.ops.tobytes(), programs.flow.tobytes(), 0
    with ThreadPoolExecutor(4) as pool:
        found = set(pool.map(lambda _: native.address(*content), range(4)))
    assert found == {native.address(*content)}
