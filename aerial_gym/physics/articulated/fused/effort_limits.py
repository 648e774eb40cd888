"""Drives with limits and dry friction at the end of a step: the Warp version of ``articulated.bounded_efforts``.

The unlimited effort of a drive at the final rate v is ``asked - slope v``. Letters: D joints, C joints with a drive.
"""

from dataclasses import dataclass
from typing import Any

import warp as wp

from aerial_gym.math.warp_functions import vector_type
from aerial_gym.physics.articulated.articulation import Articulation
from aerial_gym.physics.articulated.complementarity import TOLERANCE
from aerial_gym.physics.articulated.joint_laws import STICK_RATE

SEARCHES = 24
"""Largest number of secants of a line search; the slope is steep under sticking friction, and eight left rows unsolved."""

FLAT = 1e-6
"""Slope at the end of a line search, relative to its start: the resolution of float32."""


@dataclass(frozen=True)
class LimitLaws:
    """Functions of the bounded laws of all joints; vectors have one number per joint."""

    ask: wp.Function  # (positions, commands) -> unlimited efforts of drives at the final rate 0
    sides: wp.Function  # (asked, final rates, dt) -> sides of drives and of dry friction: 1, -1 at a limit, or 0
    tangent: wp.Function  # (asked, both sides, dt) -> effort at the rate 0, and its decrease with the rate
    fits: wp.Function  # (asked, both sides, final rates, dt) -> whether laws have these sides at these rates
    line_search: wp.Function  # (asked, rates, efforts, other rates, their efforts, dt) -> share of the minimum
    driven: wp.Function  # (asked, rates, dt) -> efforts of drives, within their limits
    rubbing: wp.Function  # (rates) -> efforts of dry friction, within its size
    pushes: wp.Function  # (efforts of dry friction, rates) -> whether any acts along its rate


def make_bounded(articulation: Articulation) -> LimitLaws:
    """Return the functions of a vehicle's bounded laws."""
    num_joints = articulation.num_joints
    joints = vector_type(num_joints)
    stiffness, damping, limit = [0.0] * num_joints, [0.0] * num_joints, [0.0] * num_joints
    for k, gains in zip(articulation.driven, articulation.drive_gains.tolist(), strict=True):
        stiffness[k], damping[k], limit[k] = gains
    softness, drag, bound = joints(*stiffness), joints(*damping), joints(*limit)
    size = joints(*articulation.friction[0].tolist())

    @wp.func
    def drive_efforts(asked: joints, rates: joints, dt: float) -> joints:
        result = joints()
        for k in range(wp.static(num_joints)):
            result[k] = wp.clamp(asked[k] - (drag[k] + dt * softness[k]) * rates[k], -bound[k], bound[k])
        return result

    @wp.func
    def friction_efforts(rates: joints) -> joints:
        result = joints()
        for k in range(wp.static(num_joints)):
            result[k] = -size[k] * wp.clamp(rates[k] / wp.static(STICK_RATE), -1.0, 1.0)
        return result

    @wp.func
    def sides(asked: joints, rates: joints, dt: float):
        of_drives = joints()
        of_friction = joints()
        for k in range(wp.static(num_joints)):
            wanted = asked[k] - (drag[k] + dt * softness[k]) * rates[k]
            if wp.abs(wanted) > bound[k]:
                of_drives[k] = wp.sign(wanted)
            if size[k] > 0.0 and wp.abs(rates[k]) > wp.static(STICK_RATE):
                of_friction[k] = -wp.sign(rates[k])
        return of_drives, of_friction

    @wp.func
    def tangent(asked: joints, of_drives: joints, of_friction: joints, dt: float):
        value = joints()
        slope = joints()
        for k in range(wp.static(num_joints)):
            if of_drives[k] == 0.0:
                value[k] = asked[k]
                slope[k] = drag[k] + dt * softness[k]
            else:
                value[k] = of_drives[k] * bound[k]
            if of_friction[k] == 0.0:
                slope[k] += size[k] / wp.static(STICK_RATE)
            else:
                value[k] += of_friction[k] * size[k]
        return value, slope

    @wp.func
    def fits(asked: joints, of_drives: joints, of_friction: joints, rates: joints, dt: float) -> bool:
        result = wp.bool(True)
        for k in range(wp.static(num_joints)):
            wanted = asked[k] - (drag[k] + dt * softness[k]) * rates[k]
            missed = wp.where(of_drives[k] == 0.0, wp.abs(wanted) - bound[k], bound[k] - of_drives[k] * wanted)
            if missed > wp.static(TOLERANCE) * bound[k]:
                result = False
            if size[k] > 0.0:
                speed = wp.where(
                    of_friction[k] == 0.0, wp.abs(rates[k]), 2.0 * wp.static(STICK_RATE) + of_friction[k] * rates[k]
                )
                if speed > wp.static(STICK_RATE * (1.0 + TOLERANCE)):
                    result = False
        return result

    @wp.func
    def pushes(efforts: joints, rates: joints) -> bool:
        result = wp.bool(False)
        for k in range(wp.static(num_joints)):
            if efforts[k] * rates[k] > 0.0:
                result = True
        return result

    line_search = _make_line_search(num_joints, joints, drive_efforts, friction_efforts)
    ask = _make_ask(articulation, joints)
    return LimitLaws(ask, sides, tangent, fits, line_search, drive_efforts, friction_efforts, pushes)


