"""Errors that a user can act on; their messages are one line and say what to change."""

from __future__ import annotations


class PlanewiseError(ValueError):
    """A file, folder or setting that cannot be used as it is."""


class MissingExtraError(PlanewiseError):
    """A package is needed that the core does not depend on.

    Parameters
    ----------
    package : str
        Name of the missing package.
    purpose : str
        What it is needed for.
    extra : str
        Extra that brings it.
    """

    def __init__(self, package: str, purpose: str, extra: str = "cli") -> None:
        super().__init__(
            f"{purpose} needs the package {package}, which is part of the extra '{extra}': "
            f"pip install 'planewise[{extra}]'"
        )


def in_one_line(error: BaseException) -> str:
    """First line of what an error says, or else its kind."""
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__
