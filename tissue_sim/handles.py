"""Handles: NamedTuples of arrays, and rows of them, that kernels take by reference."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import default_manager, models
from numba.core.extending import infer_getattr, lower_builtin, lower_getattr_generic
from numba.core.imputils import impl_ret_borrowed
from numba.core.pythonapi import _unboxers
from numba.core.runtime.nrtdynmod import _meminfo_struct_type as _MEMORY
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_global, signature
from numba.experimental import structref
from numba.experimental.jitclass.base import imp_dtor
from numba.extending import NativeValue, intrinsic, unbox

from tissue_sim.jit import compiled_once, folder_of

_PAYLOAD = 3  # index of the pointer to the content in Numba's reference-counted memory


def has(values: Any, *path: str) -> bool:
    """Return True when a field of a NamedTuple, of a handle, or of the compiled type of one, isn't None.

    path: names of the fields that lead to it.
    """
    for name in path:
        if isinstance(values, HandleProxy):
            values = numba.typeof(values)
        if isinstance(values, Handle):
            values = values.field_dict[name]
        elif isinstance(values, types.Type):
            values = values[values.fields.index(name)]  # type: ignore[attr-defined, index]
        else:
            values = getattr(values, name)
    if isinstance(values, types.Type):
        return bool(values != types.none)
    return values is not None


class Handle(types.StructRef):  # type: ignore[name-defined]
    """Compiled type of a NamedTuple that is passed by reference; the tuples in it are by reference, too."""


class HandleProxy(structref.StructRefProxy):
    """Handle as Python holds it; only kernels look inside."""

    # Numba drops what its own property raises while it runs: Ctrl-C in that moment would be lost.
    _numba_type_ = structref.StructRefProxy._type


default_manager.register(Handle, models.StructRefModel)
structref.define_boxing(Handle, HandleProxy)
_counted = _unboxers.functions.pop(Handle)


@unbox(Handle)
def _unbox_handle(kind, made, c):  # type: ignore[no-untyped-def]
    """Convert a handle for a kernel, which borrows it.

    Numba takes a reference, and kernels that count give it back when they end. Those that count none would keep it, and
    with it every array of the handle for ever.
    """
    found = _counted(kind, made, c)
    if not c.context.enable_nrt:
        memory = c.pyapi.object_getattr_string(made, "_meminfo")
        for number in (c.pyapi.call_method(memory, "release"), memory):
            c.pyapi.decref(number)
    return found


@infer_getattr
class _Fields(AttributeTemplate):
    """Typing of a handle's fields."""

    key = Handle

    def generic_resolve(self, kind: Any, name: str) -> Any:
        """Return the type of a field, None for an unknown one; for a record the record, not its array."""
        field = kind.field_dict.get(name)
        return field.dtype if _is_record(field) else field


def _is_record(field: Any) -> bool:
    """Return whether a type is an array without dimensions that holds a record, as `handle` passes one."""
    return isinstance(field, types.Array) and field.ndim == 0 and isinstance(field.dtype, types.Record)


@lower_getattr_generic(Handle)
def _field(context, builder, kind, value, name):  # type: ignore[no-untyped-def]
    """Return a field as it lies in the handle, borrowed: kernels hold no references, and count none.

    What a handle holds never changes. The compiler is told so: after every store to an array it would read again where
    all arrays are.
    """
    memory = context.make_helper(builder, kind, value).meminfo
    before = len(builder.block.instructions)
    fields = builder.load(cgutils.gep_inbounds(builder, builder.bitcast(memory, _MEMORY.as_pointer()), 0, _PAYLOAD))
    payload = context.data_model_manager[kind.get_data_type()].get_value_type()
    held = context.make_data_helper(builder, kind.get_data_type(), ref=builder.bitcast(fields, payload.as_pointer()))
    field, stored = kind.field_dict[name], getattr(held, name)
    for one in builder.block.instructions[before:]:
        if isinstance(one, ir.LoadInstr):
            one.set_metadata("invariant.load", builder.module.add_metadata([]))
    if _is_record(field):  # by reference: where the array's memory is
        return context.make_helper(builder, field, stored).data
    return impl_ret_borrowed(context, builder, field, stored)


@intrinsic
def _by_reference(typing_context, values):  # type: ignore[no-untyped-def]
    """Return a new handle with the fields of a named tuple."""
    kind = Handle(tuple(zip(values.fields, values.types, strict=True)))

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        payload = context.data_model_manager[kind.get_data_type()].get_value_type()
        size = context.get_constant(types.uintp, context.get_abi_sizeof(payload))
        memory = context.nrt.meminfo_alloc_dtor(builder, size, imp_dtor(context, builder.module, kind))
        data = builder.bitcast(context.nrt.meminfo_data(builder, memory), payload.as_pointer())
        builder.store(cgutils.get_null_value(payload), data)
        made = context.make_helper(builder, kind)
        made.meminfo = memory
        target = context.make_data_helper(builder, kind.get_data_type(), ref=data)
        for index, (name, field) in enumerate(zip(values.fields, values.types, strict=True)):
            value = builder.extract_value(arguments[0], index)
            context.nrt.incref(builder, field, value)
            setattr(target, name, value)
        return made._getvalue()

    return kind(values), generate


