"""The two tables of a store as Arrow and Parquet."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planewise.batch.columns import DONE, FRAMES, OF_ALL, OF_DONE, PLANES, SCHEMA_VERSION
from planewise.errors import PlanewiseError, in_one_line, needs

if TYPE_CHECKING:
    import pyarrow as pa

_ROW_GROUP = 16_384


def arrow() -> Any:
    """Import pyarrow.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    with needs("pyarrow", "a store of many frames", "batch"):
        import pyarrow.compute  # not loaded with pyarrow, nor always with Parquet
        import pyarrow.parquet
    import pyarrow

    return pyarrow


def schema_of(columns: dict[str, str]) -> pa.Schema:
    """Arrow schema of `columns.FRAMES` or `columns.PLANES`."""
    pa = arrow()
    kinds = {"list<double>": pa.list_(pa.float64())}
    return pa.schema(
        [(name, kinds.get(kind) or pa.type_for_alias(kind)) for name, kind in columns.items()],
        metadata={"planewise_schema_version": str(SCHEMA_VERSION)},
    )


def tables_of(records: Iterable[bytes]) -> tuple[pa.Table, pa.Table]:
    """Frames and planes of records of a journal, in the order of the source.

    A record that comes later replaces one of the same frame.
    """
    rows = {}
    for record in map(json.loads, records):
        rows[record["frame"]["frame"]] = record
    ordered = sorted(rows.values(), key=lambda row: int(row["frame"]["number"]))
    pa = arrow()
    frames = {name: [row["frame"].get(name) for row in ordered] for name in FRAMES}
    planes = [plane for row in ordered for plane in row["planes"]]
    by_column = zip(*planes, strict=True) if planes else ([] for _ in PLANES)
    return (
        pa.Table.from_pydict(frames, schema=schema_of(FRAMES)),
        pa.Table.from_pydict(
            dict(zip(PLANES, map(list, by_column), strict=True)), schema=schema_of(PLANES)
        ),
    )


def parquet_of(table: pa.Table) -> bytes:
    """Parquet file of a table."""
    pa = arrow()
    sink = pa.BufferOutputStream()
    pa.parquet.write_table(table, sink, compression="zstd", row_group_size=_ROW_GROUP)
    return bytes(sink.getvalue())


def read_table(path: Path, columns: dict[str, str]) -> pa.Table:
    """Read some columns of a Parquet file, by Arrow's names of their types.

    Raises
    ------
    PlanewiseError
        If it is missing or damaged.
    """
    pa = arrow()
    try:
        table = pa.parquet.read_table(path, columns=list(columns), partitioning=None)
    except FileNotFoundError:
        raise PlanewiseError(f"store: {path} is missing") from None
    except (pa.ArrowException, OSError) as error:
        if getattr(error, "errno", None) is not None:  # the system's: may not be read, and so on
            raise
        raise PlanewiseError(f"store: {path} is damaged ({in_one_line(error)})") from None
    if not table.schema.equals(schema_of(columns)):
        raise PlanewiseError(f"store: {path} is damaged: its columns are not those of a store")
    return table


def lacking(frames: pa.Table) -> str:
    """Column that some frame should have and has not, of those that were read; empty if none."""
    compute = arrow().compute
    done = frames.filter(compute.equal(frames["status"], DONE))
    for names, table in ((OF_ALL, frames), (OF_DONE, done)):
        for name in names:
            if name in table.column_names and table[name].null_count:
                return name
    return ""
