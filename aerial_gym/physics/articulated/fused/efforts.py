"""Effort of one joint at the end of a step: the Warp version of ``joint_laws``; absent laws cost nothing."""

from functools import cache
from typing import Any

import warp as wp

from aerial_gym.math.warp_functions import vector_type
from aerial_gym.physics.articulated.articulation import Articulation


@cache
def make_held_type(num_joints: int, params_type: Any, rotor_vector: Any) -> Any:
    """Return the ``wp.struct`` of quantities that are constant over a step.

    It has the tangent of drives and dry friction, ``bounded_value - bounded_slope v`` at the final rate v, and the effort of
    springs behind dashpots at zero, ``sum k_i z_i`` [N m]. With effects on links it also has their parameters, wind [m/s] and
    gravity [m/s²], axes of the base, the pose of the base, and states and accelerations of the rotors.

    Args:
        params_type: Type of the parameters; None without effects on links.
    """
    vector = vector_type(num_joints)
    fields = {"bounded_value": vector, "bounded_slope": vector, "crept": vector}
    if params_type is not None:
        fields |= {"params": params_type, "wind": wp.vec3, "weight": wp.vec3, "position": wp.vec3, "attitude": wp.quat}
        fields |= {"rotor_speed": rotor_vector, "rotor_acc": rotor_vector}
    return wp.struct(type("Held", (), {"__annotations__": fields, "__module__": __name__}))


def make_creep(articulation: Articulation) -> tuple[wp.Function, wp.Function]:
    """Return two functions of dashpots, a vector of N D: (dashpots) -> ``Held.crept``, and (dashpots, joints, dt) -> dashpots
    at the end of a step."""
    joints, num_creep, num_joints = (
        vector_type(articulation.num_joints),
        articulation.num_creep,
        articulation.num_joints,
    )
    dashpots = vector_type(max(num_creep * num_joints, 1))
    matrix = wp.types.matrix(shape=(max(num_creep, 1), num_joints), dtype=wp.float32)
    stiffness = matrix(*(articulation.creep_stiffness.flatten().tolist() or [0.0] * num_joints))
    time = matrix(*(articulation.creep_time.flatten().tolist() or [1.0] * num_joints))

    @wp.func
    def pull(crept: dashpots) -> joints:
        total = joints()
        for i in range(wp.static(num_creep)):
            for k in range(wp.static(num_joints)):
                total[k] += stiffness[i, k] * crept[i * wp.static(num_joints) + k]
        return total

    @wp.func
    def advance_creep(crept: dashpots, pos: joints, dt: float) -> dashpots:
        after = crept
        for i in range(wp.static(num_creep)):
            for k in range(wp.static(num_joints)):
                place = i * wp.static(num_joints) + k
                after[place] = pos[k] + (crept[place] - pos[k]) * wp.exp(-dt / time[i, k])
        return after

    return pull, advance_creep


def make_effort(articulation: Articulation, k: int, held_type: Any) -> wp.Function:
    """Return a function (position, rate, constants of the step, dt) -> effort at the end of a step at this rate,
    ``f - K q' dt``, and the addition to the joint's inertia, ``C dt + K dt²``."""
    spring = {name: float(rows[0, k]) for name, rows in vars(articulation.spring).items()}
    ends = {name: float(rows[0, k]) for name, rows in vars(articulation.ends).items()}
    k1, k2, damping, rest, preload = (spring[name] for name in ("stiffness", "quadratic", "damping", "rest", "preload"))
    low, high, end_stiffness, end_damping = (ends[name] for name in ("low", "high", "stiffness", "damping"))
    passive, ended = any(spring.values()), end_stiffness > 0.0
    bounded = k in articulation.driven or float(articulation.friction[0, k]) > 0.0
    creeping = float(articulation.creep_stiffness[:, k].sum())

    @wp.func
    def effort(q: float, rate: float, held: held_type, dt: float):
        value = 0.0
        stiffness = 0.0
        damps = 0.0
        if wp.static(passive):
            away = q - wp.static(rest)
            bent = wp.abs(away)
            value += wp.static(preload) - (wp.static(k1) + wp.static(k2) * bent) * away - wp.static(damping) * rate
            stiffness += wp.static(k1) + wp.static(2.0 * k2) * bent
            damps += wp.static(damping)
        if wp.static(ended):
            past = wp.max(q - wp.static(high), 0.0) - wp.max(wp.static(low) - q, 0.0)
            back = wp.static(end_stiffness) * wp.abs(past) + wp.static(end_damping) * rate * wp.sign(past)
            if past != 0.0 and back > 0.0:
                value -= wp.sign(past) * back
                stiffness += wp.static(end_stiffness)
                damps += wp.static(end_damping)
        if wp.static(creeping > 0.0):
            value += held.crept[k] - wp.static(creeping) * q
            stiffness += wp.static(creeping)
        if wp.static(bounded):
            value += held.bounded_value[k] - held.bounded_slope[k] * rate
            damps += held.bounded_slope[k]
        soft = stiffness * dt
        return value - soft * rate, dt * (damps + soft)

    return effort
