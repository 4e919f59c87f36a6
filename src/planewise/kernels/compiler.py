"""What lets Numba compile a loop of this package in two thirds of the time."""

from __future__ import annotations

import gc
from collections.abc import Callable
from functools import cache
from typing import Any

from numba.core import event, ir, transforms, types
from numba.core.bytecode import FunctionIdentity
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import AnalysisPass, PassManager, register_pass
from numba.core.postproc import PostProcessor, VariableLifetime
from numba.core.typed_passes import NativeLowering, NopythonRewrites
from numba.core.types.functions import BaseFunction
from numba.core.untyped_passes import InlineClosureLikes

_function: Any = BaseFunction
_types: Any = types
_resolve = _function.get_call_type
_analyse: Any = PostProcessor.run
_known: dict[tuple[Any, ...], Any] = {}  # signatures by function and types of its arguments
_parsed: dict[Callable[..., Any], Any] = {}  # functions that are part of their callers


@register_pass(mutates_CFG=False, analysis_only=True)
class _BorrowsArrays(AnalysisPass):
    """Has no references counted by a loop that makes no arrays and returns none.

    Those that it is given are kept by who calls it. Numba counts them all the same, at every row
    that a loop looks at, and each takes as long as twenty operations.
    """

    _name = "planewise_borrows_arrays"

    def __init__(self) -> None:
        AnalysisPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        """Tell the steps behind; the loop itself is not changed."""
        blocks, kinds = state.func_ir.blocks.values(), state.typemap
        if not any(_may_make_arrays(each, kinds) for block in blocks for each in block.body):
            state.targetctx = state.targetctx.subtarget(enable_nrt=False)
        return False


def _may_make_arrays(statement: Any, kinds: Any) -> bool:
    """Whether a statement makes or returns an array, or may for all that is known of it here."""

    def is_array(name: Any) -> bool:
        kind = kinds[name.name]
        every = kind if isinstance(kind, _types.BaseTuple) else (kind,)
        return any(isinstance(each, _types.Buffer) for each in every)

    if isinstance(statement, ir.SetItem | ir.StaticSetItem):
        index = statement.index if isinstance(statement, ir.SetItem) else statement.value
        return is_array(statement.value) or is_array(index)
    if isinstance(statement, ir.Return):
        return is_array(statement.value)
    if not isinstance(statement, ir.Assign):
        return not isinstance(statement, ir.Del | ir.Jump | ir.Branch)
    done = statement.value
    if not isinstance(done, ir.Expr) or done.op in (
        "static_getitem",
        "getattr",
        "build_tuple",
        "cast",
    ):
        return False
    if done.op == "getitem":
        return is_array(done.index)
    if done.op == "exhaust_iter":  # of a tuple, as a rule
        return isinstance(kinds[done.value.name], _types.Buffer)
    if done.op == "call":
        called = kinds[done.func.name]
        if isinstance(called, _types.Dispatcher):
            return is_array(statement.target)
        if isinstance(called, _types.BoundFunction) and isinstance(called.this, _types.Buffer):
            return called.typing_key not in ("array.view", "array.reshape")
    return is_array(statement.target) or any(is_array(each) for each in done.list_vars())


class LoopCompiler(CompilerBase):
    """Numba's own without the steps for what no loop of ours has.

    That is functions and comprehensions within a loop, and expressions of whole arrays, which would
    not be fused into one.
    """

    def define_pipelines(self) -> list[Any]:
        """Steps from byte code to machine code."""
        steps = PassManager("planewise")
        for step, what in DefaultPassBuilder.define_nopython_pipeline(self.state).passes:
            if step not in (InlineClosureLikes, NopythonRewrites):
                if step is NativeLowering:
                    steps.add_pass(_BorrowsArrays, "count references where arrays are made")
                steps.add_pass(step, what)
        steps.finalize()
        return [steps]


def _look_up(function: Any, context: Any, args: Any, kws: Any) -> Any:
    """Signature of a function or an operator for arguments of these types.

    Numba tries all that it has registered for an operator, some fifty functions, at every place
    where it is used. What comes of it is the same again, but for functions that are compiled
    themselves, with the options of who calls them.
    """
    key = function, context, tuple(args)
    if not kws and key in _known:
        return _known[key]
    signature = _resolve(function, context, args, kws)
    if not kws and function.get_impl_key(signature) is function.typing_key:  # else it is compiled
        _known[key] = signature
    return signature


def _parse_once(parse: Callable[..., Any]) -> Callable[..., Any]:
    """Parse what is part of its callers once, and not for each of them; they copy it.

    Under another name each time, by which Numba tells its variables apart.
    """

    def look_up(inliner: Any, function: Callable[..., Any], enable_ssa: bool = False) -> Any:
        if enable_ssa:
            return parse(inliner, function, enable_ssa)
        inliner.flags.enable_ssa = False  # as parsing leaves it
        if function not in _parsed:
            _parsed[function] = parse(inliner, function)
        parsed = _parsed[function].copy()
        parsed.func_id = FunctionIdentity.from_function(function)
        return parsed

    return look_up


def _without_liveness(processor: Any, emit_dels: bool = False, *args: Any, **kws: Any) -> None:
    """Leave out where variables live, after each of a dozen steps, until a step asks for it."""
    parsed = processor.func_ir
    if emit_dels or args or kws or parsed.is_generator:
        _analyse(processor, emit_dels, *args, **kws)
        return
    parsed.blocks = transforms.canonicalize_cfg(parsed.blocks)
    parsed.variable_lifetime = VariableLifetime(parsed.blocks)
    parsed.generator_info = None


@cache
def _methods() -> tuple[tuple[Any, str, Any, Any], ...]:
    """What is replaced: owner, name, Numba's own and ours."""
    from numba.core.inline_closurecall import InlineWorker  # takes long, and only compilers need it

    inliner: Any = InlineWorker
    parse = inliner.run_untyped_passes
    return (
        (_function, "get_call_type", _resolve, _look_up),
        (PostProcessor, "run", _analyse, _without_liveness),
        (inliner, "run_untyped_passes", parse, _parse_once(parse)),
    )


class QuickCompiler(event.Listener):
    """Puts these in Numba's place, and keeps the garbage collector still, while a loop compiles.

    One of ours: others compile as ever. The collector would look through all of the compiler's
    objects again and again, a fifth of the time. Numba compiles one loop at a time, and tells when.
    """

    def __init__(self) -> None:
        self._depth, self._ours, self._collects = 0, False, False

    def on_start(self, event: Any) -> None:
        """Begin with the first loop of ours; it may have others compiled."""
        dispatcher = event.data["dispatcher"]
        function, module = dispatcher.py_func, str(dispatcher.py_func.__module__)
        # What Numba makes for these types is called by what it compiles alone.
        if self._ours and module.startswith("numba.") and "<locals>" in function.__qualname__:
            dispatcher.targetoptions.update(no_cpython_wrapper=True, no_cfunc_wrapper=True)
        if not self._depth:
            self._ours = module.startswith(f"{__package__}.")
            if self._ours:
                self._collects = gc.isenabled()
                gc.disable()
                for owner, name, _, quick in _methods():
                    setattr(owner, name, quick)
        self._depth += 1

    def on_end(self, event: Any) -> None:
        """Leave all as it was."""
        self._depth -= 1
        if not self._depth and self._ours:
            self._ours = False
            for owner, name, slow, _ in _methods():
                setattr(owner, name, slow)
            if self._collects:
                gc.enable()
