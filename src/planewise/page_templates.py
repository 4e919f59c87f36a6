"""Templates of HTML pages, which lie beside the modules that fill them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from planewise.errors import needs

if TYPE_CHECKING:
    from jinja2 import Environment


def templates_of(package: str, *, purpose: str, extra: str) -> Environment:
    """Templates of a package; what is filled in is escaped, and nothing may be left out.

    Parameters
    ----------
    package : str
        Where the files lie.
    purpose, extra : str
        What they are for, and the extra that brings Jinja.

    Raises
    ------
    MissingExtraError
        If Jinja is not installed.
    """
    with needs("jinja2", purpose, extra=extra):
        import jinja2
    return jinja2.Environment(
        loader=jinja2.PackageLoader(package, "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
