"""Processes of workers: forked from one of ours that has loaded what they need, else spawned.

The server that Python forks the program's own processes from is left alone: what is born of ours
has our imports, libraries of one thread, and no ear for Ctrl-C.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from types import FunctionType, SimpleNamespace
from typing import Any

from planewise.errors import PlanewiseError
from planewise.runtime.forks import in_child, lock_of_module

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")

Serve = Callable[[Connection], None]

_STARTING = lock_of_module()  # one at a time: the environment is the whole process's

if sys.platform == "linux":
    from multiprocessing import context, forkserver, popen_forkserver

    class _Server(forkserver.ForkServer):
        def __init__(self) -> None:
            super().__init__()
            self.set_forkserver_preload(["planewise.batch.preload"])

    _server = _Server()
    in_child(_server.__init__)  # type: ignore[misc]  # there it is the parent's
    _names = {
        **vars(popen_forkserver),
        "forkserver": SimpleNamespace(
            connect_to_new_process=_server.connect_to_new_process,
            read_signed=forkserver.read_signed,
        ),
    }

    class _Popen(popen_forkserver.Popen):
        # What it does anyway, but with our server.
        _launch = FunctionType(vars(popen_forkserver.Popen)["_launch"].__code__, _names)

    class Process(context.ForkServerProcess):
        """A process that is forked from our server."""

        @staticmethod
        def _Popen(process_obj: BaseProcess) -> Any:  # noqa: N802
            return _Popen(process_obj)

else:  # where it is not safe to fork
    from multiprocessing.context import SpawnProcess as Process


def started(serve: Serve, end: Connection) -> BaseProcess:
    """Start a worker, once more where the process that it is forked from was killed.

    Raises
    ------
    PlanewiseError
        If none can be started.
    """
    if sys.platform != "win32":
        resource_tracker.ensure_running()  # which ends by letting Ctrl-C through
    for last in (False, True):
        process = Process(target=serve, args=(end,), daemon=True)
        try:
            with _STARTING, _one_thread(), _no_interrupts():
                process.start()
            break
        except (EOFError, OSError) as error:
            if last:
                raise PlanewiseError(
                    f"workers: none can be started ({type(error).__name__})"
                ) from None
    return process


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Keep libraries of the worker from starting threads of their own."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextlib.contextmanager
def _no_interrupts() -> Iterator[None]:
    """Let a process start deaf to Ctrl-C, which its imports could not answer well."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
