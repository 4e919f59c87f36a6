"""What the command line prints: results on stdout, everything else on stderr."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from rich.text import Text

from planewise.model import PlaneModel
from planewise.sensor import Sensor
from planewise.waves import Waves
from planewise.wording import counted

if TYPE_CHECKING:
    from planewise.calibration.estimate import NoiseEstimate
    from planewise.metrics.confidence import Interval
    from planewise.reproduce.section import Check

_OUT, _ERR = Console(highlight=False), Console(stderr=True, highlight=False)

Array = NDArray[np.float64]
Item = TypeVar("Item")

_NAMED = 20  # of many names
_BAR = 30  # characters of the longest bar
_WIDEST = 1000  # characters of a line of a table
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]")  # which terminals obey; names of files may hold them
_VALUE = re.compile(r"\b(depth_scale|objective|search) ?= ?'?([\w.]+)'?")
_NAME = re.compile(
    r"^(camera_topic|depth_scale|inlier_ratio|instances|max_depth|max_planes|minimum_pixels|partition"
    r"|reassign|significance|topic)(?= (must|needs|goes|is|with) )"
)


def error(message: str) -> None:
    """Say on stderr, in one line, what is wrong."""
    _line(_ERR, ("error: ", "bold red"), (_as_typed(message), ""))


def warning(message: str) -> None:
    """Say on stderr what is unusual."""
    _line(_ERR, ("warning: ", "bold yellow"), (_as_typed(message), ""))


def notice(message: str) -> None:
    """Say on stderr what goes on."""
    _line(_ERR, (message, "dim"))


def _as_typed(message: str) -> str:
    """Call options as they are typed, not by the names of Python's arguments.

    In messages that begin with one: others may hold names of files.
    """
    message = message.replace(" (camera.scaled, camera.cropped)", "")
    message = message.replace("(depth_scale = ", "(--depth-scale ")
    if not (_NAME.match(message) or _VALUE.match(message)):
        return message
    message = _VALUE.sub(lambda found: f"{_option(found)} {found[2]}", message)
    return _NAME.sub(_option, message)


def _option(found: re.Match[str]) -> str:
    return "--" + found[1].replace("_", "-")


def say(message: str) -> None:
    """Print a line of the result."""
    _line(_OUT, (message, ""))


def say_wrapped(message: str) -> None:
    """Print what is too long for a line in several, all but the first indented."""
    for line in textwrap.wrap(_plain(message), max(_OUT.width, 80), subsequent_indent="  "):
        _OUT.print(Text(line), soft_wrap=True)


def listed(names: Sequence[str]) -> str:
    """Write the first of some names."""
    return ", ".join(names[:_NAMED]) + (" ..." if len(names) > _NAMED else "")


def errors() -> Console:
    """Console of stderr, for what is drawn on it."""
    return _ERR


def width() -> int:
    """Characters of a line of stdout."""
    return _OUT.width


def draws_bars() -> bool:
    """Whether stderr is a terminal."""
    return _ERR.is_terminal


def _line(console: Console, *parts: tuple[str, str]) -> None:
    text = Text()
    for part, style in parts:
        text.append(_plain(part), style=style)
        text.append(" " if part.endswith(" ") else "")
    console.print(text, soft_wrap=True)


def _plain(text: str) -> str:
    """One line, of which a terminal obeys nothing."""
    line = " ".join(text.split())
    return _CONTROL.sub(lambda found: f"\\x{ord(found[0]):02x}", line)


def show_planes(model: PlaneModel) -> None:
    """Print a table of the planes, best first."""
    if not len(model):
        return
    table = _table(_gap())
    for name in ("rank", "nats", "readings", "share", "normal", "distance", "area", "rms"):
        table.add_column(name, justify="right", no_wrap=True)
    areas = _aligned([plane.area for plane in model.planes])
    for rank, (plane, area) in enumerate(zip(model.planes, areas, strict=True), start=1):
        normal = " ".join(f"{part:6.3f}" for part in plane.normal)
        table.add_row(
            str(rank),
            f"{plane.information:,.0f}",
            f"{plane.count:,}",
            f"{plane.count / model.readings:.1%}",
            normal,
            f"{_short(plane.distance)} m",
            f"{area} m2" if np.isfinite(plane.area) else "",
            f"{1000 * plane.rms:,.1f} mm",
        )
    _show(table)
    say("nats of planes are against outliers, and add up to more than Phi falls by")


def _short(number: float, decimals: int = 3) -> str:
    return f"{number:z.{decimals}f}" if abs(number) < 1000 else f"{number:,.0f}"


def _aligned(areas: Iterable[float]) -> list[str]:
    """Areas as short numbers, small ones of three digits, their points below each other."""
    texts = [
        _short(each, 2 - math.floor(math.log10(each)) if 0 < each < 0.1 else 3) for each in areas
    ]
    behind = [len(text) - len(text.partition(".")[0]) for text in texts]
    return [text + " " * (max(behind) - n) for text, n in zip(texts, behind, strict=True)]


def _gap() -> int:
    """Characters between the columns of a wide table."""
    return 2 if _OUT.width >= 90 else 1


def _table(gap: int = 2, title: str | None = None) -> Table:
    return Table(
        box=None, pad_edge=False, header_style="bold", padding=(0, gap, 0, 0),
        title=title, title_justify="left", title_style="bold",
    )  # fmt: skip


def _show(table: Table) -> None:
    # A narrow terminal may break lines, but no number is cut off.
    lines = all(column.no_wrap for column in table.columns)
    needed = Console(width=_WIDEST).measure(table).maximum if lines else 0
    Console(width=max(_OUT.width, 80, needed), highlight=False).print(table)


def show_summary(model: PlaneModel, seconds: float, folder: Path) -> None:
    """Print how many planes there are, what they are worth and where the files are."""
    without = f"({model.curve[0]:,.0f} without planes)" if len(model) else "without planes"
    say(f"{counted(len(model), 'plane')}, Phi = {model.information:,.0f} nats {without}")
    from planewise.compilation import has_compiled  # loads Numba, which has been used by now

    with_it = "compiling" if has_compiled() else "loading"
    readings = counted(model.readings, "reading")
    say(f"{readings}, {1000 * seconds:.0f} ms, {with_it} included, files in {folder}")
    if isinstance(own := model.settings.get("own_size"), list):
        say(f"depth was enlarged; its own {own[1]} x {own[0]} pixels were searched")
    if isinstance(waves := model.settings.get("waves"), dict):
        say(f"depth errs by waves that were taken off: {Waves.of(waves)}")
    warn_of_note(model)


def warn_of_note(model: PlaneModel, name: str = "") -> None:
    """Warn where a model's note says something; `name` is that of a frame."""
    if model.note:
        warning(name + ("" if len(model) else "no plane was found: ") + model.note)


