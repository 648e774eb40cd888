"""Filters of second order in the fused kernel: the Warp version of ``control.filters.biquad``."""

import warp as wp

from aerial_gym.control.filters.biquad import Biquad
from aerial_gym.control.lee_fused import read_vec3, write_vec3
from aerial_gym.physics.fused.memory import LawArrays


def make_filter(filter: Biquad | None, first: int) -> wp.Function:
    """Return the Warp version of ``biquad.filtered``, the identity for None; its memory starts at number ``first``."""

    @wp.func
    def identity(sample: wp.vec3, arrays: LawArrays, env: int, since: int) -> wp.vec3:
        return sample

    if filter is None:
        return identity
    a1, a2, b0, b1, b2 = filter.a1, filter.a2, filter.b0, filter.b1, filter.b2

    @wp.func
    def apply_filter(sample: wp.vec3, arrays: LawArrays, env: int, since: int) -> wp.vec3:
        newer = read_vec3(arrays.numbers, wp.static(first), env)
        older = read_vec3(arrays.numbers, wp.static(first + 3), env)
        if since == 0:
            newer = sample / wp.static(1.0 + a1 + a2)
            older = newer
        inner = sample - wp.static(a1) * newer - wp.static(a2) * older
        write_vec3(arrays.numbers, wp.static(first), env, inner)
        write_vec3(arrays.numbers, wp.static(first + 3), env, newer)
        return wp.static(b0) * inner + wp.static(b1) * newer + wp.static(b2) * older

    return apply_filter
