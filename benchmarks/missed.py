"""Which true planes are missed: prints a Markdown table of medians.

python -m benchmarks.missed [--data FOLDER]

A plane is found if a label covers it at an IoU of 0.5. share: of the image; cosine: of the angle
between normal and line of sight; none: share of its readings that were given no plane. unlabelled:
share of the planes found that lie mostly where the truth has none.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.arguments import parser_of
from benchmarks.frames import DATA
from benchmarks.labelled import AbsentError, LabelledFrame, frames_of
from benchmarks.rival_points import metres

Row = tuple[float, float, float, float, float]
FEWEST = 50  # readings
FITTED = 5000  # readings that a true plane's normal comes from


def judged(each: LabelledFrame) -> tuple[list[Row], list[float]]:
    """Rows (found, share, depth, cosine, none) of true planes, and unlabelled shares of ours."""
    frame = each.frame
    labels = frame.detect(threads=1, instances=each.per_surface).labels
    z = np.nan_to_num(metres(frame))
    points = frame.camera.rays((z.shape[0], z.shape[1])) * z[..., None]
    rows = []
    for number in np.unique(each.truth[each.truth > 0]):
        true = each.truth == number
        seen = true & (z > 0)
        if seen.sum() < FEWEST:
            continue
        covered = np.bincount(labels[true], minlength=2)
        best = int(covered[1:].argmax()) + 1
        found = covered[best] > 0.5 * (true | (labels == best)).sum()
        sample = points[seen][:: max(1, int(seen.sum()) // FITTED)]
        centre = sample.mean(axis=0)
        normal = np.linalg.svd(sample - centre, full_matrices=False)[2][2]
        cosine = abs(normal @ centre) / np.linalg.norm(centre)
        none = float((labels[seen] == 0).mean())
        rows.append((float(found), seen.mean(), float(np.median(z[seen])), float(cosine), none))
    outside = [
        float((each.truth[labels == j] == 0).mean()) for j in range(1, int(labels.max()) + 1)
    ]
    return rows, outside


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--data", type=Path, default=DATA)
    given = parser.parse_args()
    print("| set | true planes | n | share | depth, m | cosine | none | unlabelled |")
    print("|---|---|---|---|---|---|---|---|")
    for name in ("nyu_dpd", "abw_segcomp", "mosd_boxes", "mosd_curved", "rooms"):
        try:
            results = [judged(each) for each in frames_of(name, given.data)]
        except AbsentError:
            continue
        rows = np.array([row for planes, _ in results for row in planes])
        outside = np.array([share for _, shares in results for share in shares])
        for kind, hit in (("found", 1), ("missed", 0)):
            mine = rows[rows[:, 0] == hit]
            if not len(mine):
                continue
            share, depth, cosine, none = np.median(mine[:, 1:], axis=0)
            more = f"{(outside > 0.5).mean():.2f}" if hit else ""
            print(
                f"| {name} | {kind} | {len(mine)} | {share:.3f} | {depth:.2f} | {cosine:.2f} | "
                f"{none:.2f} | {more} |"
            )


if __name__ == "__main__":
    main()