def _refer(values: Any) -> Any:
    return _by_reference(values)


def handle(values: Any) -> Any:
    """Return a NamedTuple of arrays, records, numbers and further such tuples, for kernels to take by reference.

    As plain arguments a hundred arrays are unpacked at every call, and again in every kernel that is compiled:
    microseconds per tick and minutes at the first one. Arrays and records (tissue_sim.model.data.records) are shared,
    numbers copied.

    Parameters
    ----------
    values : Any
        The tuple.

    Returns
    -------
    Any
        The handle; the tuple itself where nothing is compiled.
    """
    if numba.config.DISABLE_JIT:
        return values
    return _refer(type(values)(*map(_held, values)))


def _held(value: Any) -> Any:
    """Return what a handle holds of a value."""
    if isinstance(value, np.record):
        around: Any = value.base  # the array of one record that it lies in
        return around.reshape(())
    return handle(value) if hasattr(value, "_fields") else value


class Row(types.Type):  # type: ignore[name-defined]
    """Compiled type of a HandleRow: that of its handles, independent of their number."""

    def __init__(self, dtype: Handle) -> None:
        self.dtype = dtype
        super().__init__(f"row of {dtype}")


class HandleRow:
    """Handles of one type as Python holds them; only kernels look inside."""

    def __init__(self, handles: Sequence[HandleProxy]) -> None:
        self._handles = tuple(handles)  # kept, as kernels count no references
        self._places = np.array([_place(one) for one in handles], dtype=np.int64)
        self.address, self.count = self._places.ctypes.data, len(handles)
        kinds = {numba.typeof(one) for one in handles}
        if len(kinds) != 1:
            raise ValueError(f"{len(kinds)} types of handles in a row; expected: one")
        self._numba_type_ = Row(kinds.pop())

    @property
    def places(self) -> np.ndarray:
        """Return the addresses of the handles, (k,): code that writes others there must keep their handles."""
        return self._places


def row(handles: Sequence[Any]) -> Any:
    """Return handles of one type, for kernels to take by reference; in a tuple each length would be another type.

    Parameters
    ----------
    handles : Sequence[Any]
        The handles.

    Returns
    -------
    Any
        The row; a tuple where nothing is compiled.

    Raises
    ------
    ValueError
        Where their types differ, or there is none.
    """
    return tuple(handles) if numba.config.DISABLE_JIT else HandleRow(handles)


class _RowModel(models.StructModel):
    """Data model of a row: the addresses of its handles."""

    def __init__(self, manager: Any, kind: Row) -> None:
        super().__init__(manager, kind, [("places", types.CPointer(types.intp)), ("count", types.intp)])  # type: ignore[attr-defined]


default_manager.register(Row, _RowModel)


@unbox(Row)
def _unbox_row(kind, row, c):  # type: ignore[no-untyped-def]
    """Convert a row for kernels."""
    made = c.context.make_helper(c.builder, kind)
    address, count = (c.pyapi.object_getattr_string(row, name) for name in ("address", "count"))
    made.places = c.builder.inttoptr(c.unbox(types.intp, address).value, made.places.type)
    made.count = c.unbox(types.intp, count).value
    for number in (address, count):
        c.pyapi.decref(number)
    return NativeValue(made._getvalue())


@infer_global(operator.getitem)
class _Item(AbstractTemplate):
    """Typing of a row's item."""

    def generic(self, arguments: Any, _: Any) -> Any:
        """Return the signature for numba; None for what isn't a row."""
        if isinstance(arguments[0], Row) and isinstance(arguments[1], types.Integer):
            return signature(arguments[0].dtype, arguments[0], types.intp)
        return None


@lower_builtin(operator.getitem, Row, types.intp)
def _item(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
    """Return a handle, borrowed as fields are."""
    places = context.make_helper(builder, signature.args[0], arguments[0]).places
    made = context.make_helper(builder, signature.return_type)
    made.meminfo = builder.inttoptr(builder.load(builder.gep(places, [arguments[1]])), made.meminfo.type)
    return impl_ret_borrowed(context, builder, signature.return_type, made._getvalue())


@infer_global(len)
class _Length(AbstractTemplate):
    """Typing of a row's length."""

    def generic(self, arguments: Any, _: Any) -> Any:
        """Return the signature for numba; None for what isn't a row."""
        return signature(types.intp, arguments[0]) if isinstance(arguments[0], Row) else None


@lower_builtin(len, Row)
def _length(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
    """Return the number of handles."""
    return context.make_helper(builder, signature.args[0], arguments[0]).count


@intrinsic
def _memory_of(typing_context, made):  # type: ignore[no-untyped-def]
    """Return the address of a handle's memory."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        memory = context.make_helper(builder, signature.args[0], arguments[0]).meminfo
        return builder.ptrtoint(memory, context.get_value_type(types.intp))

    return types.intp(made), generate


def _place(made: Any) -> Any:
    return _memory_of(made)


def place_of(made: Any) -> int:
    """Return the address of a handle, for `HandleRow.places`.

    Parameters
    ----------
    made : Any
        The handle.
    """
    return int(_place(made))


numba.config.CACHE_DIR = folder_of("model")
_refer, _place = compiled_once(numba.njit(_refer)), compiled_once(numba.njit(_place))
