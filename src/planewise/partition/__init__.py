"""Partition of a frame into regions: any labels or masks, blocks, a graph, Segment Anything.

>>> import planewise as pw
>>> pw.partition.Blocks(rows=120, columns=160).describe()
'blocks of 120 x 160 pixels'
"""

from planewise.partition.blocks import Blocks
from planewise.partition.graph import Graph
from planewise.partition.options import PartitionOptions
from planewise.partition.partitioner import (
    NAMES,
    GivenRegions,
    Partition,
    Partitioner,
    View,
    as_partitioner,
    describe,
    regions_of,
    tells_itself,
)
from planewise.partition.regions import regions_of_labels, regions_of_masks
from planewise.partition.segment_anything import SegmentAnything

__all__ = [
    "NAMES",
    "Blocks",
    "GivenRegions",
    "Graph",
    "Partition",
    "PartitionOptions",
    "Partitioner",
    "SegmentAnything",
    "View",
    "as_partitioner",
    "describe",
    "regions_of",
    "regions_of_labels",
    "regions_of_masks",
    "tells_itself",
]
