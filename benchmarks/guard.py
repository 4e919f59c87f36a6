"""Fails where the detector has become slower: ratios to fixed work, and bytes, but no seconds.

python -m benchmarks.guard [--record] [--runs 15]

Every call is timed by turns with fixed work (`benchmarks.reference_work`) in processor time on one
core, imports with that of NumPy; the median of the ratios counts. What exceeds its limit is
measured up to twice more and the lowest counts, so other work on the machine does not fail the
guard. Another process compiles first: the garbage collector goes through all that compiling leaves
behind, which makes later calls in the same process slower by half. Limits follow from
benchmarks/guard.json, which --record writes: record after a change that is meant to cost or save
time or memory. The paper's searches, which gain most where vectors are wide, are held against work
half of which gains as much.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np

from benchmarks import memory, rivals
from benchmarks.arguments import parser_of
from benchmarks.frames import Frame, rooms
from benchmarks.processes import process
from benchmarks.reference_work import reference
from benchmarks.rivals import Method
from benchmarks.timing import interleaved, one_core
from planewise.machine import describe_machine
from planewise.runtime.allocator import keep_freed

RECORD = Path(__file__).with_name("guard.json")
_ATTEMPTS = 3


@dataclass(frozen=True)
class Guarded:
    """What is guarded.

    Attributes
    ----------
    measure : callable
        Gives the number, from the number of runs of what is fast.
    unit : str
        Of the number.
    factor, slack : float
        The limit is factor times what was recorded, plus slack.
    """

    measure: Callable[[int], float]
    unit: str
    factor: float = 1.5
    slack: float = 0.0

    def limit(self, recorded: float) -> float:
        """Largest number that passes."""
        return self.factor * recorded + self.slack

    def best(self, recorded: float | None, runs: int) -> float:
        """Lowest of up to three measurements; one is enough where it is within the limit."""
        found = self.measure(runs)
        for _ in range(_ATTEMPTS - 1):
            if recorded is not None and found <= self.limit(recorded):
                break
            found = min(found, self.measure(runs))
        return found


def _call(method: Method, share: int, vectors: bool, frame: Frame, runs: int) -> float:
    """Median ratio of a method's processor time to that of the fixed work."""
    depth = np.asarray(frame.depth, np.uint16)
    keep_freed()  # of the fixed work, too, whatever was called before
    with one_core():
        detect = method.prepare(frame, False).detect
        work = partial(reference, depth, vectors=vectors)
        ours, fixed = interleaved(detect, work, max(3, runs // share), clock=time.process_time)
    return float(np.median(ours / fixed))


def call_once(frame: Frame) -> None:
    """Compile what the timed calls need and the cache lacks."""
    depth = np.asarray(frame.depth, np.uint16)
    reference(depth, vectors=True)
    for method in (rivals.DEFAULT, rivals.PAPER, rivals.SEQUENTIAL):
        method.prepare(frame, False).detect()


def _import(runs: int) -> float:
    """Median ratio of the time to import planewise to that of NumPy, in processes of their own."""
    with one_core():
        ours, fixed = interleaved(
            process("-c", "import planewise"), process("-c", "import numpy"), max(3, runs // 2)
        )
    return float(np.median(ours / fixed))


def _memory(what: str, _: int) -> float:
    return max(_measured_memory()[what])


@cache
def _measured_memory() -> dict[str, list[float]]:
    """Bytes do not depend on what else runs: once is enough."""
    return memory.measured()


def guarded(frame: Frame) -> dict[str, Guarded]:
    """Everything that is guarded, by name."""

    def timed(method: Method, share: int, *, vectors: bool) -> Guarded:
        return Guarded(partial(_call, method, share, vectors, frame), "x fixed work")

    return {
        "default call": timed(rivals.DEFAULT, 1, vectors=False),
        "objective='paper'": timed(rivals.PAPER, 1, vectors=True),
        "search='sequential'": timed(rivals.SEQUENTIAL, 3, vectors=True),
        "import planewise": Guarded(_import, "x import numpy"),
        "memory held": Guarded(partial(_memory, "held"), "MB", 1.2, 0.2),
        "allocated in a warm frame": Guarded(partial(_memory, "allocated"), "MB", 1.2, 0.2),
    }


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--record", action="store_true", help="keep the numbers as the new record")
    parser.add_argument("--runs", type=int, default=15)
    parser.add_argument("--compile", action="store_true", help="call everything once, no more")
    given = parser.parse_args()
    frame = next(iter(rooms(1)))
    if given.compile:
        call_once(frame)
        return
    subprocess.run([sys.executable, "-m", "benchmarks.guard", "--compile"], check=True)
    known = {} if given.record else recorded()
    print("| what | now | recorded | limit | unit | |\n|---|---:|---:|---:|---|---|", flush=True)
    found: dict[str, float] = {}
    verdicts: dict[str, str] = {}
    for name, each in guarded(frame).items():
        before = known.get(name)
        found[name] = each.best(before, given.runs)
        verdicts[name] = "" if given.record else verdict(each, found[name], before)
        numbers = [found[name]] + ([] if before is None else [before, each.limit(before)])
        now, old, limit = [f"{number:.3g}" for number in numbers] + [""] * (3 - len(numbers))
        print(f"| {name} | {now} | {old} | {limit} | {each.unit} | {verdicts[name]} |", flush=True)
    if given.record:
        record = {"machine": describe_machine(), "values": found}
        RECORD.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
        print(f"\nrecorded in {RECORD.name}")
    failed = [name for name, each in verdicts.items() if each.isupper()]
    if failed:
        sys.exit(
            f"\nguard: {', '.join(failed)}: slower, or more memory, than benchmarks/{RECORD.name} "
            "allows. If that is meant: make guard-record"
        )


def recorded() -> dict[str, float]:
    """Numbers of the last record, by name."""
    return dict(json.loads(RECORD.read_text(encoding="utf-8"))["values"])


def verdict(each: Guarded, now: float, recorded: float | None) -> str:
    """What to make of a number; failures are in capitals."""
    if recorded is None:
        return "NOT RECORDED"
    if now > each.limit(recorded):
        return "EXCEEDED"
    return "ok; far below, record it" if each.limit(now) < recorded else "ok"


if __name__ == "__main__":
    main()
