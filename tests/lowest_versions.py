"""Prints the oldest versions that pyproject.toml allows, as constraints for pip.

Of the package and its extras; the tools that tests are run with are taken as they come.
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

PYPROJECT = Path(__file__).parents[1] / "pyproject.toml"
TOOLS = {"test", "dev", "bench"}
BOUND = re.compile(r"([\w.-]+)>=([\w.]+)")


def lowest() -> list[str]:
    """Constraints, one a package."""
    project = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    wanted = [
        *project["dependencies"],
        *(each for name in extras.keys() - TOOLS for each in extras[name]),
    ]
    bounds = {match[1]: match[2] for match in map(BOUND.match, wanted) if match}
    return [f"{name}=={version}" for name, version in sorted(bounds.items())]


if __name__ == "__main__":
    sys.stdout.write("\n".join(lowest()) + "\n")
