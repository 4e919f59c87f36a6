"""Compiled loops on disk: what Numba keeps of them, loaded in a third of the time.

A call needs the machine code of a loop alone. Its bitcode, twice as large, is for loops that call
it, and is parsed when one of these is compiled, be it by the process that compiled this one: then
machine code, whose sums may be taken in any order, is the same whichever process compiled what.
What types its variables have, which only `inspect_types` prints, is not kept, nor are environments
of functions it has inside that hold no constants, for which half of Numba would be imported.
What a disk has damaged would end the process: a checksum tells it, at a GB a second. A loop has
inside what it calls of other modules, and their constants: it is compiled again where the source of
any of them is another, be that file as old and as large as the one before. What other
settings make, to check bounds or not to optimise, is kept apart, for it would be slow ever after.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import re
import sys
import zlib
from functools import cache
from pathlib import Path
from typing import Any

from llvmlite import binding as llvm
from numba import config
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.runtime.nrt import rtsys

_LOG = logging.getLogger("planewise")
_SETTINGS = (  # of Numba, by NUMBA_...: they change machine code, and Numba keeps it all alike
    "OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "BOUNDSCHECK", "DEBUGINFO_DEFAULT",
    "LLVM_REFPRUNE_PASS", "LLVM_REFPRUNE_FLAGS",
)  # fmt: skip
_SET = repr([str(getattr(config, name, None)) for name in _SETTINGS]).encode()
ENDING = f"loop2-{zlib.crc32(_SET):08x}"
"""Of names of files: another for each way of writing them, and for other settings."""
_IMPORTS = re.compile(rb"\nfrom (planewise\.[\w.]+) import")


class _MachineCode(CompileResultCacheImpl):
    """How one loop is written and read."""

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        """Name of its files: another than Numba's, which has them in its own way."""
        return f"{super().get_filename_base(fullname, abiflags)}.{ENDING}"

    def reduce(self, compiled: Any) -> tuple[Any, bytes | None, int]:
        """What is written: with names in place of bitcode, that, and the checksum of all three."""
        whole = super().reduce(compiled._replace(type_annotation=""))
        module = getattr(compiled.library, "_get_module_for_linking", None)
        match whole:
            case (
                (name, "object", (bytes() as code, bytes() as bitcode)),
                *others,
                tuple() as environments,
            ) if module:
                names = _names_in(module())
                _link_by(bitcode, compiled.library)
                used = tuple(each for each in environments if each.consts)
                kept = (name, "object", (code, names)), *others, used
                return kept, bitcode, _checksum(code, names, bitcode)
        return whole, None, 0  # of a Numba that has other ways

    def rebuild(self, target: Any, kept: tuple[Any, bytes | None, int]) -> Any:
        """Make a loop of what was written.

        Raises
        ------
        ValueError
            If it is damaged.
        """
        without, bitcode, checksum = kept
        if bitcode is None:
            return super().rebuild(target, without)
        code, names = without[0][2]
        if _checksum(code, names, bitcode) != checksum:
            raise ValueError("it is damaged")
        out = super().rebuild(target, without)
        _link_by(bitcode, out.library)
        return out


class LoopCache(FunctionCache):
    """What is kept of one loop, where there is room for it."""

    _impl_class = _MachineCode

    def __init__(self, loop: Any) -> None:
        super().__init__(loop)
        with contextlib.suppress(OSError):  # a program that was frozen has no sources, but a date
            self._cache_file = IndexDataCacheFile(
                cache_path=self.cache_path,
                filename_base=self._impl.filename_base,
                source_stamp=_digest(loop.__module__),
            )

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Read it; what is damaged is not there, and is compiled again.

        What Numba does first, to look for all functions that it can compile (and for SciPy, to
        import it), takes as long as to load forty loops; it does so before it compiles, too.
        """
        try:
            rtsys.initialize(target)  # counts references
            with self._guard_against_spurious_io_errors():
                return self._load_overload(signature, target)
        except Exception as error:  # as many kinds as there are ways to be damaged
            self._forget(error)
            return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Write it; a full disk is no error."""
        try:
            super().save_overload(signature, compiled)
        except OSError as error:
            self._forget(error)

    def _forget(self, error: Exception) -> None:
        """Remove the index, which may name what is damaged or of an older source."""
        _LOG.debug("%s is not kept: %s", self, error)
        with contextlib.suppress(OSError):
            Path(self._cache_file._index_path).unlink(missing_ok=True)


@cache
def _digest(module: str) -> bytes:
    """Of the source of a module, and of all that it imports from the package."""
    source = Path(str(sys.modules[module].__file__)).read_bytes()
    used = sorted({name.decode() for name in _IMPORTS.findall(source)} & sys.modules.keys())
    parts = [source, *map(_digest, used)]  # what is not loaded stands in a text, and is no import
    return hashlib.blake2b(b"".join(parts), digest_size=16).digest()


def _checksum(code: bytes, names: bytes, bitcode: bytes) -> int:
    return zlib.crc32(bitcode, zlib.crc32(names, zlib.crc32(code)))


def _link_by(bitcode: bytes, library: Any) -> None:
    """Let loops be compiled with this that call those of a library; the first one parses it."""

    def linked() -> Any:
        library._shared_module = llvm.parse_bitcode(bitcode)
        del library._get_module_for_linking  # now it gives that
        return library._shared_module

    library._shared_module = None
    library._get_module_for_linking = linked


def _names_in(module: Any) -> bytes:
    """Bitcode that defines its names, by which Numba finds machine code, and nothing else."""
    names = [
        f'@"{each.name}" = global i8 0'
        for each in (*module.functions, *module.global_variables)
        if not (each.is_declaration or each.name.startswith(".const"))
    ]
    return bytes(llvm.parse_assembly("\n".join(names)).as_bitcode())
