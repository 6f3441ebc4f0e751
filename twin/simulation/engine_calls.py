"""Calls of C functions by address from compiled code: the loop calls the engine and the effect terms without Python.

An address is plain data, so the compiled loop can be cached on disk and serves all combinations of terms.
"""

import ctypes
import ctypes.util
import functools
from pathlib import Path
import typing

from llvmlite import ir
from numba import types
from numba.extending import intrinsic as _intrinsic

intrinsic: typing.Any = _intrinsic  # untyped: the type of `intrinsic` hides the signatures of its functions


@intrinsic
def call_address_2(typing_context, address, a, b):  # type: ignore[no-untyped-def]
    """Call `void f(void*, void*)` at `address` with two addresses."""
    return _call(2)


@intrinsic
def call_address_3(typing_context, address, a, b, c):  # type: ignore[no-untyped-def]
    """Call `void f(void*, void*, void*)` at `address`."""
    return _call(3)


@intrinsic
def call_address_4(typing_context, address, a, b, c, d):  # type: ignore[no-untyped-def]
    """Call `void f(void*, void*, void*, int64)` at `address`."""
    return _call(4)


def _call(count: int) -> tuple[typing.Any, typing.Any]:
    signature = types.void(*[types.int64] * (count + 1))

    def generate(context: typing.Any, builder: typing.Any, _signature: typing.Any, arguments: typing.Any) -> typing.Any:
        word = ir.IntType(64)
        function_type = ir.FunctionType(ir.VoidType(), [word] * count)
        function = builder.inttoptr(arguments[0], function_type.as_pointer())
        builder.call(function, list(arguments[1:]))
        return context.get_dummy_value()

    return signature, generate


@functools.cache
def engine_function_address(name: str) -> int:
    """Address of a function of the MuJoCo library, e.g. 'mj_step'."""
    return int(ctypes.cast(getattr(_library(), name), ctypes.c_void_p).value or 0)


@functools.cache
def _library() -> ctypes.CDLL:
    """The MuJoCo library without its clock, which its timers would read about twenty times in each step, a quarter of the time of a step."""
    import mujoco

    folder = Path(mujoco.__file__).parent
    names = sorted([*folder.glob("libmujoco*.so*"), *folder.glob("libmujoco*.dylib"), *folder.glob("mujoco.dll")])
    library = ctypes.CDLL(str(names[0]))
    ctypes.c_void_p.in_dll(library, "mjcb_time").value = None
    return library
