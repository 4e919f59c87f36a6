"""A run: what is still to do of a source goes through an engine into a store."""

from __future__ import annotations

import json
import logging
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from planewise.batch.columns import DONE, FAILED
from planewise.batch.engine import Engine
from planewise.batch.frame_names import label_path
from planewise.batch.frame_work import FrameWork, Outcome, Recipe, identity
from planewise.batch.label_png import has_its_end
from planewise.batch.lock import ALL, beside, lock_files, locked, rewriting, writer_name
from planewise.batch.segments import FOLDERS, Segment, segments_of
from planewise.batch.source import Selection, Source
from planewise.batch.staging import Staging
from planewise.batch.store import Store
from planewise.batch.store_info import check_same, info_of
from planewise.batch.store_writer import StoreWriter, opened
from planewise.batch.tables import arrow
from planewise.errors import PlanewiseError
from planewise.files.labels import STORE_FILE
from planewise.whole_files import parent_folder, remove_empty
from planewise.wording import counted

_LOG = logging.getLogger("planewise")

_UNFINISHED = ".unfinished-"
_DAMAGED = "damaged"  # status of a frame whose label image is lost
_TOLD = {  # columns by which a frame shows that it is not what it was
    "fingerprint": "other readings",
    "depth_scale": "another unit of depth",
    **dict.fromkeys(("fx", "fy", "cx", "cy", "distortion", "camera"), "another camera"),
}
_LOOKED_AT = 5  # frames of a store that is gone on with, whether they are what they were


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What a run does.

    Attributes
    ----------
    selected : int
        Frames that are asked for.
    done, failed : int
        Of those, what the store holds already, and what failed before and is not tried again.
    to_do : list of (int, str)
        Number and id of the others.
    damaged : frozenset of str
        Of those to do, what is in the store but for its label image, which is missing or cut short.
    """

    selected: int
    done: int
    failed: int
    to_do: list[tuple[int, str]]
    damaged: frozenset[str] = frozenset()


@dataclass(frozen=True, kw_only=True)
class Batch:
    """Many frames, one store.

    Parameters
    ----------
    source : Source
        Where frames come from: a `DepthFolder`, or any of `planewise.datasets`.
    store : path
        Folder of the store: new, empty, or one that was made with the same recipe.
    recipe : Recipe
        What is done with every frame.
    selection : Selection
        Which frames.
    retry_failed : bool
        Try frames again that failed before.

    Notes
    -----
    Workers import the main module again: a script starts them under ``if __name__ == "__main__":``.

    Examples
    --------
    >>> import planewise as pw
    >>> from planewise.batch import Batch, DepthFolder, LocalEngine, Recipe
    >>> recipe = Recipe(
    ...     sensor=pw.sensors.KINECT_V1, options=pw.Options(), camera=pw.cameras.NYU
    ... )
    >>> def all_of(folder, store):
    ...     batch = Batch(source=DepthFolder(folder), store=store, recipe=recipe)
    ...     with batch.started(LocalEngine(workers=2)) as run:
    ...         for outcome in run:
    ...             print(outcome.frame, outcome.planes, outcome.reason)
    >>> if __name__ == "__main__":
    ...     all_of("frames", "store")
    """

    source: Source
    store: Path
    recipe: Recipe
    selection: Selection = field(default_factory=Selection)
    retry_failed: bool = False

    def plan(self) -> Plan:
        """Say what there is to do; nothing is written.

        Raises
        ------
        PlanewiseError
            If the store cannot be used: made with other options, or from another source.
        """
        return self._plan(readings=True, labels=True)

    def _plan(self, *, readings: bool, labels: bool) -> Plan:
        """Say what there is to do; readings are held against the store's, labels looked for."""
        arrow()
        selected = self.selection.of(self.source.ids)
        statuses = self._statuses(compared=readings)
        damaged: set[str] = set()
        if labels and self.recipe.labels == "png":
            stored = (frame for _, frame in selected if statuses.get(frame) == DONE)
            folder = Path(self.store)
            damaged = {each for each in stored if not has_its_end(folder / label_path(each))}
            statuses |= dict.fromkeys(damaged, _DAMAGED)
        left_out = {DONE} if self.retry_failed else {DONE, FAILED}
        done = sum(statuses.get(frame) == DONE for _, frame in selected)
        failed = sum(statuses.get(frame) in left_out - {DONE} for _, frame in selected)
        to_do = [each for each in selected if statuses.get(each[1]) not in left_out]
        return Plan(
            selected=len(selected),
            done=done,
            failed=failed,
            to_do=to_do,
            damaged=frozenset(damaged),
        )

    @contextmanager
    def started(self, engine: Engine) -> Iterator[Run]:
        """Lock the store, make it if need be, and give the run; at the end all is committed.

        A store that was made here goes again if an error, or Ctrl-C, ends the run before its first
        frame.

        Raises
        ------
        PlanewiseError
            If the store cannot be used, or another process uses it.
        OSError
            If there is no room.
        """
        self._plan(readings=True, labels=False)
        folder = Path(self.store)
        if (folder / STORE_FILE).exists():
            self._make_way(folder)
        new = not (folder / STORE_FILE).exists()
        with parent_folder(folder):
            try:
                with self._held(folder, engine) as run:
                    yield run
            except BaseException:
                if new:
                    _remove_without_frames(folder)
                raise

    def _make_way(self, folder: Path) -> None:
        """Remove a store of another batch of which no frame is done, unless it is being filled."""
        here = info_of(self.source, self.recipe)
        if not self._supersedes(Store(folder), here):
            return
        with suppress(PlanewiseError), locked(folder):
            if self._supersedes(Store(folder), here):  # still, now that nobody else can change it
                _LOG.warning(
                    f"{folder} was made with other options or of other frames, but none was done: "
                    "it is begun anew"
                )
                for name in FOLDERS:
                    shutil.rmtree(folder / name)
                (folder / STORE_FILE).unlink()  # last: without it, frames are no store

    @contextmanager
    def _held(self, folder: Path, engine: Engine) -> Iterator[Run]:
        """Lock the store in its folder, and give the run."""
        writer = writer_name(self.selection.shard, self.selection.every)
        with locked(folder, writer):
            staging = Staging(folder / f"{_UNFINISHED}{writer}")
            try:
                self._begin(folder, writer, staging)
                # Once more, now that nobody else can change it.
                plan = self._plan(readings=False, labels=True)
                stored = Store(folder)
                with opened(folder, writer, staging) as store:
                    yield Run(FrameWork(self.source, self.recipe), plan, stored, store, engine)
            finally:
                staging.close()

    def _statuses(self, *, compared: bool) -> dict[str, str]:
        """Status of every frame of the store, which is checked to be of this batch."""
        folder = Path(self.store)
        if not (folder / STORE_FILE).exists():
            _check_empty(folder)
            return {}
        store, here = Store(folder), info_of(self.source, self.recipe)
        if compared and self._supersedes(store, here):
            return {}
        check_same(folder, store.info, here)
        known = dict.fromkeys(store.ids, DONE) | dict.fromkeys(store.failed, FAILED)
        strange = known.keys() - set(self.source.ids)
        if strange:
            raise PlanewiseError(
                f"store: {folder} holds {counted(len(strange), 'frame')} that "
                f"{self.source.name} does not have, such as {min(strange)}: it is of another source"
            )
        if store.info["source"]["ids_sha256"] != here["source"]["ids_sha256"]:
            raise PlanewiseError(
                f"store: {folder} was made of {counted(store.info['source']['frames'], 'frame')}, "
                f"and {self.source.name} has {len(self.source.ids):,} now, which changes their "
                "numbers; give a new folder"
            )
        if compared:
            self._check_readings(store)
        return known

    @staticmethod
    def _supersedes(store: Store, here: Mapping[str, Any]) -> bool:
        """Whether the store is of another batch, and none of its frames is done."""
        same = store.info["source"]["ids_sha256"] == here["source"]["ids_sha256"]
        try:
            check_same(store.path, store.info, here)
        except PlanewiseError:
            same = False
        return not same and not store.ids

    def _check_readings(self, store: Store) -> None:
        """See by a few frames, the first and the last too, whether all are what they were."""
        places = np.linspace(0, len(store.ids) - 1, min(_LOOKED_AT, len(store.ids)))
        for frame in (store.ids[round(place)] for place in places.tolist()):
            try:
                now = identity(self.source[frame], self.recipe)
            except (ValueError, OSError):
                continue
            there = store[frame].row
            for name, other in _TOLD.items():
                if now.get(name) != there[name]:
                    raise PlanewiseError(
                        f"store: the frame {frame} of {self.source.name} has {other} than the one "
                        f"that {self.store} was made from; give a new folder"
                    )

    def _begin(self, folder: Path, writer: str, staging: Staging) -> None:
        for name in FOLDERS:
            (folder / name).mkdir(exist_ok=True)
        if not (folder / STORE_FILE).exists():
            text = json.dumps(info_of(self.source, self.recipe), indent=2, allow_nan=False)
            staging.publish(text.encode() + b"\n", folder / STORE_FILE)
        if writer == ALL:
            for left in set(folder.glob(f"{_UNFINISHED}*")) - {staging.folder}:
                shutil.rmtree(left)  # by a shard that was killed
        again: set[str] = set()
        if self.retry_failed:
            again.update(frame for _, frame in self.selection.of(self.source.ids))
        for segment in segments_of(folder):
            # Of other shards only those of the same cut may be under way.
            mine = segment.writer == writer
            if again and (mine or not beside(segment.writer, writer)):
                with rewriting(folder):
                    segment.forget_failed(again, staging)
            if writer == ALL and not mine:
                segment.seal(staging)


