"""Two planes at an angle: errors of normals and distances against the Cramer-Rao bound."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planewise import scenes
from planewise.reproduce.angle_errors import ERRORS, RIGHT, Case, cases, limits
from planewise.reproduce.bound import Bound, cramer_rao, with_rounding
from planewise.reproduce.charts import Line, errors_chart
from planewise.reproduce.experiment import (
    SIGMAS,
    TRUE_SIGMA,
    Experiment,
    Measured,
    Row,
    Settings,
    Trial,
)
from planewise.reproduce.methods import OURS, Frame, detect
from planewise.reproduce.scores import parameter_errors, placed
from planewise.reproduce.section import Chart, Check, Section, Table, length
from planewise.scenes.scene import Scene
from planewise.wording import counted

ANGLES_DEGREES = (60, 70, 80, 90, 100, 110, 120, 130, 140, 150, 160, 165, 170, 175)
_QUICK_ANGLES = (60, 90, 120, 150, 170)
INLIER_RATIO, MOST = 0.15, 2

WITHIN = 1.2
"""Error divided by the bound that ours may have: the target."""

_MORE = 4
"""Times as many frames for planewise as for the others: its ratio to the bound needs them."""

_STEP = 0.001  # of the scenes' depth, metres


def _angles(settings: Settings) -> tuple[int, ...]:
    return _QUICK_ANGLES if settings.quick else ANGLES_DEGREES


def _scene(angle: float, size: tuple[int, int], seed: int = 0) -> Scene:
    # Noise of its own at every angle: else all ratios to the bound would be off together.
    rng = np.random.default_rng((seed, round(angle)))
    return scenes.two_planes(angle, sigma=TRUE_SIGMA, size=size, rng=rng)


def _trials(settings: Settings) -> list[Trial]:
    return [
        Trial(
            scene="two_planes",
            seed=seed,
            size=settings.size,
            methods=settings.methods if seed < settings.seeds else (OURS,),
            angle=angle,
        )
        for angle in _angles(settings)
        for seed in range(_MORE * settings.seeds)
    ]


def _measure(trial: Trial) -> list[Measured]:
    scene = _scene(trial.angle, trial.size, trial.seed)
    middle = (scene.depth + 0.5) * _STEP
    out = []
    for sigma in SIGMAS:
        for method in trial.methods:
            frame = Frame.of(
                scene,
                sigma,
                depth=middle,
                inlier_ratio=INLIER_RATIO,
                max_planes=MOST,
                seed=trial.seed,
            )
            found = detect(method, frame)
            errors = parameter_errors(scene, found)
            row: Row = {
                "angle_deg": trial.angle,
                "sigma_m": sigma,
                "method": method,
                "seed": trial.seed,
                "planes": len(found.planes),
                "share_right": placed(scene, found.labels).share_right,
            }
            for plane in range(2):
                row[f"normal_error_deg_{plane + 1}"] = float(errors.normals[plane])
                row[f"distance_error_mm_{plane + 1}"] = 1000 * float(errors.distances[plane])
            out.append(Measured(row=row))
    return out


def _section(settings: Settings, measured: Sequence[Measured]) -> Section:
    rows = [each.row for each in measured]
    sigma = with_rounding(TRUE_SIGMA, _STEP)
    bounds = {
        float(angle): cramer_rao(_scene(angle, settings.size), sigma) for angle in _angles(settings)
    }
    found = cases(rows, bounds)
    frames = _MORE * settings.seeds
    return Section(
        title="Two planes at an angle",
        text=(
            "Two planes meet in a ridge along the middle row of the image, 1 m away, at angles "
            f"from {_angles(settings)[0]} to {_angles(settings)[-1]} degrees; the paper stops at "
            f"150. White noise of {length(TRUE_SIGMA)}, N = {MOST}, r = {INLIER_RATIO}. Errors are "
            f"root mean squares over both planes and {counted(settings.seeds, 'frame')}, for "
            f"planewise {frames}; each true plane is held against the plane on which most of its "
            "readings were put.",
            "The dashed line is the Cramér–Rao bound: no unbiased method can do better on average, "
            "even if it is told which reading is on which plane. Rounding depth down to "
            "millimetres would move all planes by half a millimetre, many times the bound of a "
            "distance. Here every method is therefore given the middle of the step, and the bound "
            "is that of the noise with the variance of the step, step²/12, added.",
        ),
        blocks=(_chart(settings, found, bounds), _table(found)),
        remarks=(
            f"A ratio from {counted(frames, 'frame')} is itself uncertain by about "
            f"{_uncertainty(frames, 2):.0%} for normals and {_uncertainty(frames, 1):.0%} for "
            "distances (one standard deviation).",
        ),
        checks=_checks(found, quick=settings.quick),
        files={
            "angles": [case.row() for case in found],
            "angles-bound": [
                {"angle_deg": angle} | {f"rms_{key}": value for key, value in limits(b).items()}
                for angle, b in bounds.items()
            ],
            "angles-frames": rows,
        },
    )


def _uncertainty(frames: int, parts: int) -> float:
    """Relative standard deviation of a root mean square of so many numbers a plane and frame."""
    return 1 / math.sqrt(2 * 2 * parts * frames)


def _chart(settings: Settings, found: Sequence[Case], bounds: dict[float, Bound]) -> Chart:
    lines = [
        Line(
            panel=(key, sigma),
            name=method,
            x=[case.angle for case in mine],
            y=[case.errors[key] for case in mine],
        )
        for key in ERRORS
        for sigma in SIGMAS
        for method in settings.methods
        for mine in [[c for c in found if (c.sigma, c.method) == (sigma, method)]]
    ]
    least = {angle: limits(bound) for angle, bound in bounds.items()}
    return Chart(
        name="angles",
        alt=(
            "Six charts of the errors of normals, above, and distances, below, against the angle, "
            f"for an assumed noise of {', '.join(map(length, SIGMAS))}: "
            f"{', '.join(settings.methods)}, and the Cramér–Rao bound. The numbers are in "
            "angles.csv and, for planewise, in the table."
        ),
        caption=(
            "Root mean square errors against the angle between the planes; all charts of a row "
            "have one logarithmic scale. A point is missing where no plane was found."
        ),
        svg=errors_chart(
            lines,
            bound={key: [least[angle][key] for angle in least] for key in ERRORS},
            angles=list(least),
            columns={sigma: f"assumed σ = {length(sigma)}" for sigma in SIGMAS},
            rows={ERRORS[0]: "normal error (degrees)", ERRORS[1]: "distance error (mm)"},
        ),
    )


def _table(found: Sequence[Case]) -> Table:
    ours = {(case.angle, case.sigma): case for case in found if case.method == OURS}
    return Table(
        caption=(
            "planewise: share of the readings that are on their plane, and the errors of normals "
            "and distances divided by the bound. In brackets where the labelling is not right: "
            f"not two planes, or fewer than {RIGHT:.0%} of the readings on theirs, in some frame."
        ),
        header=("angle", *("right", "normal", "distance") * len(SIGMAS)),
        groups=[(f"assumed σ = {length(sigma)}", 3) for sigma in SIGMAS],
        rows=[
            (
                f"{angle:g}°",
                *(text for sigma in SIGMAS for text in _cells(ours[angle, sigma])),
            )
            for angle in dict.fromkeys(case.angle for case in found)
        ],
        heads=1,
    )


def _cells(case: Case) -> tuple[str, ...]:
    shown = (
        f"{case.share_right:.1%}",
        *(f"{case.ratios[key]:.2f}" if math.isfinite(case.ratios[key]) else "–" for key in ERRORS),
    )
    return shown if case.labelled_right else tuple(f"({each})" for each in shown)


def _checks(found: Sequence[Case], *, quick: bool) -> list[Check]:
    ours = {(case.angle, case.sigma): case for case in found if case.method == OURS}
    right = [case for case in ours.values() if case.labelled_right]
    ratios = [case.ratios[key] for case in right for key in ERRORS]
    within = sum(each <= WITHIN for each in ratios)
    near = all(
        case.ratios[key] * _luckiest(case, key) <= WITHIN for case in right for key in ERRORS
    )
    others = [case for case in found if case.method != OURS]
    pairs = [(ours[case.angle, case.sigma], case, key) for case in others for key in ERRORS]
    better = [_beats(mine, theirs, key) for mine, theirs, key in pairs]
    lost = [pair for pair, won in zip(pairs, better, strict=True) if not won]
    close = all(
        mine.errors[key] * _luckiest(mine, key) * _luckiest(theirs, key) <= theirs.errors[key]
        for mine, theirs, key in lost
    )
    names = " and ".join(dict.fromkeys(case.method for case in others))
    return [
        Check(
            text=f"planewise stays within {WITHIN} times the bound wherever its labelling is right",
            measured=(
                f"{within} of {len(ratios)} errors at {len(right)} of {len(ours)} settings"
                + (f"; largest ratio {max(ratios):.2f}" if ratios else "")
            ),
            met=within == len(ratios) > 0,
            open=quick and within < len(ratios) and near,
        ),
        Check(
            text=f"planewise has smaller errors than {names} at every angle and assumed σ",
            measured=f"{sum(better)} of {len(better)} comparisons",
            met=all(better),
            open=quick and bool(lost) and close,
        ),
    ]


def _luckiest(case: Case, key: str) -> float:
    """Share of an error that is left where two standard deviations of it are chance."""
    return max(0.0, 1 - 2 * _uncertainty(case.frames, 2 if key == ERRORS[0] else 1))


def _beats(ours: Case, other: Case, key: str) -> bool:
    """Smaller error, with planes missed in no larger share of the frames."""
    missed_more = ours.missed / ours.frames > other.missed / other.frames
    if missed_more or not math.isfinite(ours.errors[key]):
        return False
    return not math.isfinite(other.errors[key]) or ours.errors[key] < other.errors[key]


ANGLES = Experiment(
    name="angles",
    trials=_trials,
    measure=_measure,
    section=_section,
    files=("angles.csv", "angles-frames.csv", "angles-bound.csv", "angles.svg"),
)
