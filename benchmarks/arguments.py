"""The command line of a benchmark."""

from __future__ import annotations

import argparse


def parser_of(module: str | None) -> argparse.ArgumentParser:
    """Parser without arguments yet, whose help is a module's docstring as it stands."""
    return argparse.ArgumentParser(
        description=module, formatter_class=argparse.RawDescriptionHelpFormatter
    )
