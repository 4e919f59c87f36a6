"""What `planewise batch` shows: what there is to do, how it goes, and what came of it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np

from planewise.commands import terminal
from planewise.commands.command_line import unusual_unit
from planewise.commands.frame_doubts import FrameDoubts
from planewise.commands.frame_sizes import FrameSizes
from planewise.wording import counted

if TYPE_CHECKING:
    from rich import progress as bars

    from planewise.batch import Batch, Outcome, Plan, Recipe

_SHOWN_FAILURES = 20
_SECONDS_A_LINE = 30.0  # where there is no terminal to draw a bar on
_SECONDS_TO_TELL = 10.0  # behind the first frame, before which loops were compiled and loaded
_UNITS = ((3600.0, "h"), (60.0, "min"), (1.0, "s"))


class Progress:
    """Bar with rate, time left, planes and failures; lines of the same for a log.

    Parameters
    ----------
    plan : Plan
        What is to be done.
    recipe : Recipe
        What is done with every frame.

    Attributes
    ----------
    done, failed, planes : int
        Frames of this run, and planes found in them.
    empty, out_of_range, noise_assumed : int
        Frames without a reading, those most of whose readings are outside the sensor's range, and
        those whose noise was to be estimated and could not be.
    doubts : FrameDoubts
        Frames whose readings look like something else than they are taken for.
    milliseconds : ndarray, shape (3,)
        To read, detect and encode, summed over frames that were done.
    """

    def __init__(self, plan: Plan, recipe: Recipe) -> None:
        self.plan, self.total = plan, len(plan.to_do)
        self.done = self.failed = self.planes = 0
        self.empty = self.out_of_range = self.noise_assumed = 0
        self.doubts = FrameDoubts()
        self._sizes = FrameSizes(recipe.camera)
        self._unit = unusual_unit(recipe.sensor.resolution)
        self.milliseconds = np.zeros(3)
        self._start = self._last_line = time.monotonic()
        self._first: float | None = None  # when the first frame ended
        self._bar: bars.Progress | None = None

    def __enter__(self) -> Self:
        if self.total and terminal.draws_bars():
            self._bar = _bar()
            self._bar.add_task("", total=self.total, planes=0, failed=0, rate="")
            self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.seconds = time.monotonic() - self._start
        if self._bar is not None:
            self._bar.stop()

    def count(self, outcome: Outcome) -> None:
        """Take note of a frame."""
        if outcome.reason:
            self.failed += 1
            if self.failed <= _SHOWN_FAILURES:
                terminal.error(f"frame {outcome.frame}: {outcome.reason}")
            if self.failed == _SHOWN_FAILURES:
                terminal.notice("more failures are counted, and named in the store only")
        else:
            self.done += 1
            self.planes += outcome.planes
            self.empty += not outcome.present
            self._sizes.see(f"frame {outcome.frame}", outcome.shape)
            if self._unit and not outcome.unit_told:
                terminal.warning(f"frame {outcome.frame}: {self._unit}")
                self._unit = ""  # once is enough
            self.out_of_range += outcome.out_of_range
            self.noise_assumed += outcome.noise_assumed
            self.doubts.see(outcome.misread)
            self.milliseconds += outcome.milliseconds
        self._show()

    @property
    def rate(self) -> float | None:
        """Frames a second since the first ended; ``None`` as long as they tell little."""
        since = 0.0 if self._first is None else time.monotonic() - self._first
        ended = self.done + self.failed - 1
        return ended / since if since >= _SECONDS_TO_TELL and ended else None

    def _show(self) -> None:
        ended = self.done + self.failed
        if self._first is None:
            self._first = time.monotonic()
        if self._bar is not None:
            task = self._bar.tasks[0]
            speed = task.speed or self.rate
            rate = f"{speed:.1f} frames/s" if speed else ""
            self._bar.update(
                task.id, completed=ended, planes=self.planes, failed=self.failed, rate=rate
            )
        elif time.monotonic() - self._last_line > _SECONDS_A_LINE and ended < self.total:
            self._last_line = time.monotonic()
            told = ""
            if speed := self.rate:
                told = f"{speed:.1f} frames/s, {duration((self.total - ended) / speed)} left, "
            terminal.notice(
                f"{ended:,} of {counted(self.total, 'frame')}, {told}"
                f"{counted(self.planes, 'plane')}, {self.failed:,} failed"
            )


def _bar() -> bars.Progress:
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    return Progress(
        BarColumn(bar_width=20),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
        TextColumn("left"),
        TextColumn("{task.fields[planes]:,} planes"),
        TextColumn("{task.fields[failed]:,} failed"),
        console=terminal.errors(),
        transient=True,
    )


def show_result(progress: Progress, store: Path) -> None:
    """Print what a run did."""
    plan = progress.plan
    selected = counted(plan.selected, "frame") + " selected"
    if not progress.total:
        terminal.say(f"nothing to do: {store} holds {plan.done:,} of the {selected}")
    else:
        ended = progress.done + progress.failed
        terminal.say(
            f"{progress.done:,} of {counted(ended, 'frame')} done, "
            f"{counted(progress.planes, 'plane')}, {duration(progress.seconds)}, "
            f"{ended / progress.seconds:.1f} frames/s"
        )
        if progress.done:
            read, detect, encode = progress.milliseconds / progress.done
            terminal.say(
                f"a frame took {read:.1f} ms to read, {detect:.1f} to detect, "
                f"{encode:.1f} to encode"
            )
        terminal.say(f"{store} holds {plan.done + progress.done:,} of the {selected}")
    if progress.empty:
        terminal.warning(f"{counted(progress.empty, 'frame')} without a reading, and so no plane")
    if progress.out_of_range:
        terminal.warning(
            f"most readings of {counted(progress.out_of_range, 'frame')} lie outside the sensor's "
            "range; are --depth-scale, --max-depth and --sensor those of this camera?"
        )
    if progress.noise_assumed:
        terminal.warning(
            f"the noise of {counted(progress.noise_assumed, 'frame')} could not be estimated and "
            "was assumed; where that is wrong, so are planes: the store's column 'note' says more"
        )
    progress.doubts.warn()
    failed = plan.failed + progress.failed
    if failed:
        terminal.warning(f"{counted(failed, 'frame')} failed; --retry-failed tries again")


def show_damaged(plan: Plan) -> None:
    """Say which frames of a store have lost their label images."""
    if plan.damaged:
        terminal.notice(
            f"missing or cut short, and to be made again: "
            f"{counted(len(plan.damaged), 'label image')} of the store, such as that of the frame "
            f"{min(plan.damaged)}"
        )


def show_forecast(batch: Batch, plan: Plan, tried: Sequence[Outcome], workers: int) -> None:
    """Print what a run would do, by the frames that were tried."""
    terminal.say(
        f"{batch.source.name}: {counted(len(batch.source.ids), 'frame')}, "
        f"{plan.selected:,} selected, {plan.done:,} in the store, {plan.failed:,} failed before, "
        f"{len(plan.to_do):,} to do"
    )
    show_damaged(plan)
    recipe = batch.recipe
    camera = "of each frame" if recipe.camera is None else recipe.camera.describe()
    for name, each in (
        ("options", recipe.options.describe()),
        ("sensor", recipe.sensor.describe()),
        ("camera", camera),
    ):
        text = ", ".join(f"{k} {v}" for k, v in each.items()) if isinstance(each, dict) else each
        terminal.say_wrapped(f"{name}: {text}")
    for outcome in tried:
        if outcome.reason:
            terminal.error(f"frame {outcome.frame}: {outcome.reason}")
    good = [each for each in tried if not each.reason]
    unit = unusual_unit(recipe.sensor.resolution)
    if unit and not all(each.unit_told for each in good):
        terminal.warning(unit)
    FrameDoubts(each.misread for each in good).warn()
    if good:
        _show_costs(good, len(plan.to_do), workers)


def _show_costs(good: Sequence[Outcome], to_do: int, workers: int) -> None:
    read, detect, encode = np.mean([each.milliseconds for each in good], axis=0)
    seconds = 1e-3 * (read + detect + encode)
    labels = _mean([len(each.label_file[1]) if each.label_file else 0 for each in good])
    rows = _mean([len(each.record) for each in good])
    terminal.say_wrapped(
        f"a frame, by {len(good)} of them: {read:.1f} ms to read, {detect:.1f} to detect, "
        f"{encode:.1f} to encode; {_mean([each.planes for each in good]):.1f} planes"
    )
    terminal.say_wrapped(
        f"all: {duration(seconds * to_do / workers)} with {counted(workers, 'worker')} "
        f"({seconds * to_do / 3600:.2f} core-hours), {size(to_do * labels)} of labels and at most "
        f"{size(to_do * rows)} of tables"
    )


def _mean(numbers: Sequence[float]) -> float:
    return sum(numbers) / len(numbers)


def duration(seconds: float) -> str:
    """Write a time with one unit."""
    for unit, name in _UNITS:
        if seconds >= 2 * unit:
            return f"{seconds / unit:.0f} {name}"
    return f"{seconds:.1f} s"


def size(count: float) -> str:
    """Write a number of bytes."""
    for power, name in ((4, "TB"), (3, "GB"), (2, "MB")):
        if count >= 1000**power:
            return f"{count / 1000**power:.1f} {name}"
    return f"{count / 1000:.0f} kB"
