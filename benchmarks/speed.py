"""How fast the detector is here, against what it must be and against others: prints Markdown.

python -m benchmarks.speed [--quick] [--runs 21] [--json FILE] [--picture FILE]
        [--data FOLDER] [--frames 4] [--only table|methods]

First a table of medians held against their bounds, then every method on the same frames, time
beside accuracy. Ours is timed from the depth image to the ranked model, the others from points to
labels, which favours them. A method that is not installed is left out, and why is said. --quick
leaves out what takes seconds a frame.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import Any

from benchmarks.arguments import parser_of
from benchmarks.frames import DATA
from benchmarks.methods import compare
from benchmarks.rivals import METHODS, Method
from benchmarks.speed_rows import ROWS, Settings, SkippedError
from benchmarks.table import HEAD
from benchmarks.timing import one_core
from planewise.machine import describe_machine


def parse() -> argparse.Namespace:
    """Read the command line."""
    parser = parser_of(__doc__)
    parser.add_argument("--quick", action="store_true", help="leave out what takes seconds a frame")
    parser.add_argument("--runs", type=int, default=21, help="of what is fast")
    parser.add_argument("--json", type=Path, metavar="FILE", help="everything measured")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="time against accuracy")
    parser.add_argument("--data", type=Path, default=DATA, help="labelled real frames")
    parser.add_argument("--frames", type=int, default=4, help="of each labelled set")
    parser.add_argument("--only", choices=("table", "methods"), help="one half")
    return parser.parse_args()


def table(settings: Settings) -> dict[str, Any]:
    """Measure and print the table."""
    print(HEAD, flush=True)
    rows, skipped = [], {}
    for measure in ROWS:
        try:
            for each in measure(settings):
                print(each.line(), flush=True)
                rows.append(each.record())
        except SkippedError as reason:
            skipped[measure.__name__.replace("_", " ")] = str(reason)
    for name, why in skipped.items():
        print(f"\n{name} was skipped: {why}")
    missed = [each["what"] for each in rows if each["verdict"] == "MISSED"]
    print(f"\nmissed: {'; '.join(missed) or 'nothing'}\n", flush=True)
    return {"rows": rows, "skipped": skipped}


def usable(quick: bool) -> tuple[list[Method], dict[str, str]]:
    """Methods that can be run here, and why the others cannot."""
    skipped = {
        each.name: "left out by --quick" if quick and each.slow else each.missing()
        for each in METHODS
    }
    skipped = {name: why for name, why in skipped.items() if why}
    return [each for each in METHODS if each.name not in skipped], skipped


def measure(given: argparse.Namespace, record: dict[str, Any]) -> None:
    """Measure what is asked for, and add it to the record."""
    if given.only != "methods":
        record["table"] = table(Settings(given.runs, given.quick))
    if given.only != "table":
        methods, skipped = usable(given.quick)
        record["methods"] = compare(methods, given.data, given.frames)
        record["skipped"] = skipped
        for name, why in skipped.items():
            print(f"{name} was skipped: {why}")


def main() -> None:
    given = parse()
    machine = describe_machine(dict.fromkeys(each.package for each in METHODS))
    print(f"{machine['processor']}, {machine['processors']} processors, {machine['system']}")
    print(", ".join(f"{name} {each}" for name, each in machine["versions"].items()))
    machine["load"] = [round(each, 2) for each in os.getloadavg()]
    print(f"load before: {', '.join(str(each) for each in machine['load'])}\n")
    record: dict[str, Any] = {"machine": machine, "runs": given.runs, "quick": given.quick}
    with one_core():
        measure(given, record)
    if given.json is not None:
        given.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
        print(f"\nnumbers in {given.json}")
    if given.picture is not None and given.only != "table":
        from benchmarks.speed_picture import draw

        draw(record["methods"], given.picture)
        print(f"picture in {given.picture}")


if __name__ == "__main__":
    main()
