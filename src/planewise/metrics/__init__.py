"""Scores of planes against labels: VOI, RI, SC, precision and recall."""

from planewise.metrics.scores import (
    MINIMUM_PIXELS,
    ContingencyTable,
    Detection,
    FrameScores,
    clustering,
    contingency_table,
    detection,
    evaluate,
    hoover_counts,
    plane_errors,
    summarise,
)

__all__ = [
    "MINIMUM_PIXELS",
    "ContingencyTable",
    "Detection",
    "FrameScores",
    "clustering",
    "contingency_table",
    "detection",
    "evaluate",
    "hoover_counts",
    "plane_errors",
    "summarise",
]
