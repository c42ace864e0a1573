"""Calls of one function for many numbers: in this process and, if that takes long, in others.

This process calls the function for numbers from the front of a queue while the others start; they
take blocks from its end. Each is a new Python process, not a fork (JAX's threads would not survive
one). It does not import the main program, since a script without a guard ``if __name__ ==
"__main__"`` would then run again. Classes and functions that are sent must therefore be defined in
a module, which may have been imported by its path. The first answer of a process is compared with
a known one before others are accepted.
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

#: One process is started for each so many seconds of calls left, at the pace so far. It needs two
#: or three seconds of processor time until its first answer (imports, preparation, compilation).
PAYS = 8.0

#: Duration of a block of calls in seconds, and its largest size as a share of one process's part of
#: the calls left: all processes then end at about the same time.
BLOCK_SECONDS, BLOCK_SHARE = 0.5, 0.5

#: The program of a process.
CODE = "from hybrid.ensembles.processes import serve; serve()"

#: Keyboard interrupts reach this process only; it ends the others.
NEW_SESSION: dict[str, Any] = {"start_new_session": True}
if sys.platform == "win32":
    NEW_SESSION = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}

Call = Callable[[int], Any]


class Unfit(HybridError):
    """Another process cannot answer, or answers differently from this one."""


class Shared:
    """Results of a function for many numbers, computed in several processes.

    Parameters
    ----------
    call : callable ``(number)``
        The function.
    numbers : iterable of int
    job : callable
        Returns a callable, and its arguments, that makes the function in another process.
    same : callable ``(result, result)``
        Whether two results are equal.
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
        self.received: SimpleQueue[tuple[list[int], list[Any], Exception | None]] = SimpleQueue()
        self.threads: list[Thread] = []
        self.running = 0
        self.pace = 0.0

    def answers(self) -> Generator[tuple[int, Any]]:
        """Yield pairs (number, result of the function), in any order.

        Raises
        ------
        Exception
            Any exception of the function, in this process or in another one.
        """
        begun, made = None, 0
        try:
            while self.left or self.running:
                number = _take(self.left, False)
                for each in number:
                    answer = self.call(each)
                    if begun is None:  # the first call also compiles: it is not timed
                        begun = perf_counter()
                    else:
                        made += 1
                        self.pace = (perf_counter() - begun) / made
                    self._hire(each, answer)
                    yield each, answer
                yield from self._collect(wait=not number)
        finally:
            self._end()

    def _hire(self, number: int, answer: Any) -> None:
        """Start processes if the calls left take long enough; once only."""
        count = min(cores() - 1, int(self.pace * len(self.left) / PAYS))
        if count < 1 or self.crew is not None:
            return
        self.crew = []
        try:
            job = _pickled((self.job(), number))
            for _ in range(count):
                self.crew.append(_Process(job))
        except (pickle.PicklingError, AttributeError, TypeError, OSError) as fault:
            _warn(f"{fault}; what stands in a module can be sent to {count} of them")
        for process in self.crew:
            self.threads.append(Thread(target=self._feed, args=(process, answer), daemon=True))
            self.threads[-1].start()
            self.running += 1
        logging.getLogger(__name__).info("%d processes beside this one", len(self.crew))

    def _feed(self, process: _Process, known: Any) -> None:
        """Send blocks of numbers to a process until none are left; runs in a thread. ``known`` is
        the result with which its first one is compared."""
        block: list[int] = []
        fault: Exception | None = None
        try:
            if not self.same(process.answer(), known):
                raise Unfit("another process gives another answer")
            while block := self._block():
                process.ask(block)
                self.received.put((block, process.answer(), None))
        except Exception as raised:
            fault = raised
        process.end()
        self.received.put(([], block, fault))

    def _block(self) -> list[int]:
        """Numbers from the end of the queue, for one process."""
        fair = BLOCK_SHARE * len(self.left) / (1 + self.running)
        block: list[int] = []
        while len(block) < max(1.0, min(fair, BLOCK_SECONDS / self.pace)) and self.left:
            block += _take(self.left, True)
        return block

    def _collect(self, wait: bool) -> Iterator[tuple[int, Any]]:
        """Yield the results that other processes have sent; if ``wait``, wait for the first."""
        while self.running and (wait or not self.received.empty()):
            numbers, answers, fault = self.received.get()
            wait = False
            if numbers:
                yield from zip(numbers, answers, strict=True)
                continue
            self.running -= 1
            if isinstance(fault, Unfit):
                self.left.extend(answers)  # numbers of the block without results
                _warn(str(fault))
            elif fault is not None:
                raise fault

    def _end(self) -> None:
        for process in self.crew or ():
            process.process.kill()
        for thread in self.threads:
            thread.join()


class _Process:
    """Another Python process, to which a job and the number of a first call are sent."""

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
        """Send numbers for which the process is to call the function."""
        self._send(pickle.dumps(numbers))

    def answer(self) -> Any:
        """The results for the numbers sent last; at first, that of the first call.

        Raises
        ------
        Unfit
            If the process has ended, or cannot make the function.
        Exception
            Any exception of the function.
        """
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
        """End the process, and wait until it has ended."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with suppress(OSError):  # the process has not read all that was written
                    pipe.close()


def serve() -> None:
    """The main loop of a process: call the function for the numbers received, until the pipe from
    the parent process is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers, asked = os.fdopen(os.dup(1), "wb"), sys.stdin.buffer
    os.dup2(2, 1)  # so that text printed by a model is not taken for an answer

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


def _take(left: deque[int], last: bool) -> list[int]:
    """Remove the last or first number of a queue; an empty list if another thread was faster."""
    try:
        return [left.pop() if last else left.popleft()]
    except IndexError:
        return []


def _sendable(fault: Exception) -> Exception:
    """An exception that can be pickled, in place of ``fault``, with a note of its traceback."""
    said = "".join(traceback.format_exception(fault))
    try:
        fault = pickle.loads(pickle.dumps(fault))
    except Exception:
        fault = RuntimeError(f"{type(fault).__name__}: {fault}")
    fault.add_note(f"In another process:\n\n{said}")
    return fault


class _Pickler(pickle.Pickler):
    """Raises an error for classes and functions of the main program, which another process cannot
    import. ``files`` are the paths of modules that it cannot import by name."""

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
    """Two pickles: paths of modules to import first, and ``what``."""
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


def _warn(why: str) -> None:
    """Warn that there are fewer processes."""
    warnings.warn(f"hybrid goes on without another process: {why}", stacklevel=2)
