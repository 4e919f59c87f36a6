"""Readers of datasets: frames with camera, picture and true planes, one at a time.

>>> from planewise import datasets
>>> [name for name in datasets.__all__ if name[0].islower()]
['open_nyu']
"""

from planewise.datasets.archives import ArchiveFolder
from planewise.datasets.frames import Dataset, DatasetFrame
from planewise.datasets.nyu import NyuFolder, NyuLabelled, open_nyu

__all__ = [
    "ArchiveFolder",
    "Dataset",
    "DatasetFrame",
    "NyuFolder",
    "NyuLabelled",
    "open_nyu",
]
