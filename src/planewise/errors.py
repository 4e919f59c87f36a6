"""Errors that a user can act on; their messages are one line and say what to change."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager

NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a disk that is full."""


class PlanewiseError(ValueError):
    """A file, folder or setting that cannot be used as it is."""


class SetupError(PlanewiseError):
    """Something that has to be mended before any file or frame can be worked on."""


class MissingExtraError(SetupError):
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
        self._given = package, purpose, extra
        super().__init__(
            f"{purpose} needs the package {package}, which is part of the extra '{extra}': "
            f"pip install 'planewise[{extra}]'"
        )

    def __reduce__(self) -> tuple[type[MissingExtraError], tuple[str, str, str]]:
        """As it was made, for processes that send it to another."""
        return type(self), self._given


@contextmanager
def needs(package: str, purpose: str, extra: str = "cli") -> Iterator[None]:
    """Around the import of a package that the core does not depend on.

    Raises
    ------
    MissingExtraError
        If it is not there.
    """
    try:
        yield
    except ImportError:
        raise MissingExtraError(package, purpose, extra) from None


def in_one_line(error: BaseException) -> str:
    """First line of what an error says, or else its kind."""
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__


@contextmanager
def naming(what: str, damaged: str = "it is damaged or not what its name says") -> Iterator[None]:
    """Put the name of what is read before any error of reading it.

    Raises
    ------
    PlanewiseError
        In place of whatever else is raised: decoders of foreign bytes may raise anything.
    """
    try:
        yield
    except (SetupError, MemoryError):
        raise
    except PlanewiseError as error:
        raise PlanewiseError(f"{what} {error}") from None
    except Exception as error:
        # The system's, not a decoder's; damage may lead before the beginning of a file.
        if isinstance(error, OSError) and error.errno not in (None, errno.EINVAL):
            raise PlanewiseError(f"{what} cannot be read ({error.strerror})") from error
        detail = in_one_line(error)
        raise PlanewiseError(f"{what} cannot be read; {damaged} ({detail})") from error
