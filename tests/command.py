"""The command line, called as a user would, in this process; and code in one of its own."""

from __future__ import annotations

import os
import re
import subprocess
import sys

from typer.testing import CliRunner

from planewise.commands.app import command_line


def run(*arguments):
    """Run the command; streams come back as plain text with single spaces."""
    given = [str(each) for each in arguments]
    result = CliRunner().invoke(command_line(given), given, prog_name="planewise")
    plain = [re.sub(r"\s+", " ", text) for text in (result.stdout, result.stderr)]
    return result.exit_code, *plain


def run_python(code, *arguments, check=True, **environment):
    """Run code in a process of its own; what it wrote, and how it ended, come back."""
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=check,
    )
