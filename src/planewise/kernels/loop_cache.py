"""Compiled loops on disk: what Numba keeps of them, loaded in half the time.

A call needs the machine code of a loop alone. Its bitcode, twice as large, is for loops that call
it, and is parsed when one of these is compiled. What types its variables have, which only
`inspect_types` prints, is not kept.
"""

from __future__ import annotations

import logging
from typing import Any

from llvmlite import binding as llvm
from numba.core.caching import CompileResultCacheImpl, FunctionCache

_LOG = logging.getLogger("planewise")


class _MachineCode(CompileResultCacheImpl):
    """How one loop is written and read."""

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        """Name of its files: another than Numba's, which has them in its own way."""
        return f"{super().get_filename_base(fullname, abiflags)}.loop"

    def reduce(self, compiled: Any) -> tuple[Any, bytes | None]:
        """What is written: with names in place of bitcode, and that."""
        whole = super().reduce(compiled._replace(type_annotation=""))
        match whole:
            case ((name, "object", (bytes() as code, bytes() as bitcode)), *others) if hasattr(
                compiled.library, "_get_module_for_linking"
            ):
                return ((name, "object", (code, _names_in(bitcode))), *others), bitcode
        return whole, None  # of a Numba that has other ways

    def rebuild(self, target: Any, kept: tuple[Any, bytes | None]) -> Any:
        """Make a loop of what was written."""
        without, bitcode = kept
        out = super().rebuild(target, without)
        if bitcode is not None:
            library = out.library

            def linked() -> Any:
                del library._get_module_for_linking
                library._shared_module = llvm.parse_bitcode(bitcode)
                return library._shared_module

            library._get_module_for_linking = linked
        return out


class LoopCache(FunctionCache):
    """What is kept of one loop, where there is room for it."""

    _impl_class = _MachineCode

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Write it; a full disk is no error."""
        try:
            super().save_overload(signature, compiled)
        except OSError as error:
            _LOG.debug("%s is not kept: %s", self, error)


def _names_in(bitcode: bytes) -> bytes:
    """Bitcode that defines the same names, by which Numba finds machine code, and nothing else."""
    module = llvm.parse_bitcode(bitcode)
    names = [
        f'@"{each.name}" = global i8 0'
        for each in (*module.functions, *module.global_variables)
        if not (each.is_declaration or each.name.startswith(".const"))
    ]
    return bytes(llvm.parse_assembly("\n".join(names)).as_bitcode())