@dataclass(frozen=True)
class Run:
    """A run under way; iterating does it.

    Attributes
    ----------
    plan : Plan
        What it does.
    """

    _work: FrameWork
    plan: Plan
    _stored: Store
    _store: StoreWriter
    _engine: Engine

    def __iter__(self) -> Iterator[Outcome]:
        """Do the frames; give each when it is handed to the store.

        Raises
        ------
        PlanewiseError
            If no frame can be done at all, such as without a package that all need.
        """
        if not self.plan.to_do:
            return
        outcomes: Any = self._engine.run(self._work, self.plan.to_do)
        try:
            for outcome in outcomes:
                if outcome.fatal:
                    raise PlanewiseError(outcome.fatal)
                if outcome.frame in self.plan.damaged:
                    outcome = self._mended(outcome)
                else:
                    self._store.add(outcome)
                yield outcome
        finally:
            outcomes.close()

    def _mended(self, outcome: Outcome) -> Outcome:
        """Store the label image of a frame that has lost it; its rows stay, whatever happens."""
        reason = outcome.reason
        if not reason:
            now, there = json.loads(outcome.record)["frame"], self._stored[outcome.frame].row
            if all(now.get(name) == there[name] for name in ("planes", *_TOLD)):
                self._store.add(replace(outcome, record=b""))
                return outcome
            reason = "its readings, camera or planes are no longer those of the store"
        return replace(
            outcome, reason=f"its label image is lost, and cannot be made again: {reason}"
        )


