"""Whole Python processes as work to time."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from benchmarks.timing import Work


def process(*arguments: str, **environment: str) -> Work:
    """Work that runs Python with these arguments, and variables added to the environment.

    Byte code is kept, as it is of what is installed: no module is compiled in every process.
    """
    variables = os.environ | environment
    variables.pop("PYTHONDONTWRITEBYTECODE", None)
    return lambda: subprocess.run(
        [sys.executable, *arguments], check=True, capture_output=True, env=variables
    )


def peak_memory() -> float:
    """Of this process, MB; what its parent had held does not count, where the system says so."""
    status = Path("/proc/self/status")
    if status.exists():
        lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
        return int(lines["VmHWM"].split()[0]) / 1e3
    import resource  # of Unix alone

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
