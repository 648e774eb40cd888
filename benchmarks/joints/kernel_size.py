"""What a kernel takes of each thread of a GPU: registers, local memory and instructions.

On a GPU the driver says it of the kernel that is loaded. Elsewhere Warp compiles the kernel for an architecture, and the object
file says it, so that no GPU is needed. Local memory is where what does not fit into registers goes.
"""

import ctypes
import re
import struct
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import warp as wp

REGISTERS, FRAME = 0x2F, 0x11
"""Attributes of ``.nv.info``: registers of a thread and its local memory (``EIATTR_REGCOUNT``, ``EIATTR_FRAME_SIZE``)."""

NUM_REGISTERS, LOCAL_BYTES = 4, 3
"""Of ``cuFuncGetAttribute`` (``CU_FUNC_ATTRIBUTE_NUM_REGS``, ``CU_FUNC_ATTRIBUTE_LOCAL_SIZE_BYTES``)."""

INSTRUCTION = 16
"""Of a GPU since compute capability 7.0 [B]."""


@dataclass(frozen=True, kw_only=True)
class KernelSize:
    """What a kernel takes."""

    registers: int
    """Of a thread, at most 255."""

    local_bytes: int
    """Of a thread; 32 where sines are taken, for large angles."""

    instructions: int | None = None
    """Of the machine, all of the kernel; None where the driver was asked."""

    operations: int | None = None
    """On float32 numbers as they stand in the code, likewise: a product with a sum is two, a division or root one."""


def loaded_size(kernel: wp.Kernel, device: wp.Device, *, block_dim: int) -> KernelSize:
    """Return the size of a kernel that is loaded on a GPU, as the driver tells it."""
    execution = kernel.module.load(device, block_dim=block_dim)
    assert execution is not None
    function = ctypes.c_void_p(execution.get_kernel_hooks(kernel).forward)
    driver = ctypes.CDLL("libcuda.so.1")

    def attribute(which: int) -> int:
        value = ctypes.c_int()
        error = driver.cuFuncGetAttribute(ctypes.byref(value), which, function)
        if error:
            raise RuntimeError(f"cuFuncGetAttribute({which}) of {kernel.key}: error {error} of the CUDA driver")
        return value.value

    return KernelSize(registers=attribute(NUM_REGISTERS), local_bytes=attribute(LOCAL_BYTES))


def compiled_size(kernel: wp.Kernel, *, arch: int) -> KernelSize:
    """Return the size of a kernel that is compiled for an architecture, 90 for one of compute capability 9.0."""
    with TemporaryDirectory() as folder:
        (binary,) = wp.compile_aot_module(kernel.module, arch=arch, module_dir=folder, use_ptx=False)
        (ptx,) = wp.compile_aot_module(kernel.module, arch=arch, module_dir=folder, use_ptx=True)
        found = object_size(Path(binary).read_bytes())
        return KernelSize(**found, operations=count_operations(Path(ptx).read_text(encoding="utf-8")))


def object_size(binary: bytes) -> dict[str, int]:
    """Return registers, local memory and instructions of the kernel of an object file, and of what it calls (ELF, 64 bit)."""
    (start,) = struct.unpack_from("<Q", binary, 0x28)
    size, count, names_at = struct.unpack_from("<HHH", binary, 0x3A)
    sections = [struct.unpack_from("<IIQQQQIIQQ", binary, start + i * size) for i in range(count)]
    names = sections[names_at][4]
    found = {"registers": 0, "local_bytes": 0, "instructions": 0}
    for name_at, _, _, _, offset, length, *_ in sections:
        name = binary[names + name_at : binary.index(b"\0", names + name_at)].decode()
        if name.startswith(".text."):
            found["instructions"] += length // INSTRUCTION
        elif name == ".nv.info":
            attributes = _attributes(binary[offset : offset + length])
            found["registers"] = max(attributes[REGISTERS])
            found["local_bytes"] = max(attributes[FRAME])
    return found


def _attributes(info: bytes) -> dict[int, list[int]]:
    """Return the values of each attribute of ``.nv.info`` that is of a symbol."""
    found: dict[int, list[int]] = {}
    at = 0
    while at < len(info):
        form, attribute, length = struct.unpack_from("<BBH", info, at)
        at += 4
        if form == 4:  # the length is that of what follows: a symbol and a value
            if length == 8:
                found.setdefault(attribute, []).append(struct.unpack_from("<II", info, at)[1])
            at += length
    return found


def count_operations(ptx: str) -> int:
    """Return the operations on float32 numbers in a program, a product with a sum as two; comparisons and signs are none."""
    once = len(re.findall(r"^\s*(?:add|sub|mul|div|rcp|sqrt)\.(?:\w+\.)*f32\s", ptx, re.MULTILINE))
    return once + 2 * len(re.findall(r"^\s*fma\.(?:\w+\.)*f32\s", ptx, re.MULTILINE))
