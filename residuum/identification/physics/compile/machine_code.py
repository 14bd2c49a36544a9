"""Assembly → machine code of this processor, and machine code → functions that compiled code calls
by address.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import count
from types import MappingProxyType
from typing import Any

import llvmlite.binding as llvm

# Teaches Numba the protocol that Function follows.
import numba.experimental.function_type  # noqa: F401
from numba import types

_DOUBLES = types.CPointer(types.float64)  # type: ignore[no-untyped-call]
_INTEGERS = types.CPointer(types.int64)  # type: ignore[no-untyped-call]
_PLAIN: Any = types.void(*[_DOUBLES] * 9)
FUNCTIONS = ("rates", "slopes", "initial", "outputs", "output_slopes", "signals")
STEPPING = ("advance", "advance_slopes", "observe")
"""What a kernel consists of."""
SIGNATURES: Mapping[str, Any] = {
    "advance_slopes": types.void(*[_DOUBLES] * 10, _INTEGERS, types.int64),
    "observe": types.void(*[_DOUBLES] * 10, _INTEGERS, types.int64),
}
"""Of the functions that take more than nine pointers to doubles."""

LIBRARIES: dict[str, Mapping[str, int]] = {}
"""Libraries that this process has loaded, by what names each (`library_name`): the functions that
code may call, by their symbols.
"""
_COUNT = count()
"""Numbers the libraries."""
_PLACED = 1000
"""Libraries that one linker places: it keeps 10 kB of each that was released."""


class Function(types.WrapperAddressProtocol):
    """A function of a loaded library; it keeps the library, and what placed it, in memory as long
    as it lives.
    """

    def __init__(self, library: Any, name: str, linker: Any) -> None:
        self._kept = library, linker
        self._address = int(library[name])
        self._signature = SIGNATURES.get(name, _PLAIN)

    def __wrapper_address__(self) -> int:
        """Where the function begins."""
        return self._address

    def signature(self) -> Any:
        """Of the compiled function."""
        return self._signature


@lru_cache(maxsize=1)
def target() -> str:
    """The processor that code is made for; code made for another must not be loaded."""
    features = llvm.get_host_cpu_features().flatten()
    return (
        f"{llvm.get_process_triple()} {llvm.get_host_cpu_name()} {features}"
        f" {llvm.llvm_version_info}"
    )


def compiled(assembly: str) -> bytes:
    """Object code of a module given as text, optimised for this processor."""
    machine = _machine()
    module = llvm.parse_assembly(assembly)
    # The text names no processor.
    module.triple = llvm.get_process_triple()
    module.data_layout = str(machine.target_data)
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
    builder.getModulePassManager().run(module, builder)
    return bytes(machine.emit_object(module))


def loaded(
    parts: Iterable[bytes], names: Sequence[str], imported: Mapping[str, int] = MappingProxyType({})
) -> tuple[Function, ...]:
    """The functions `names` of object code in parts that call one another by name, and functions at
    the addresses `imported`.
    """
    number = next(_COUNT)
    # exp, sin, atan2 … are those of the C library that this process has loaded.
    builder = llvm.JITLibraryBuilder().add_current_process()
    for code in parts:
        builder.add_object_img(code)
    for name, address in imported.items():
        builder.import_symbol(name, address)
    for name in names:
        builder.export_symbol(name)
    linker = _linker(number // _PLACED)
    library = builder.link(linker, f"kernel_{number}")
    return tuple(Function(library, name, linker) for name in names)


@lru_cache(maxsize=1)
def _linker(_which: int) -> Any:
    """What places object code in memory: one for many, since to set one up takes five times as long
    as to place a kernel.
    """
    return llvm.create_lljit_compiler(_machine())


def _machine() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=2,
        # Kept on disk and loaded anywhere in memory.
        reloc="pic",
        jit=True,
    )
