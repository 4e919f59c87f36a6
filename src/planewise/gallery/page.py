"""The page: a template, filled while frames are drawn, so that thousands of them take no memory."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib import resources
from itertools import islice
from pathlib import Path
from typing import Any

from planewise._version import __version__
from planewise.batch.source import Selection
from planewise.batch.store import Store, StoredFrame
from planewise.batch.store_info import check_outside
from planewise.batch.stored_camera import described_camera
from planewise.batch.stored_source import StoredSource
from planewise.drawing.palette import palette
from planewise.errors import PlanewiseError
from planewise.gallery.records import record_of, record_of_failure
from planewise.gallery.thumbnail import Thumbnail, thumbnail_of
from planewise.page_templates import templates_of
from planewise.runtime import threads
from planewise.spherical import SphericalCamera
from planewise.whole_files import written_whole
from planewise.wording import counted

_TEMPLATE, _STYLE, _SCRIPT = "page.html.jinja", "gallery.css", "gallery.js"
_BLOCK = 48  # frames whose pictures are unpacked together


@dataclass(kw_only=True)
class Shown:
    """What is on the page.

    Attributes
    ----------
    frames, failed : int
        Frames that are shown, and how many of them failed in the batch.
    alone : int
        Frames whose planes are drawn alone.
    reason : str
        Why, of the first of them.
    damaged : list of str
        Why others are not drawn at all.
    """

    frames: int = 0
    failed: int = 0
    alone: int = 0
    reason: str = ""
    damaged: list[str] = field(default_factory=list)


@dataclass
class _Filling:
    """Gives the template its blocks, and counts."""

    store: Store
    ids: Sequence[str]
    source: StoredSource
    report: Callable[[int], None]
    shown: Shown = field(default_factory=Shown)

    def blocks(self) -> Iterator[tuple[str, str]]:
        """Records and pictures of some frames each, as JSON."""
        for records, pictures in _in_blocks(self._frames()):
            yield _as_json(records), _as_json(pictures)

    def _frames(self) -> Iterator[tuple[dict[str, Any], str | None]]:
        wanted = set(self.ids)
        for number, frame, reason in self.store.failures():
            if frame in wanted:
                self._count()
                self.shown.failed += 1
                yield record_of_failure(number, frame, reason), None
        for frame_, picture in self._drawn():
            self._count()
            record = record_of(frame_) | {"over": picture.over}
            if not picture.over:
                if picture.webp:
                    self.shown.alone += 1
                    self.shown.reason = self.shown.reason or picture.reason
                else:
                    self.shown.damaged.append(picture.reason)
                record["alone"] = picture.reason
            yield record, base64.b64encode(picture.webp).decode("ascii") if picture.webp else None

    def _count(self) -> None:
        self.shown.frames += 1
        self.report(self.shown.frames)

    def _drawn(self) -> Iterator[tuple[StoredFrame, Thumbnail]]:
        """Frames with their pictures, in order, of which some are drawn at a time."""
        workers = threads.available()
        frames = self.store.chosen(self.ids)
        with ThreadPoolExecutor(workers, thread_name_prefix="draw") as pool:
            waiting: list[tuple[StoredFrame, Future[Thumbnail]]] = []
            try:
                for frame in frames:
                    waiting.append((frame, pool.submit(thumbnail_of, frame, self.source)))
                    if len(waiting) > 2 * workers:
                        first, picture = waiting.pop(0)
                        yield first, picture.result()
                for first, picture in waiting:
                    yield first, picture.result()
            finally:
                for _, picture in waiting:
                    picture.cancel()


def write_gallery(
    store: Store,
    output: Path,
    *,
    selection: Selection | None = None,
    source: StoredSource | None = None,
    report: Callable[[int], None] | None = None,
) -> Shown:
    """Write the page; it is there when all of it is written, or not at all.

    Parameters
    ----------
    store : Store
        Results of ``planewise batch``.
    output : Path
        HTML file outside of the store; replaced if it exists.
    selection : Selection, optional
        Which of the frames that are done or failed; ``None`` means all.
    source : StoredSource, optional
        What the planes are drawn over; ``None`` means where the store says that it was.
    report : callable, optional
        Is told, again and again, how many frames are on the page.

    Returns
    -------
    Shown
        What is on it.

    Raises
    ------
    PlanewiseError
        If there is no frame, or the file cannot be written.
    """
    ids = [each for _, each in (selection or Selection()).of(store.known)]
    if not ids:
        raise PlanewiseError(f"store: {store.path} holds no frames yet")
    if output.is_dir():
        raise PlanewiseError(f"output: {output} is a folder; give the name of an HTML file")
    if output.suffix.lower() not in (".html", ".htm"):
        raise PlanewiseError(f"output: expected a .html file, got {output.name}")
    check_outside(store.path, output)
    if not output.parent.is_dir():
        raise PlanewiseError(f"output: there is no folder {output.parent}")
    filling = _Filling(
        store, ids, source or StoredSource(store, poses=False), report or (lambda _: None)
    )
    page = _template().generate(**_head(store), blocks=filling.blocks())
    with (
        written_whole(output) as partial,
        partial.open("w", encoding="utf-8", errors="replace") as file,
    ):
        file.writelines(page)
    return filling.shown


def _template() -> Any:
    environment = templates_of("planewise.gallery", purpose="the page", extra="viz")
    return environment.get_template(_TEMPLATE)


def _head(store: Store) -> dict[str, Any]:
    """What is on the page beside the frames."""
    style, script = (_own(name) for name in (_STYLE, _SCRIPT))
    colours = ["#" + each.tobytes().hex() for each in palette()]
    return {
        "name": store.info["source"]["name"],
        "about": _about(store),
        "version": __version__,
        "style": style,
        "script": script,
        "style_hash": _hash(style),
        "script_hash": _hash(script),
        "settings": _as_json({"colours": colours, "block": _BLOCK}),
    }


def _about(store: Store) -> dict[str, str]:
    """Say in words what the store was made with, line by line."""
    made, source, sensor = (store.info[name] for name in ("made_with", "source", "sensor"))
    return {
        "source": f"{source['name']}, {counted(source['frames'], 'frame')}",
        "search": _search(made["options"]),
        "sensor": f"{sensor['min_depth_m']:g} to {sensor['max_depth_m']:g} m in steps of "
        f"{1000 * sensor['resolution_m']:g} mm, noise {sensor['noise']} ({sensor['parts']})",
        "camera": _camera(made["camera"]),
        "made with": f"planewise {made['planewise']}",
    }


def _search(options: dict[str, Any]) -> str:
    """What was minimised and how, and those options that were asked for."""
    words = [f"{options['search']}, {options['objective']} objective"]
    for name, value in options.items():
        if name in ("search", "objective", "partition_options") or not value:
            continue
        title = {"rng": "seed"}.get(name, name.replace("_", " "))
        words.append(title if value is True or isinstance(value, dict) else f"{title} {value}")
    return ", ".join(words)


def _camera(camera: dict[str, Any] | None) -> str:
    if camera is None:
        return "that of each frame"
    known = described_camera(camera)
    if isinstance(known, SphericalCamera):
        return f"spherical, {counted(len(known.elevation), 'row')}"
    if known is None:
        return str(camera.get("model", "of another kind"))
    numbers = ", ".join(f"{name} {value}" for name, value in camera.items() if name != "radial")
    return f"{numbers} (pixels)" + (", radial" if camera.get("radial") else "")


def _own(name: str) -> str:
    return resources.files("planewise.gallery").joinpath(name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    """Say to the browser's content security policy that this text is ours."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _as_json(value: object) -> str:
    """JSON that cannot end the element it stands in."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _in_blocks(
    frames: Iterator[tuple[dict[str, Any], str | None]],
) -> Iterator[tuple[list[dict[str, Any]], list[str | None]]]:
    while block := list(islice(frames, _BLOCK)):
        yield [record for record, _ in block], [picture for _, picture in block]
