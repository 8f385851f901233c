"""A hint of compiled code to the processor: the part of an array that will soon be read."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import config, types
from numba.extending import intrinsic

_READ, _KEEP, _DATA = 0, 3, 1
"""Arguments of `llvm.prefetch`: for reading, in all caches, data and not instructions."""


def _prefetch(context, array, index):
    """The type and the code of the hint, see `prefetch`."""

    def _code(target, builder, signature, arguments):
        data = target.make_array(signature.args[0])(target, builder, arguments[0]).data
        byte, whole = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, whole, whole, whole])
        hint = builder.module.declare_intrinsic("llvm.prefetch", [byte], kind)
        place = builder.bitcast(builder.gep(data, [arguments[1]]), byte)
        builder.call(hint, [place, whole(_READ), whole(_KEEP), whole(_DATA)])
        return target.get_dummy_value()

    return types.void(array, index), _code


prefetch: Any = (lambda array, index: None) if config.DISABLE_JIT else intrinsic(_prefetch)  # type: ignore[attr-defined]
"""Called by compiled code with an array (n,) and an index in it: asks for that entry, and for what lies beside it in
memory, and changes nothing. Where NUMBA_DISABLE_JIT is set nothing is compiled, and it does nothing."""
