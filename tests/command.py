"""The command line, called as a user would, in this process."""

from __future__ import annotations

import re

from typer.testing import CliRunner

from planewise.commands.app import app


def run(*arguments):
    """Run the command; streams come back as plain text with single spaces."""
    result = CliRunner().invoke(app, [str(each) for each in arguments], prog_name="planewise")
    plain = [re.sub(r"\s+", " ", text) for text in (result.stdout, result.stderr)]
    return result.exit_code, *plain
