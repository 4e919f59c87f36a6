"""Where compiled code is kept, and whether it is there: the first compilation is announced."""

from __future__ import annotations

import contextlib
import gc
import logging
import os
import subprocess
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

from numba.core import event

from planewise import kernels
from planewise.kernels.readings import score_rays
from planewise.threads import available

_LOG = logging.getLogger("planewise")
_CLOUD = ("cloud_", "cubes", "pairs")  # modules of kernels that only clouds need
_HELPED = "PLANEWISE_COMPILES_FOR_ANOTHER"  # set in the process that helps
_helpers: list[subprocess.Popen[bytes]] = []  # kept: nobody waits for them


def cache_directory() -> Path:
    """Folder in which Numba keeps the compiled loops (NUMBA_CACHE_DIR moves it)."""
    return Path(score_rays.stats.cache_path or "")


def is_cached(*, cloud: bool = False) -> bool:
    """Whether the loops of this version have been compiled on this machine before.

    Parameters
    ----------
    cloud : bool
        Those of clouds, not of depth images.
    """
    indexes = cache_directory().glob("*.nbi")
    written = [each.stat().st_mtime for each in indexes if each.name.startswith(_CLOUD) == cloud]
    sources = Path(kernels.__path__[0]).glob("*.py")
    needed = [each for each in sources if cloud or not each.name.startswith(_CLOUD)]
    return bool(written) and max(written) >= max(source.stat().st_mtime for source in needed)


def announce(*, cloud: bool = False) -> bool:
    """Say once, before the wait, that code has to be compiled, and have another core help.

    A second process compiles the loops of the later stages; where none can be started, or its work
    is not done in time, this one does it all.

    Parameters
    ----------
    cloud : bool
        The loops are those of clouds, not of depth images.

    Returns
    -------
    bool
        Whether this process has to compile, however often it is asked.
    """
    return _announced(cloud)


@lru_cache(maxsize=2)
def _announced(cloud: bool) -> bool:
    if is_cached(cloud=cloud):
        return False
    _LOG.warning("compiling for this machine, once (some 10 s) ...")
    if available() > 1 and sys.executable and not os.environ.get(_HELPED):
        with contextlib.suppress(OSError):
            helper = subprocess.Popen(
                [sys.executable, "-m", f"planewise.{'clouds.' if cloud else ''}warm_up"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=os.environ | {_HELPED: "1"},
            )
            helper.returncode = 0  # nobody waits for it, nor should Python complain of that at exit
            _helpers.append(helper)
    return True


class _Uncollected(event.Listener):
    """Keeps the garbage collector still while Numba compiles a loop of this package.

    It would look through all of the compiler's objects again and again, a fifth of the whole time.
    """

    def __init__(self) -> None:
        self._depth, self._enabled = 0, False

    def on_start(self, event: Any) -> None:
        if not self._depth and gc.isenabled():
            ours = event.data["dispatcher"].py_func.__module__.startswith(f"{__package__}.")
            self._enabled = ours
            if ours:
                gc.disable()
        self._depth += 1

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if not self._depth and self._enabled:
            self._enabled = False
            gc.enable()


_register: Any = event.register  # has no types
_register("numba:compile", _Uncollected())