def show_scores(scores: Mapping[str, Interval]) -> None:
    """Print a table of means over frames; what is defined on no frame is left out."""
    table = _table()
    table.add_column("score")
    for name in ("mean", "95 % confidence interval", "frames"):
        table.add_column(name, justify="right", no_wrap=True)
    for name, score in scores.items():
        if not score.count:
            continue
        interval = f"{score.low:z.4f} ... {score.high:z.4f}" if score.count > 1 else ""
        unit = " (bits)" if name.startswith("voi_") else ""
        table.add_row(name + unit, f"{score.mean:z.4f}", interval, str(score.count))
    _show(table)


def show_noise(found: NoiseEstimate, known: Sensor | None) -> None:
    """Print what the bins of depth say, beside a known sensor, and the curves through them."""
    table = _table()
    names = ["depth", "sigma", "curve", "95 % band", "step", "flat cells"]
    for name in (*names, *([] if known is None else ["preset"])):
        table.add_column(name, justify="right", no_wrap=True)
    bins = found.bins
    curve = found.noise(bins.depth)
    preset = None if known is None else known.sigma(bins.depth)

    def mm(metres: float) -> str:
        return f"{1000 * metres:.2f}"

    for k, depth in enumerate(bins.depth):
        row = [f"{depth:.2f} m", f"{mm(bins.sigma[k])} mm", f"{mm(curve[k])} mm"]
        row += [f"{mm(bins.low[k])} ... {mm(bins.high[k])} mm", f"{mm(bins.step[k])} mm"]
        row += [f"{bins.cells[k]:,}", *([] if preset is None else [f"{mm(preset[k])} mm"])]
        table.add_row(*row)
    _show(table)
    if np.isfinite(bins.low).all():
        outside = np.count_nonzero((bins.sigma < bins.low) | (bins.sigma > bins.high))
        say(
            f"the band is of the curve, on walls; outside it: {outside} of {len(bins.depth)} sigmas"
        )
    say(f"noise: {found.noise}")
    say(f"white: {found.white}, quantisation: {found.quantisation}")
    if found.bounds:
        say(f"shared: {found.shared}, drift: {found.drift} over 100 px")
    else:
        say(f"shared: {found.shared}, but not as by a drift: each frame tells how far it goes")
    if found.waves is not None:
        say(f"waves: {found.waves}, taken off by the spatial objective")


