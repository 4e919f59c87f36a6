"""Whole datasets: frames by the thousand, on one machine or many, into a store that survives.

``planewise batch`` on the command line; `Store` reads what it wrote.
"""

from planewise.batch.frame_work import Outcome, Recipe
from planewise.batch.local_engine import LocalEngine
from planewise.batch.open_source import open_source
from planewise.batch.ray_engine import RayEngine
from planewise.batch.run import Batch, Plan, Run
from planewise.batch.source import DepthFolder, Selection, Source
from planewise.batch.store import Store, StoredFrame

__all__ = [
    "Batch",
    "DepthFolder",
    "LocalEngine",
    "Outcome",
    "Plan",
    "RayEngine",
    "Recipe",
    "Run",
    "Selection",
    "Source",
    "Store",
    "StoredFrame",
    "open_source",
]
