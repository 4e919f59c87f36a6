"""Results of a store in formats that other programs read.

>>> from planewise.exports import FORMATS
>>> sorted(FORMATS)
['coco', 'npz', 'planercnn', 'png']
"""

from planewise.exports.coco import CocoExport
from planewise.exports.export import Exported, export
from planewise.exports.form import Form
from planewise.exports.npz import NpzExport
from planewise.exports.planercnn import PlaneRcnnExport
from planewise.exports.png import PngExport

FORMATS: dict[str, type[Form]] = {
    "coco": CocoExport,
    "planercnn": PlaneRcnnExport,
    "png": PngExport,
    "npz": NpzExport,
}
"""Formats by name."""

__all__ = [
    "FORMATS",
    "CocoExport",
    "Exported",
    "Form",
    "NpzExport",
    "PlaneRcnnExport",
    "PngExport",
    "export",
]
