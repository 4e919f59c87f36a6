"""Ctrl-C, and what ends processes politely, end a command wherever they come."""

from __future__ import annotations

import _thread
import math
import signal
import sys
import time
from types import FrameType
from typing import TYPE_CHECKING

from planewise.commands.exit_codes import INTERRUPTED

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

_CALLBACKS = "_raw_object_cache_"  # of llvmlite: LLVM calls them after each loop it has compiled
_PAUSE = 0.02  # seconds, after which what would drop an exception is most likely over
_ENDING = 2.0  # seconds that a command has to tidy up, undisturbed by a second Ctrl-C
_raised: list[float] = []  # times of interrupts, -inf of what Python dropped


def heed_interrupts() -> None:
    """Have Ctrl-C wait, or come again, where Python would drop it; SIGTERM and SIGHUP be as it.

    It is dropped in callbacks from C, after which Numba would miss what they were to do, and in
    what deletes objects. Schedulers and containers send SIGTERM, a terminal that is closed SIGHUP,
    and both would leave files behind.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupt)
    for name in ("SIGTERM", "SIGHUP"):
        signum = getattr(signal, name, None)  # Windows has no SIGHUP
        if signum is not None and signal.getsignal(signum) is signal.SIG_DFL:
            signal.signal(signum, interrupt)
    sys.unraisablehook = _repeat_interrupt


def interrupt(signum: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, as a handler of signals, now or as soon as it will be seen.

    A command that is ending is left to tidy up.
    """
    if _raised and time.monotonic() - _raised[-1] < _ENDING:
        return
    outer = frame
    while outer is not None:
        if outer.f_code.co_name.startswith(_CALLBACKS):
            _interrupt_later()
            return
        outer = outer.f_back
    _raised.append(time.monotonic())
    signal.default_int_handler(signum, frame)


def was_interrupted() -> bool:
    """Whether an error may come of Ctrl-C: Numba can fail where it cleans up."""
    return bool(_raised)


def _repeat_interrupt(dropped: UnraisableHookArgs) -> None:
    if issubclass(dropped.exc_type, KeyboardInterrupt):
        _raised.append(-math.inf)
        _interrupt_later()
    else:
        sys.__unraisablehook__(dropped)


def _interrupt_later() -> None:
    # Not by `threading`, whose locks the one that is interrupted may hold.
    _thread.start_new_thread(_interrupt_soon, ())


def _interrupt_soon() -> None:
    time.sleep(_PAUSE)
    _thread.interrupt_main()


def interrupted() -> int:
    """INTERRUPTED; objects that Ctrl-C left half-made do not complain when they are deleted."""
    sys.unraisablehook = lambda _: None
    return INTERRUPTED
