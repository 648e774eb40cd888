"""The mass matrix of a tree row by row, and its factor, unrolled for the topology.

A row is stored by depth: above joint k there is one joint at each depth, so that entries of one column lie one below another.
Letters: D joints.

Source: Featherstone (2008), Rigid Body Dynamics Algorithms, sections 6.2 (composite rigid bodies) and 6.5 (L^T D L).
"""

from typing import Any

import warp as wp

from aerial_gym.physics.articulated.articulation import Articulation
from aerial_gym.physics.articulated.fused.inertia import Inertia
from aerial_gym.physics.fused.types import vector_of


def factor_types(articulation: Articulation) -> Any:
    """Return the ``wp.struct`` of what is kept of the factor for the way back."""
    depths = depths_of(articulation)
    num_joints, height = articulation.num_joints, max(depths) + 1
    rows = wp.types.matrix(shape=(num_joints, 3), dtype=wp.float32)
    fields = {
        "mass": wp.types.matrix(shape=(num_joints, height), dtype=wp.float32),  # joint and depth of the one above it
        "by_turn": rows,  # with the base: effort per angular acceleration
        "by_push": rows,  # per acceleration
        "inverse": vector_of(num_joints),  # 1 / D
        "left": vector_of(num_joints),  # right-hand side
    }
    return wp.struct(type("Factor", (), {"__annotations__": fields, "__module__": __name__}))


def depths_of(articulation: Articulation) -> list[int]:
    """Return how many joints are between each joint and the base."""
    return [len(above(articulation, k)) for k in range(articulation.num_joints)]


def above(articulation: Articulation, k: int) -> list[int]:
    """Return the joints between a joint and the base."""
    moves = articulation.tree.moves[k + 1]
    return [i for i in range(k) if moves[i]]


def make_columns(articulation: Articulation, j: int, factor: Any) -> wp.Function:
    """Return what takes the columns of all joints beyond joint j past it: (factor, axis, lever) -> factor."""
    revolute, depth = articulation.tree.joints[j].kind == "revolute", len(above(articulation, j))
    beyond = [k for k in range(articulation.num_joints) if j in above(articulation, k)]
    count, joints = len(beyond), _numbers(beyond)

    @wp.func
    def columns(kept: factor, axis: wp.vec3, lever: wp.vec3) -> factor:
        after = kept
        for n in range(wp.static(count)):
            k = joints[n]
            by_turn = wp.vec3(kept.by_turn[k, 0], kept.by_turn[k, 1], kept.by_turn[k, 2])
            by_push = wp.vec3(kept.by_push[k, 0], kept.by_push[k, 1], kept.by_push[k, 2])
            if wp.static(revolute):
                after.mass[k, depth] = wp.dot(axis, by_turn)
            else:
                after.mass[k, depth] = wp.dot(axis, by_push)
            moved = by_turn + wp.cross(lever, by_push)
            for i in range(3):
                after.by_turn[k, i] = moved[i]
        return after

    return columns


def _numbers(values: list[int]) -> Any:
    """Return a constant vector of numbers; of one zero for none, as Warp has no vector of none."""
    return wp.types.vector(length=max(len(values), 1), dtype=wp.int32)(*(values or [0]))


def make_elimination(articulation: Articulation, factor: Any) -> wp.Function:
    """Return what eliminates all joints: (inertia of the base, its matrix) -> what is left of the base, factor."""

    @wp.func
    def none(base: Inertia, kept: factor):
        return base, kept

    def with_joint(rest: wp.Function, subtract: wp.Function, k: int, depth: int) -> wp.Function:
        @wp.func
        def joint(base: Inertia, kept: factor):
            before, after = rest(base, kept)
            inverse = 1.0 / after.mass[k, depth]
            after.inverse[k] = inverse
            by_turn = wp.vec3(after.by_turn[k, 0], after.by_turn[k, 1], after.by_turn[k, 2])
            by_push = wp.vec3(after.by_push[k, 0], after.by_push[k, 1], after.by_push[k, 2])
            free = inverse * after.left[k]
            left = Inertia()
            left.turn = before.turn - inverse * wp.outer(by_turn, by_turn)
            left.mixed = before.mixed - inverse * wp.outer(by_turn, by_push)
            left.push = before.push - inverse * wp.outer(by_push, by_push)
            left.torque = before.torque + free * by_turn
            left.force = before.force + free * by_push
            return left, subtract(after)

        return joint

    total = none
    for k in reversed(range(articulation.num_joints)):
        subtract = _make_subtraction(articulation, k, factor)
        total = with_joint(total, subtract, k, len(above(articulation, k)))
    return total


def _make_subtraction(articulation: Articulation, k: int, factor: Any) -> wp.Function:
    """Return what takes the row of joint k off those of the joints above it, as much as eliminates it."""
    depth, joints = len(above(articulation, k)), _numbers(above(articulation, k))

    @wp.func
    def subtract(kept: factor) -> factor:
        after = kept
        for d in range(wp.static(depth)):
            i = joints[d]
            part = kept.mass[k, d] * kept.inverse[k]
            for n in range(wp.static(depth)):
                if n <= d:
                    after.mass[i, n] -= part * kept.mass[k, n]
            for n in range(3):
                after.by_turn[i, n] -= part * kept.by_turn[k, n]
                after.by_push[i, n] -= part * kept.by_push[k, n]
            after.left[i] -= part * kept.left[k]
        return after

    return subtract
