"""What a measurement was made on."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from planewise._version import __version__

_GROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")
_CPU_INFO = Path("/proc/cpuinfo")  # Linux, where platform.processor() says nothing


def processor() -> str:
    """Name of the processor, such as "AMD EPYC"."""
    if _CPU_INFO.exists():
        found = re.search(r"^model name\s*:\s*(.+)$", _CPU_INFO.read_text(), re.MULTILINE)
        if found:
            return found[1].strip()
    return platform.processor() or platform.machine()


def installed_memory() -> int:
    """Bytes of memory, of the process' control group where that has less; 0 where none is told."""
    try:
        there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # Windows
        return 0
    text = _GROUP_LIMIT.read_text().strip() if _GROUP_LIMIT.exists() else ""
    return min(there, int(text)) if text.isdecimal() else there


def versions(packages: Iterable[str] = ()) -> dict[str, str]:
    """Versions of Python, planewise, NumPy and Numba, and of those of `packages` that are there."""
    found = {"python": platform.python_version(), "planewise": __version__}
    for name in ("numpy", "numba", *packages):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def describe_machine(packages: Iterable[str] = ()) -> dict[str, Any]:
    """Say in plain types what the machine and the versions are, for result files."""
    return {
        "processor": processor(),
        "processors": os.cpu_count() or 1,
        "system": f"{platform.system()} {platform.machine()}",
        "versions": versions(packages),
    }
