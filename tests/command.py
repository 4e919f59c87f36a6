"""The command line, called as a user would, in this process."""

from __future__ import annotations

import re

from typer.testing import CliRunner

from planewise.commands.app import command_line


def run(*arguments):
    """Run the command; streams come back as plain text with single spaces."""
    given = [str(each) for each in arguments]
    result = CliRunner().invoke(command_line(given), given, prog_name="planewise")
    plain = [re.sub(r"\s+", " ", text) for text in (result.stdout, result.stderr)]
    return result.exit_code, *plain