def show_machine(machine: Mapping[str, Any], threads: int) -> None:
    """Print what times are measured on."""
    say(f"{machine['processor']}, threads used: {threads} of {machine['processors']}")
    say(", ".join(f"{name} {each}" for name, each in machine["versions"].items()))


def show_times(milliseconds: Array, first: float) -> None:
    """Print median, spread and rate of equal calls, and how long the one before them took."""
    low, middle, high = np.percentile(milliseconds, (25, 50, 75))
    table = _table()
    for name in ("median", "quartiles", "fastest ... slowest", "frames/s", "calls", "first call"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_row(
        f"{middle:.2f} ms",
        f"{low:.2f} ... {high:.2f}",
        f"{milliseconds.min():.2f} ... {milliseconds.max():.2f}",
        f"{1e3 / middle:.1f}",
        str(len(milliseconds)),
        f"{first:.0f} ms",
    )
    _show(table)


def show_stages(stages: Mapping[str, Array]) -> None:
    """Print the median of every stage, and its share as a number and a bar."""
    medians = {name: float(np.median(each)) for name, each in stages.items()}
    whole, most = sum(medians.values()), max(medians.values())
    table = _table()
    table.add_column("stage")
    for name in ("median", "share"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("")
    for name, each in medians.items():
        bar = ("#" if _OUT.options.ascii_only else "█") * round(_BAR * each / most)
        table.add_row(name, f"{each:.2f} ms", f"{each / whole:.0%}", Text(bar, style="blue"))
    _show(table)


def show_checks(checks: Mapping[str, Sequence[Check]]) -> None:
    """Print claims and targets of every part of a report, and whether they hold."""
    table = _table()
    for name in ("", "what should hold", "measured"):
        table.add_column(name)
    for title, rows in checks.items():
        if rows:
            table.add_row("", Text(title, style="bold"), "")
        for check in rows:
            style = "green" if check.met else "yellow" if check.open else "red"
            verdict = Text(check.verdict, style=style)
            table.add_row(verdict, f"{check.source}: {check.text}", check.measured)
    if table.row_count:
        _show(table)


def show_table(title: str, rows: Iterable[tuple[str, ...]], columns: tuple[str, ...]) -> None:
    """Print a table of text; the first column is a name."""
    table = _table(_gap(), title)
    for name in columns:
        table.add_column(name, justify="left" if name in (columns[0], "noise") else "right")
    for row in rows:
        table.add_row(*row)
    _OUT.print()
    _show(table)


def progress(items: Iterable[Item], total: int) -> Iterator[Item]:
    """Show a bar on stderr while the items pass; it makes way for lines that are printed."""
    if not _ERR.is_terminal:
        yield from items
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    columns = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=_ERR, transient=True) as bar:
        task = bar.add_task("", total=total)
        for item in items:
            bar.stop()
            yield item
            bar.advance(task)
            bar.start()


@contextmanager
def bar(total: int) -> Iterator[Callable[[int], None]]:
    """Show a bar on stderr; give what is to be told how many are done."""
    if not _ERR.is_terminal:
        yield lambda done: None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    columns = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=_ERR, transient=True) as shown:
        task = shown.add_task("", total=total)
        yield lambda done: shown.update(task, completed=done)
