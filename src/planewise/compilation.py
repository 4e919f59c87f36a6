"""Where compiled code is kept, and whether it is there: the first compilation is announced."""

from __future__ import annotations

import contextlib
import logging
import os
import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from numba.core import event

from planewise import kernels
from planewise.kernels.compiler import QuickCompiler
from planewise.kernels.loop_cache import ENDING
from planewise.kernels.readings import score_rays
from planewise.runtime.threads import available

_LOG = logging.getLogger("planewise")
_SOURCES = Path(kernels.__path__[0])
_CLOUD = ("cloud_", "cubes")  # modules of kernels that only clouds need
Loops = Literal["depth image", "paper", "spatial", "cloud", "points"]
"""By which a depth image is seen, and those of each search: in clouds, the spatial one and that of
points one by one, which clouds of few need, too."""
_TELLING: dict[Loops, str] = {  # modules, or loops, that nothing else needs
    "depth image": "images.",
    "paper": "readings.",
    "spatial": "segments.",
    "cloud": "cloud_segments.",
    "points": "readings.assign_points",
}
_HELPED = "PLANEWISE_COMPILES_FOR_ANOTHER"  # set in the process that helps
_PARTS = ("describing", "valuing"), ("labelling", "surfaces"), ("merging",)  # of `warm_up`
_helpers: list[subprocess.Popen[bytes]] = []
_said: set[bool] = set()  # whether of clouds; to see an image and to search it is one wait


def cache_directory() -> Path:
    """Folder in which Numba keeps the compiled loops (NUMBA_CACHE_DIR moves it)."""
    return Path(score_rays.stats.cache_path or os.devnull)


def is_cached(loops: Loops) -> bool:
    """Whether these loops of this version have been compiled on this machine before."""
    cloud = loops == "cloud"
    written = _times(_kept(_TELLING[loops]), cloud)
    sources = _times(_SOURCES.glob("*.py"), cloud)  # none in a program that was frozen
    return bool(written) and max(written) >= max(sources, default=0.0)


def _kept(loops: str = "") -> Iterator[Path]:
    """What is kept of loops whose names start so, one file a loop."""
    return cache_directory().glob(f"{loops}*.{ENDING}.nbi")


def _times(files: Iterable[Path], cloud: bool) -> list[float]:
    """When files that belong to modules of clouds, or to the others, were changed."""
    times = []
    for each in files:
        with contextlib.suppress(FileNotFoundError):  # another process may replace it just now
            if each.name.startswith(_CLOUD) == cloud:
                times.append(each.stat().st_mtime)
    return times


@lru_cache(maxsize=len(_TELLING))
def announce(loops: Loops) -> None:
    """Say once, before the wait, that these loops have to be compiled, and have other cores help.

    Up to five processes compile the loops of a spatial search's later stages; where none can be
    started, or their work is not done in time, this one does it all.
    """
    cloud = loops in ("cloud", "points")
    if cloud in _said or is_cached(loops):
        return
    _said.add(cloud)
    if score_rays.stats.cache_path is None:
        _LOG.warning(
            "compiling (10 s, or minutes on a busy machine), as in every process: nothing can be "
            "kept in the folder of planewise or the user's cache; NUMBA_CACHE_DIR names another ..."
        )
        return
    _LOG.warning("compiling for this machine, once (10 s, or minutes on a busy machine) ...")
    if loops not in ("paper", "points") and _is_interpreter() and not os.environ.get(_HELPED):
        from multiprocessing import parent_process  # few wait for this import

        idle = available() - 1
        if parent_process():  # it may be one of many that compile
            idle = min(idle, 1)
        # It imports from where this process does, and from the current folder only if this does.
        paths = os.pathsep.join(each for each in sys.path if each)
        with contextlib.suppress(OSError):
            for share in _shares(idle, cloud):
                helper = subprocess.Popen(
                    [sys.executable, "-P", "-m", *share],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    env=os.environ | {_HELPED: "1", "PYTHONPATH": paths},
                )
                helper.returncode = 0  # Python should not complain of it at exit
                _helpers.append(helper)
                if os.name == "posix":  # else it would be a zombie once it is done
                    threading.Thread(target=_wait_for, args=[helper], daemon=True).start()


def _is_interpreter() -> bool:
    """Whether this is Python itself, rather than a program that has it inside."""
    name = Path(sys.executable or "").name.lower()
    return name.startswith(("python", "pypy")) and not getattr(sys, "frozen", False)


def has_compiled() -> bool:
    """Whether this process had loops to compile."""
    return bool(_said)


def _shares(idle: int, cloud: bool) -> list[list[str]]:
    """Modules, and their arguments, that help on so many more cores."""
    if cloud:
        return [["planewise.clouds.warm_up"]][:idle]
    each = [part for parts in _PARTS for part in parts]
    if idle == 1:  # meanwhile the call compiles the rest
        shares = [each[:-1]]
    elif idle < len(each):
        shares = [list(parts) for parts in _PARTS[:idle]]
    else:
        shares = [[part] for part in each]
    return [["planewise.warm_up", *parts] for parts in shares]


def confirm(*, cloud: bool = False) -> None:
    """Note that the cache is as new as the sources, which may have been written anew unchanged.

    Parameters
    ----------
    cloud : bool
        The loops of clouds were found in it or compiled, not those of depth images.
    """
    with contextlib.suppress(OSError):
        for index in _kept():
            if index.name.startswith(_CLOUD) == cloud:
                index.touch()


def without_help() -> None:
    """Let this process compile alone, for the cores have others of its kind."""
    os.environ[_HELPED] = "1"


def wait_for_help() -> None:
    """Wait for the process that helps, where one runs: for those who look after all children."""
    while _helpers:
        _wait_for(_helpers.pop())


def _wait_for(helper: subprocess.Popen[bytes]) -> None:
    with contextlib.suppress(OSError):
        os.waitpid(helper.pid, 0)


_register: Any = event.register  # has no types
_register("numba:compile", QuickCompiler())
