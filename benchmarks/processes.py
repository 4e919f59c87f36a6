"""Whole Python processes as work to time."""

from __future__ import annotations

import os
import subprocess
import sys

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
