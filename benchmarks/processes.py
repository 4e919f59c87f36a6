"""Whole Python processes as work to time."""

from __future__ import annotations

import os
import subprocess
import sys

from benchmarks.timing import Work


def process(*arguments: str, **environment: str) -> Work:
    """Work that runs Python with these arguments, and variables added to the environment."""
    return lambda: subprocess.run(
        [sys.executable, *arguments], check=True, capture_output=True, env=os.environ | environment
    )
