"""What `planewise` ends with; 0 where all went well."""

FAILED = 2
"""Something given cannot be used."""

INTERRUPTED = 130
"""Ctrl-C, as shells have it."""
