"""What `planewise` ends with; 0 where all went well."""

from __future__ import annotations

FAILED = 2
"""Something given cannot be used."""

INTERRUPTED = 130
"""Ctrl-C, as shells have it."""

CLOSED_PIPE = 141
"""What reads the output has ended, as shells have it."""
