"""One function called for many numbers, in this process and, where that takes long, in others.

This process goes on calling from the front of the line while the others start; they take blocks
from its end. Each is a Python of its own, not a fork (JAX's threads would not survive one), and
does not import the main program: a script that is not guarded by its name would begin anew there.
So what is sent must stand in a module, which may have been imported by its path. Before a process
is believed it gives an answer that is known.
"""

from __future__ import annotations

import io
import logging
import os
import pickle
import signal
import subprocess
import sys
import traceback
import types
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import suppress
from importlib.machinery import PathFinder
from importlib.util import module_from_spec, spec_from_file_location
from queue import SimpleQueue
from threading import Thread
from time import perf_counter
from typing import Any

from ..errors import HybridError
from .cores import cores

#: Seconds of calls left, at the pace so far, for which one more process is started: it takes two or
#: three of a processor until its first answer (to import, to make a model ready, to compile).
PAYS = 8.0

#: Seconds of a block, and the share of what is left that it is at most, for each that calls: so
#: that all end together.
BLOCK_SECONDS, BLOCK_SHARE = 0.5, 0.5

#: What a process runs.
CODE = "from hybrid.ensembles.processes import serve; serve()"

#: Interrupts from the keyboard are for this process; it ends the others.
NEW_SESSION: dict[str, Any] = {"start_new_session": True}
if sys.platform == "win32":
    NEW_SESSION = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}

Call = Callable[[int], Any]


class Unfit(HybridError):
    """Another process cannot answer, or not as this one."""


class Shared:
    """Answers of a function.

    Parameters
    ----------
    call : callable ``(number)``
    numbers : iterable of int
    job : callable
        Gives what makes the function in another process: a callable, and its arguments.
    same : callable
        Whether two answers are the same.
    """

    def __init__(
        self,
        call: Call,
        numbers: Iterable[int],
        job: Callable[[], tuple[Any, ...]],
        same: Callable[[Any, Any], bool],
    ) -> None:
        self.call, self.left, self.job, self.same = call, deque(numbers), job, same
        self.crew: list[_Process] | None = None
        self.told: SimpleQueue[tuple[list[int], list[Any], Exception | None]] = SimpleQueue()
        self.threads: list[Thread] = []
        self.running = 0
        self.pace = 0.0

    def answers(self) -> Generator[tuple[int, Any]]:
        """Numbers and answers, in any order.

        Raises
        ------
        Exception
            What the function raises, here or in another process.
        """
        begun, made = None, 0
        try:
            while self.left or self.running:
                number = _taken(self.left, False)
                for each in number:
                    answer = self.call(each)
                    if begun is None:  # the first call makes ready what all need
                        begun = perf_counter()
                    else:
                        made += 1
                        self.pace = (perf_counter() - begun) / made
                    self._hire(each, answer)
                    yield each, answer
                yield from self._come(wait=not number)
        finally:
            self._end()

    def _hire(self, number: int, answer: Any) -> None:
        """Start processes where that pays."""
        count = min(cores() - 1, int(self.pace * len(self.left) / PAYS))
        if count < 1 or self.crew is not None:
            return
        self.crew = []
        try:
            job = _pickled((self.job(), number))
            for _ in range(count):
                self.crew.append(_Process(job))
        except (pickle.PicklingError, AttributeError, TypeError, OSError) as fault:
            _say(f"{fault}; what stands in a module can be sent to {count} of them")
        for process in self.crew:
            self.threads.append(Thread(target=self._feed, args=(process, answer), daemon=True))
            self.threads[-1].start()
            self.running += 1
        logging.getLogger(__name__).info("%d processes beside this one", len(self.crew))

    def _feed(self, process: _Process, known: Any) -> None:
        """Let a process answer, as long as there is something to ask."""
        block: list[int] = []
        fault: Exception | None = None
        try:
            if not self.same(process.answer(), known):
                raise Unfit("another process gives another answer")
            while block := self._block():
                process.ask(block)
                self.told.put((block, process.answer(), None))
        except Exception as raised:
            fault = raised
        process.end()
        self.told.put(([], block, fault))

    def _block(self) -> list[int]:
        """Numbers from the end of the line."""
        fair = BLOCK_SHARE * len(self.left) / (1 + self.running)
        block: list[int] = []
        while len(block) < max(1.0, min(fair, BLOCK_SECONDS / self.pace)) and self.left:
            block += _taken(self.left, True)
        return block

    def _come(self, wait: bool) -> Iterator[tuple[int, Any]]:
        """Answers of other processes that have come; one of them is waited for."""
        while self.running and (wait or not self.told.empty()):
            numbers, answers, fault = self.told.get()
            wait = False
            if numbers:
                yield from zip(numbers, answers, strict=True)
                continue
            self.running -= 1
            if isinstance(fault, Unfit):
                self.left.extend(answers)  # the numbers asked last
                _say(str(fault))
            elif fault is not None:
                raise fault

    def _end(self) -> None:
        for process in self.crew or ():
            process.process.kill()
        for thread in self.threads:
            thread.join()


