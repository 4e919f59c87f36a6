"""Flatness: whether planes are ranked by how flat they are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planewise import scenes
from planewise.metrics import contingency_table
from planewise.reproduce.experiment import (
    TRUE_SIGMA,
    Experiment,
    Measured,
    Row,
    Settings,
    Trial,
)
from planewise.reproduce.methods import OPEN3D, OURS, PAPER, WORDS, Frame, detect
from planewise.reproduce.pictures import depth, mask
from planewise.reproduce.scores import scored
from planewise.reproduce.section import Check, Pictures, Section, Table, length, spread
from planewise.scenes.scene import Scene
from planewise.wording import counted

PERIODS = (0, 2, 10, 100)
"""f of the bands from left to right."""

INLIER_RATIO, MOST = 0.25, 8
_RIGHT = ", ".join(map(str, PERIODS))


def _scene(size: tuple[int, int]) -> Scene:
    return scenes.flatness(amplitude=TRUE_SIGMA, size=size)


def _trials(settings: Settings) -> list[Trial]:
    # The scene has no noise: seeds are those of the methods' samples.
    return [
        Trial(scene="flatness", seed=seed, size=settings.size, methods=settings.methods)
        for seed in range(settings.seeds)
    ]


def order_found(scene: Scene, labels: NDArray[np.integer]) -> list[int]:
    """f of the band that most readings of each found plane are in, the best plane first."""
    table = contingency_table(labels, scene.labels)
    return [PERIODS[band] for band in table.counts[1:, 1:].argmax(axis=0).tolist()]


def _measure(trial: Trial) -> list[Measured]:
    scene = _scene(trial.size)
    out = []
    for method in trial.methods:
        found = detect(
            method,
            Frame.of(
                scene, TRUE_SIGMA, inlier_ratio=INLIER_RATIO, max_planes=MOST, seed=trial.seed
            ),
        )
        order = ", ".join(map(str, order_found(scene, found.labels)))
        row = {"method": method, "seed": trial.seed, "order": order} | scored(scene, found)
        out.append(Measured(row=row, labels=found.labels if trial.seed == 0 else None))
    return out


def _section(settings: Settings, measured: Sequence[Measured]) -> Section:
    rows = [each.row for each in measured]
    return Section(
        title="Flatness",
        text=(
            "Four upright bands of equal size stand at 2.5, 2.7, 2.9 and 3.1 m. From left to right "
            f"a sine of {length(TRUE_SIGMA)} runs along the height of the image with "
            f"f = {_RIGHT} periods, as in the code of the paper's authors (its text says along "
            "the width): the first band is flat, the others ever less so. The assumed "
            "σ is the amplitude. The planes should come out as four, ranked in the order of f.",
            "The scene has no noise, so only the samples of the paper's search and of Open3D "
            "differ from run to run. Open3D does not rank; its order is that in which planes were "
            "taken out.",
        ),
        blocks=(_table(settings, rows), _masks(settings, measured)),
        remarks=_open3d(settings, rows),
        checks=[
            *_order_checks(rows, PAPER, claim=True),
            *_order_checks(rows, OURS, claim=False),
        ],
        files={"flatness": rows},
    )


def _of(rows: Sequence[Row], method: str) -> list[Row]:
    return [row for row in rows if row["method"] == method]


def _table(settings: Settings, rows: Sequence[Row]) -> Table:
    cells = []
    for method in settings.methods:
        mine = _of(rows, method)
        right = sum(row["order"] == _RIGHT for row in mine)
        cells.append(
            (
                method,
                spread([row["planes"] for row in mine], 1),
                spread([row["true_planes_found"] for row in mine], 1),
                spread([row["voi_bits"] for row in mine], 3),
                mine[0]["order"],
                f"{right} of {len(mine)}",
            )
        )
    return Table(
        caption="Planes found, and the f of their bands in the order of their rank.",
        header=(
            "method", "planes", "true ones found", "VOI (bits)", "order of f, first run",
            "runs in the right order",
        ),
        rows=cells,
        heads=1,
    )  # fmt: skip


def _masks(settings: Settings, measured: Sequence[Measured]) -> Pictures:
    scene = _scene(settings.size)
    given = [
        depth(scene, "flatness-depth"),
        mask(scene, scene.labels, "flatness-truth", "truth", f"f = {_RIGHT}"),
    ]
    shown = []
    for each in measured:
        if each.labels is not None:
            method, order = each.row["method"], each.row["order"]
            file, note = f"flatness-{WORDS[method]}", f"ranked f = {order}"
            shown.append(mask(scene, each.labels, file, method, note))
    return Pictures(
        caption=(
            "Planes found in the first run. Bands from left to right: f = 0, 2, 10 and 100. "
            "Colours are those of the truth, and others for what was found besides."
        ),
        rows=[("the scene", given), (f"assumed σ = {length(TRUE_SIGMA)}", shown)],
    )


def _open3d(settings: Settings, rows: Sequence[Row]) -> tuple[str, ...]:
    """What happens to Open3D, in words."""
    if OPEN3D not in settings.methods:
        return ()
    mine = _of(rows, OPEN3D)
    planes = spread([row["planes"] for row in mine], 1)
    found = spread([row["true_planes_found"] for row in mine], 1)
    return (
        f"Open3D makes {planes} planes of the four and finds {found} of them by more than half: "
        "what its threshold leaves of a wavy band, crests or troughs, becomes planes of its own.",
    )


def _order_checks(rows: Sequence[Row], method: str, *, claim: bool) -> list[Check]:
    orders = [row["order"] for row in _of(rows, method)]
    right = orders.count(_RIGHT)
    text = f"{'the ' if claim else ''}{method} finds the bands in the order of f"
    return [
        Check(
            text=text,
            measured=f"{right} of {counted(len(orders), 'run')}",
            met=right == len(orders),
            claim=claim,
        )
    ]


FLATNESS = Experiment(
    name="flatness",
    trials=_trials,
    measure=_measure,
    section=_section,
    files=(
        "flatness.csv",
        "flatness-depth.png",
        "flatness-truth.png",
        *(f"flatness-{WORDS[method]}.png" for method in (OPEN3D, PAPER, OURS)),
    ),
)
