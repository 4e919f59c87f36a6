"""The report as one page that needs no other file."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from typing import Any

from planewise.page_templates import templates_of
from planewise.reproduce.charts import INK
from planewise.reproduce.section import Picture, Section

TEMPLATE = "page.html.jinja"


def page(about: Mapping[str, Any], sections: Mapping[str, Section]) -> str:
    """Fill the template.

    Parameters
    ----------
    about : dict
        What was run, when and on what, line by line.
    sections : dict of Section
        By the names of the experiments.

    Returns
    -------
    str
        HTML with all pictures in it and no script.
    """
    environment = templates_of("planewise.reproduce", purpose="the report", extra="reproduce")
    environment.filters["inline_png"] = _inline_png
    environment.filters["inline_svg"] = _recoloured
    return environment.get_template(TEMPLATE).render(about=about, sections=sections)


def _inline_png(picture: Picture) -> str:
    return "data:image/png;base64," + base64.b64encode(picture.png).decode("ascii")


def _recoloured(svg: str) -> str:
    """Ink in the colour of the page's writing, and nothing that is not drawn."""
    return re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL).replace(
        INK, "currentColor"
    )