def _check_empty(folder: Path) -> None:
    """Refuse to make a store among files of others."""
    if folder.exists() and not folder.is_dir():
        raise PlanewiseError(f"output: {folder} exists and is not a folder")
    if not folder.exists():
        return
    ours = set(FOLDERS)
    others = [p.name for p in folder.iterdir() if p.name not in ours and not p.name.startswith(".")]
    if others:
        raise PlanewiseError(
            f"output: {folder} holds {min(others)}, but no store; give a new folder"
        )
    if _holds_frames(folder):
        raise PlanewiseError(
            f"store: {folder} holds frames, but not {STORE_FILE}, which says how they were made; "
            "give a new folder"
        )


def _holds_frames(folder: Path) -> bool:
    """Whether there is anything of a frame, be it a label image alone."""
    labels = folder / "labels"
    there = labels.is_dir() and any(labels.iterdir())
    return there or any(map(Segment.holds_frames, segments_of(folder)))


def _remove_without_frames(folder: Path) -> None:
    """Remove a store that nothing of a frame is in, unless another process uses it."""
    with suppress(PlanewiseError, OSError), locked(folder):
        if _holds_frames(folder):
            return
        for path in (folder / STORE_FILE, *(each.journal for each in segments_of(folder))):
            path.unlink(missing_ok=True)
        remove_empty([folder / name for name in FOLDERS])
        for path in lock_files(folder):
            path.unlink()
