"""Where compiled code is kept, and whether it is there: the first compilation is announced."""

from __future__ import annotations

import logging
from functools import lru_cache
from pathlib import Path

from planewise import kernels
from planewise.kernels.readings import score_rays

_LOG = logging.getLogger("planewise")


def cache_directory() -> Path:
    """Folder in which Numba keeps the compiled loops (NUMBA_CACHE_DIR moves it)."""
    return Path(score_rays.stats.cache_path or "")


def is_cached() -> bool:
    """Whether the loops of this version have been compiled on this machine before."""
    written = [index.stat().st_mtime for index in cache_directory().glob("*.nbi")]
    sources = Path(kernels.__path__[0]).glob("*.py")
    return bool(written) and max(written) >= max(source.stat().st_mtime for source in sources)


@lru_cache(maxsize=1)
def announce() -> None:
    """Say once, before the wait, that code has to be compiled."""
    if not is_cached():
        _LOG.warning("compiling for this machine, once (some 10 s) ...")
