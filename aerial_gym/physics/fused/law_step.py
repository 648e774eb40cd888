"""One physics step of a control law with memory: timing, delays and memory around its two traced functions.

The memory is in device memory; a level that is not due costs one comparison. ``control.stateful`` is the same in torch.
Letters: E environments, R rotors, U entries of an action, M numbers of memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import warp as wp

from aerial_gym.math.warp_functions import vector_type
from aerial_gym.physics.fused.types import LawArrays, compile_source
from aerial_gym.physics.law_memory import LawNeeds


@dataclass(frozen=True)
class MemoryAccess:
    """Access to the memory of one level."""

    load: wp.Function  # ``wp.func`` (numbers (M, E), environment) -> vector
    store: wp.Function  # ``wp.func`` (numbers (M, E), environment, vector); writes the changed entries
    width: int  # Number of entries; 0 without memory


def make_memory_access(kind: Any, width: int, first: int, changed: Sequence[int]) -> MemoryAccess:
    """Return the access to ``width`` numbers from the number ``first`` on; ``changed`` entries are stored."""
    numbers = ", ".join(f"source[{first + i}, env]" for i in range(width)) or "0.0"
    load = f"def load(source: wp.array2d[float], env: int) -> kind:\n    return kind({numbers})\n"
    lines = [f"    out[{first + i}, env] = value[{i}]" for i in changed] or ["    pass"]
    store = "\n".join(["def store(out: wp.array2d[float], env: int, value: kind):", *lines])
    return MemoryAccess(
        compile_source("load", load, {"kind": kind}), compile_source("store", store + "\n", {"kind": kind}), width
    )


def make_memory_step(
    needs: LawNeeds, vector: Any, struct: Any, outer_level: tuple[wp.Function, MemoryAccess],
    inner_level: tuple[wp.Function, MemoryAccess],
) -> wp.Function:  # fmt: skip
    """Return ``FusedLaw.command`` of a law with memory, which updates the memory.

    Args:
        vector: Type of one number per rotor.
        struct: Type of the law's numbers.
        outer_level: Function (motion, action, memory, begins, numbers) -> setpoint, memory; and access to its memory.
        inner_level: Function (motion, setpoint, memory, begins, numbers) -> rotor command, memory; and access to its memory.
    """
    action_type, setpoint_type = vector_type(needs.num_actions), vector_type(needs.num_setpoint)
    (outer, outer_memory), (inner, inner_memory) = outer_level, inner_level
    load_outer, store_outer, outer_width = outer_memory.load, outer_memory.store, outer_memory.width
    load_inner, store_inner, inner_width = inner_memory.load, inner_memory.store, inner_memory.width
    period, loop, delay, slots = needs.timing.law, needs.timing.loop, needs.timing.delay, needs.timing.setpoint_slots
    num_setpoint, num_rotors, held = needs.num_setpoint, needs.num_rotors, needs.command_offset
    arrived_action = make_action_delay(needs)

    @wp.func
    def command_step(
        position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3, rotor_speed: vector, law: struct,
        action: action_type, arrays: LawArrays, env: int,
    ) -> vector:  # fmt: skip
        since = arrays.since[env]
        arrays.since[env] = since + 1
        arrived = arrived_action(arrays, env, since, action)
        command = vector()
        if since % wp.static(loop) == 0:
            begins = since == 0
            setpoint = setpoint_type()
            if since % wp.static(period) == 0:
                known = load_outer(arrays.numbers, env)
                if wp.static(outer_width > 0):
                    setpoint, changed = outer(
                        position, attitude, lin_vel, ang_vel, rotor_speed, arrived, known, begins, law
                    )
                    store_outer(arrays.numbers, env, changed)
                else:
                    setpoint = outer(position, attitude, lin_vel, ang_vel, rotor_speed, arrived, known, begins, law)
                if wp.static(slots > 0):
                    first = wp.static(num_setpoint) * ((since / wp.static(period)) % wp.static(slots))
                    for i in range(wp.static(num_setpoint)):
                        arrays.past[first + i, env] = setpoint[i]
            if wp.static(slots > 0):
                age = wp.max(since - wp.static(delay), 0) / wp.static(period)
                for i in range(wp.static(num_setpoint)):
                    setpoint[i] = arrays.past[wp.static(num_setpoint) * (age % wp.static(slots)) + i, env]
            kept = load_inner(arrays.numbers, env)
            if wp.static(inner_width > 0):
                command, after = inner(position, attitude, lin_vel, ang_vel, rotor_speed, setpoint, kept, begins, law)
                store_inner(arrays.numbers, env, after)
            else:
                command = inner(position, attitude, lin_vel, ang_vel, rotor_speed, setpoint, kept, begins, law)
            if wp.static(loop > 1):
                for i in range(wp.static(num_rotors)):
                    arrays.numbers[wp.static(held) + i, env] = command[i]
        else:
            for i in range(wp.static(num_rotors)):
                command[i] = arrays.numbers[wp.static(held) + i, env]
        return command

    return command_step


def make_action_delay(needs: LawNeeds) -> wp.Function:
    """Return the delay of actions: a function that stores the new action and returns the delayed one."""
    action_type, first, num_actions = vector_type(needs.num_actions), needs.action_offset, needs.num_actions
    slots, delay = needs.timing.action_slots, needs.timing.action_delay

    @wp.func
    def at_once(arrays: LawArrays, env: int, since: int, action: action_type) -> action_type:
        return action

    @wp.func
    def delay_action(arrays: LawArrays, env: int, since: int, action: action_type) -> action_type:
        arrived = action_type()
        for i in range(wp.static(num_actions)):
            arrays.past[wp.static(first) + (since % wp.static(slots)) * wp.static(num_actions) + i, env] = action[i]
        now = wp.max(since - wp.static(delay), 0) % wp.static(slots)
        for i in range(wp.static(num_actions)):
            arrived[i] = arrays.past[wp.static(first) + now * wp.static(num_actions) + i, env]
        return arrived

    return delay_action if slots else at_once