class _Process:
    """Another Python, which has been sent a job and the number of a call."""

    def __init__(self, job: bytes) -> None:
        path = os.pathsep.join(map(os.path.abspath, sys.path))
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(
            [sys.executable or "python", "-P", "-c", CODE],
            stdin=pipe,
            stdout=pipe,
            env={**os.environ, "PYTHONPATH": path},
            **NEW_SESSION,
        )
        self.job: bytes | None = job

    def ask(self, numbers: list[int]) -> None:
        """Ask for the answers to some numbers."""
        self._send(pickle.dumps(numbers))

    def answer(self) -> Any:
        """What has been asked."""
        if self.job is not None:
            job, self.job = self.job, None
            self._send(job)
        assert self.process.stdout is not None
        try:
            said, answer = pickle.load(self.process.stdout)
        except (EOFError, pickle.UnpicklingError):
            raise Unfit("another process has ended") from None
        if said == "unfit":
            raise Unfit(f"another process cannot do it ({answer})")
        if said == "fault":
            raise answer
        return answer

    def _send(self, what: bytes) -> None:
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(what)
            self.process.stdin.flush()
        except OSError:
            raise Unfit("another process has ended") from None

    def end(self) -> None:
        """End it, and wait until it has."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with suppress(OSError):  # what was written last has not been read
                    pipe.close()


def serve() -> None:
    """Answer what the process asks that has started this one, until it asks no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers, asked = os.fdopen(os.dup(1), "wb"), sys.stdin.buffer
    os.dup2(2, 1)  # what a model prints is no answer

    def tell(*what: Any) -> None:
        answers.write(pickle.dumps(what))
        answers.flush()

    try:
        for name, file in pickle.load(asked).items():
            _import(name, file)
        (make, *given), number = pickle.load(asked)
        call = make(*given)
        first = call(number)
    except Exception as fault:
        tell("unfit", f"{type(fault).__name__}: {fault}")
        return
    tell("answer", first)
    while True:
        try:
            numbers = pickle.load(asked)
        except EOFError:
            return
        try:
            tell("answer", [call(number) for number in numbers])
        except Exception as fault:
            tell("fault", _sendable(fault))


def _taken(left: deque[int], last: bool) -> list[int]:
    """The number at one end of the line, if there is one: another thread may have been faster."""
    try:
        return [left.pop() if last else left.popleft()]
    except IndexError:
        return []


def _sendable(fault: Exception) -> Exception:
    """An error that another process can be sent, with the place where it was raised."""
    said = "".join(traceback.format_exception(fault))
    try:
        fault = pickle.loads(pickle.dumps(fault))
    except Exception:
        fault = RuntimeError(f"{type(fault).__name__}: {fault}")
    fault.add_note(f"In another process:\n\n{said}")
    return fault


class _Pickler(pickle.Pickler):
    """Refuses what another process would not find; ``files`` are those of modules that it would
    not find by their names."""

    def __init__(self, written: io.BytesIO) -> None:
        super().__init__(written)
        self.files: dict[str, str] = {}

    def reducer_override(self, given: Any) -> Any:
        if isinstance(given, type | types.FunctionType):
            self._note(given)
        return NotImplemented

    def _note(self, given: type | types.FunctionType) -> None:
        name = given.__module__
        if name == "__main__":
            raise pickle.PicklingError(f"{given.__qualname__} is defined in the main program")
        file = getattr(sys.modules.get(name), "__file__", None)
        if file is not None and "." not in name and PathFinder.find_spec(name) is None:
            self.files[name] = file


def _pickled(what: Any) -> bytes:
    written = io.BytesIO()
    pickler = _Pickler(written)
    pickler.dump(what)
    return pickle.dumps(pickler.files) + written.getvalue()


def _import(name: str, file: str) -> None:
    """Import a module by its path."""
    spec = spec_from_file_location(name, file)
    if spec is not None and spec.loader is not None:
        sys.modules[name] = module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])


def _say(why: str) -> None:
    """Say why there are fewer processes."""
    warnings.warn(f"hybrid goes on without another process: {why}", stacklevel=2)
