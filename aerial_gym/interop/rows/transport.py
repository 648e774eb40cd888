"""Coalesced reads and writes of neighbouring rows by the 32 threads of a warp.

A thread that writes a row of 13 numbers alone fills a few bytes of a 32-byte sector at a time, and each partial write costs a
whole sector. Here the rows of a warp are staged in shared memory, and its threads write them in the order of addresses. Rows
of four aligned numbers need one access of 16 bytes only. The path of a row never changes its numbers. On a CPU rows are read
and written directly.

All rows of a launch must be stored, one thread each, in a launch of one dimension.
"""

from typing import Any

import warp as wp

LARGEST = 128  # Largest width of a staged row: with the 64 threads of a block it fills 33 KB of shared memory
MOST_STAGED = 180  # Widest staged rows of a kernel: 46 KB of a block's 48 KB; further rows are written directly
FEW = 8192  # Rows below which every thread writes its own: they do not fill an H200, staging only delays them

_STORE = """
    constexpr int count = sizeof(value) / 4, pitch = count | 1;  // odd: neighbouring rows begin in different banks
#if defined(__CUDA_ARCH__)
    char* data = reinterpret_cast<char*>(out.data);
    const size_t gap = out.strides[0];
    if constexpr (count == 4) {  // all rows or none: those that leave here would be missed by the other threads of their warp
        if (INNER == 4 && ((reinterpret_cast<size_t>(data) | gap) & 15) == 0) {
            *reinterpret_cast<float4*>(data + row * gap) = make_float4(value[0], value[1], value[2], value[3]);
            return;
        }
    }
    if (out.shape[0] >= FEW) {
        __shared__ float staged[WP_TILE_BLOCK_DIM * pitch];
        const int lane = threadIdx.x & 31, first = row - lane;
        const int rows = min(32, (int)out.shape[0] - first);  // fewer in the last warp
        const unsigned all = 0xffffffffu >> (32 - rows);
        float* mine = staged + (threadIdx.x - lane) * pitch;
        #pragma unroll
        for (int i = 0; i < count; ++i)
            mine[lane * pitch + i] = value[i];
        __syncwarp(all);
        #pragma unroll 16
        for (int k = 0; k < count; ++k) {
            const int i = lane + k * rows, r = i / count, c = i - r * count;
            *reinterpret_cast<float*>(data + (first + r) * gap + c * INNER) = mine[r * pitch + c];
        }
        __syncwarp(all);
        return;
    }
#endif
    PLAIN
""".replace("FEW", str(FEW))

_LOAD_4 = """
#if defined(__CUDA_ARCH__)
    const char* from = reinterpret_cast<const char*>(source.data) + (size_t)row * source.strides[0];
    if (INNER == 4 && (reinterpret_cast<size_t>(from) & 15) == 0) {
        const float4 v = *reinterpret_cast<const float4*>(from);
        return {KIND}(v.x, v.y, v.z, v.w);
    }
#endif
    PLAIN
"""


def _fill_template(snippet: str, *, inner: str, plain: str, kind: str = "") -> str:
    """Fill in a snippet: ``inner`` is the stride within a row [bytes], ``plain`` the portable code."""
    return snippet.replace("INNER", inner).replace("PLAIN", plain).replace("{KIND}", kind)


_EACH = "for (int i = 0; i < {}; ++i) "


@wp.func_native(
    _fill_template(
        _STORE, inner="out.strides[1]", plain=_EACH.format("count") + "*wp::address(out, row, i) = value[i];"
    )
)
def store_row(out: wp.array2d[wp.float32], row: int, value: Any):
    """Write a row; the vector has the width of a row."""


@wp.func_native(_fill_template(_STORE, inner="4", plain="*wp::address(out, row) = value;"))
def store_vector(out: wp.array[Any], row: int, value: Any):
    """Write a vector or quaternion."""


@wp.func_native(
    _fill_template(
        _LOAD_4,
        inner="source.strides[1]",
        kind="wp::vec_t<4, float>",
        plain=f"wp::vec_t<4, float> found; {_EACH.format(4)}found[i] = *wp::address(source, row, i); return found;",
    )
)
def load_row_4(source: wp.array2d[wp.float32], row: int) -> wp.vec4:  # pyright: ignore[reportReturnType]
    """Return a row of four numbers."""


@wp.func_native(_fill_template(_LOAD_4, inner="4", kind="wp::quat_t<float>", plain="return *wp::address(source, row);"))
def load_quat(source: wp.array[wp.quat], row: int) -> wp.quat:  # pyright: ignore[reportReturnType]
    """Return a quaternion."""
