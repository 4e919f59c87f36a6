"""What lets Numba compile a loop of this package in three quarters of the time."""

from __future__ import annotations

import gc
from typing import Any

from numba.core import event
from numba.core.types.functions import BaseFunction

_function: Any = BaseFunction
_resolve = _function.get_call_type
_known: dict[tuple[Any, ...], Any] = {}  # signatures by function and types of its arguments


def _look_up(function: Any, context: Any, args: Any, kws: Any) -> Any:
    """Signature of a function or an operator for arguments of these types.

    Numba tries all that it has registered for an operator, some fifty functions, at every place
    where it is used. What comes of it is the same again, but for functions that are compiled
    themselves, with the options of who calls them.
    """
    key = function, context, tuple(args)
    if not kws and key in _known:
        return _known[key]
    signature = _resolve(function, context, args, kws)
    if not kws and function.get_impl_key(signature) is function.typing_key:  # else it is compiled
        _known[key] = signature
    return signature


class QuickCompiler(event.Listener):
    """Looks signatures up, and keeps the garbage collector still, while a loop of ours compiles.

    That would look through all of the compiler's objects again and again, a fifth of the time.
    Numba compiles one loop at a time, and tells when.
    """

    def __init__(self) -> None:
        self._depth, self._ours, self._collects = 0, False, False

    def on_start(self, event: Any) -> None:
        """Begin with the first loop of ours; it may have others compiled."""
        if not self._depth:
            module = str(event.data["dispatcher"].py_func.__module__)
            self._ours = module.startswith(f"{__package__}.")
            if self._ours:
                self._collects = gc.isenabled()
                gc.disable()
                _function.get_call_type = _look_up
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """Leave all as it was."""
        self._depth -= 1
        if not self._depth and self._ours:
            self._ours = False
            _function.get_call_type = _resolve
            if self._collects:
                gc.enable()
