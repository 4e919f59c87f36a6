"""What `planewise` ends with; 0 where all went well."""

from __future__ import annotations

import sys

FAILED = 2
"""Something given cannot be used."""

INTERRUPTED = 130
"""Ctrl-C, as shells have it."""


def interrupted() -> int:
    """INTERRUPTED; objects that Ctrl-C left half-made do not complain when they are deleted."""
    sys.unraisablehook = lambda _: None
    return INTERRUPTED
