"""What acts in one joint at the end of a step, as ``joint_laws`` has it: laws that a joint does not have cost nothing."""

import warp as wp

from aerial_gym.physics.articulated.articulation import Articulation
from aerial_gym.physics.fused.types import vector_of


def make_effort(articulation: Articulation, k: int) -> wp.Function:
    """Return a function (position, rate, commands of all drives, side on which the drive is at its limit, dt) -> effort less
    what a step at this rate takes off it, and what is added to the joint's inertia: ``f - K q' dt`` and ``C dt + K dt²``."""
    spring = {name: float(rows[0, k]) for name, rows in vars(articulation.spring).items()}
    ends = {name: float(rows[0, k]) for name, rows in vars(articulation.ends).items()}
    k1, k2, damping, rest, preload = (spring[name] for name in ("stiffness", "quadratic", "damping", "rest", "preload"))
    low, high, end_stiffness, end_damping = (ends[name] for name in ("low", "high", "stiffness", "damping"))
    passive, ended = any(spring.values()), end_stiffness > 0.0
    driven = k in articulation.driven
    drive_stiffness, drive_damping, limit = 0.0, 0.0, 0.0
    if driven:
        drive_stiffness, drive_damping, limit = articulation.drive_gains[articulation.driven.index(k)].tolist()
    wanted = _make_wanted(articulation, k)
    command_type = vector_of(max(articulation.num_driven, 1))

    @wp.func
    def effort(q: float, rate: float, command: command_type, at_limit: float, dt: float):
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
        if wp.static(driven):
            if at_limit == 0.0:
                value += wanted(q, rate, command)
                stiffness += wp.static(drive_stiffness)
                damps += wp.static(drive_damping)
            else:
                value += at_limit * wp.static(limit)
        soft = stiffness * dt
        return value - soft * rate, dt * (damps + soft)

    return effort


def _make_wanted(articulation: Articulation, k: int) -> wp.Function:
    """Return a function (position, rate, commands of all drives) -> effort that is asked of the drive of a joint."""
    command_type = vector_of(max(articulation.num_driven, 1))

    @wp.func
    def nothing(q: float, rate: float, command: command_type) -> float:
        return 0.0

    if k not in articulation.driven:
        return nothing
    place = articulation.driven.index(k)
    mode, (stiffness, damping, _) = articulation.modes[place], articulation.drive_gains[place].tolist()
    low, high = float(articulation.command_low[place]), float(articulation.command_high[place])

    @wp.func
    def wanted(q: float, rate: float, command: command_type) -> float:
        asked = wp.clamp(command[wp.static(place)], wp.static(low), wp.static(high))
        if wp.static(mode == "position"):
            return wp.static(stiffness) * (asked - q) - wp.static(damping) * rate
        if wp.static(mode == "velocity"):
            return wp.static(damping) * (asked - rate)
        return asked

    return wanted


def make_beyond(articulation: Articulation) -> wp.Function:
    """Return ``Drive.beyond`` of all joints, (positions, rates, commands) -> sides."""
    joints = vector_of(articulation.num_joints)
    command_type = vector_of(max(articulation.num_driven, 1))

    @wp.func
    def nowhere(pos: joints, vel: joints, command: command_type) -> joints:
        return joints()

    def with_drive(rest: wp.Function, k: int, wanted: wp.Function, limit: float) -> wp.Function:
        @wp.func
        def beyond(pos: joints, vel: joints, command: command_type) -> joints:
            sides = rest(pos, vel, command)
            asked = wanted(pos[k], vel[k], command)
            if wp.abs(asked) > wp.static(limit):
                sides[k] = wp.sign(asked)
            return sides

        return beyond

    total = nowhere
    for place, k in enumerate(articulation.driven):
        total = with_drive(total, k, _make_wanted(articulation, k), float(articulation.drive_gains[place, 2]))
    return total