def _make_line_search(num_joints: int, joints: Any, driven: wp.Function, rubbing: wp.Function) -> wp.Function:
    """Return ``BoundedLaws.line_search``: a zero of the rising slope of the convex function, by the Illinois method."""

    @wp.func
    def search_slope(
        share: float, asked: joints, rates: joints, efforts: joints, way: joints, change: joints, dt: float
    ) -> float:
        at = rates + share * way
        return wp.dot(way, efforts + share * change - driven(asked, at, dt) - rubbing(at))

    @wp.func
    def line_search(
        asked: joints, rates: joints, efforts: joints, end_rates: joints, end_efforts: joints, dt: float
    ) -> float:
        way = end_rates - rates
        change = end_efforts - efforts
        low = wp.float32(0.0)
        high = wp.float32(1.0)
        share = wp.float32(1.0)
        slope_high = search_slope(1.0, asked, rates, efforts, way, change, dt)
        slope_low = search_slope(0.0, asked, rates, efforts, way, change, dt)
        flat = -wp.static(FLAT) * slope_low
        count = wp.int32(0)
        if slope_high <= 0.0 or slope_low >= 0.0:
            count = wp.int32(wp.static(SEARCHES))
        while count < wp.static(SEARCHES):  # a loop that Warp does not unroll
            share = low + (high - low) * slope_low / (slope_low - slope_high)
            slope = search_slope(share, asked, rates, efforts, way, change, dt)
            if slope > 0.0:
                high = share
                slope_high = slope
                slope_low = 0.5 * slope_low
            else:
                low = share
                slope_low = slope
                slope_high = 0.5 * slope_high
            count = wp.where(wp.abs(slope) < flat, wp.static(SEARCHES), count + 1)
        return share

    return line_search


def _make_ask(articulation: Articulation, joints: Any) -> wp.Function:
    """Return ``BoundedLaws.ask``, drive by drive."""
    command_type = vector_type(max(articulation.num_driven, 1))

    @wp.func
    def no_effort(pos: joints, command: command_type) -> joints:
        return joints()

    def with_drive(rest: wp.Function, place: int) -> wp.Function:
        k, mode = articulation.driven[place], articulation.modes[place]
        stiffness, damping, _ = articulation.drive_gains[place].tolist()
        low, high = float(articulation.command_low[place]), float(articulation.command_high[place])
        gain = {"position": stiffness, "velocity": damping, "effort": 1.0}[mode]

        @wp.func
        def ask(pos: joints, command: command_type) -> joints:
            asked = rest(pos, command)
            told = wp.clamp(command[wp.static(place)], wp.static(low), wp.static(high))
            asked[k] = wp.static(gain) * told
            if wp.static(mode == "position"):
                asked[k] = wp.static(stiffness) * (told - pos[k])
            return asked

        return ask

    total = no_effort
    for place in range(articulation.num_driven):
        total = with_drive(total, place)
    return total
