"""Scores of predicted label images against true ones: VOI, RI, SC, precision and recall."""

from planewise.metrics.contingency import ContingencyTable, clustering, contingency_table
from planewise.metrics.hoover import hoover_counts
from planewise.metrics.scores import (
    MINIMUM_PIXELS,
    Detection,
    FrameScores,
    detection,
    evaluate,
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
