"""Rounds of Newton's method for drives within their limits and dry friction, for one environment.

It solves the problem of ``articulated.joint_laws`` with one loop over all solutions, which compiles the recursion once.
Letters: D joints.
"""

from typing import Any

import warp as wp

from aerial_gym.math.warp_functions import vector_type
from aerial_gym.physics.articulated.articulation import Articulation
from aerial_gym.physics.articulated.fused.joint_formulas import LimitFunctions, make_effort_limit_functions
from aerial_gym.physics.articulated.fused.recursion import JointTypes
from aerial_gym.physics.articulated.joint_laws import ROUNDS
from aerial_gym.physics.fused.types import RotorTypes

SEARCHES = 24  # Most secants of a line search; sticking friction is steep, and eight left rows unsolved
FLAT = 1e-6  # Slope at the end of a line search, relative to its start: the resolution of float32


def make_solver_without_limits(
    find: wp.Function, articulation: Articulation, types: RotorTypes, joints: JointTypes, *, in_fluid: bool
) -> Any:
    """Return the same as ``make_limit_solver`` for a vehicle without drives and dry friction."""
    vehicle_type, vector, joint_vector, held_type = types.vehicle, types.vector, joints.vector, joints.held
    command_type = vector_type(max(articulation.num_driven, 1))

    @wp.func
    def solve_plain(
        vehicle: vehicle_type, more: wp.spatial_vector, fall: wp.vec3, pos: joint_vector, vel: joint_vector,
        command: command_type, given: held_type, thrusts: vector, drags: vector, w: wp.vec3, move: wp.vec3, dt: float,
    ):  # fmt: skip
        half_w = w
        half_move = move
        half_vel = vel
        rates = vel
        turn = wp.vec3()
        rise = fall
        count = wp.int32(0)
        while count < 2:  # a loop that Warp does not unroll
            rates, turn, rise = find(
                vehicle, more, fall, pos, vel, half_vel, given, thrusts, drags, w, move, half_w, half_move, dt
            )
            half_w = w + 0.5 * dt * turn
            half_move = move + 0.5 * dt * (rise - fall)
            half_vel = 0.5 * (vel + rates)
            count += 1
        return rates, turn, rise, joint_vector(), joint_vector()

    @wp.func
    def solve_once(
        vehicle: vehicle_type, more: wp.spatial_vector, fall: wp.vec3, pos: joint_vector, vel: joint_vector,
        command: command_type, given: held_type, thrusts: vector, drags: vector, w: wp.vec3, move: wp.vec3, dt: float,
    ):  # fmt: skip
        rates, turn, rise = find(vehicle, more, fall, pos, vel, vel, given, thrusts, drags, w, move, w, move, dt)
        return rates, turn, rise, joint_vector(), joint_vector()

    return solve_plain if in_fluid else solve_once


def make_limit_solver(
    find: wp.Function, articulation: Articulation, types: RotorTypes, joints: JointTypes, *, in_fluid: bool
) -> Any:
    """Return a function of a step that calls ``find`` with the efforts of drives and dry friction.

    Arguments: vehicle; wrench on the base; free fall; positions and rates of joints; commands of drives; constants of the step;
    thrusts; drag torques; angular velocity and velocity of the base; dt. Result: that of ``find``, and the applied efforts of
    drives and of dry friction. Velocity terms use the rates in the middle of the step.

    Args:
        in_fluid: Whether velocity terms depend on the velocity of the base.
    """
    laws, rubs = make_effort_limit_functions(articulation), articulation.rubs
    ask, sides, tangent, contradicts = laws.ask, laws.sides, laws.tangent, laws.contradicts
    limited_efforts, tangent_efforts, pushes = laws.efforts, laws.tangent_efforts, laws.pushes
    line_search, sides_type = make_line_search(articulation.num_joints, laws), laws.sides_type
    vehicle_type, vector, joint_vector, held_type = types.vehicle, types.vector, joints.vector, joints.held
    command_type = vector_type(max(articulation.num_driven, 1))

    @wp.func
    def solve_limits(
        vehicle: vehicle_type, more: wp.spatial_vector, fall: wp.vec3, pos: joint_vector, vel: joint_vector,
        command: command_type, given: held_type, thrusts: vector, drags: vector, w: wp.vec3, move: wp.vec3, dt: float,
    ):  # fmt: skip
        asked = ask(pos, command)
        acts = given
        rates = vel
        turn = wp.vec3()
        rise = fall
        half_w = w
        half_move = move
        half_vel = vel
        at = vel  # rates of the tried limited laws
        efforts = joint_vector()  # efforts at these rates
        side = sides_type()
        # velocity terms 0: of the start, 1: of the middle; 2: constant efforts, 3: without friction; 4, 5: their ends;
        # 6: solved
        stage = wp.int32(0)
        rounds = wp.int32(0)
        while stage < 4:
            side = sides(asked, at, dt)
            value, slope = tangent(asked, side, dt)
            if stage > 1:
                value = efforts
                slope = joint_vector()
            acts.effort = value
            acts.slope = slope
            rates, turn, rise = find(
                vehicle, more, fall, pos, vel, half_vel, acts, thrusts, drags, w, move, half_w, half_move, dt
            )
            if stage > 1:
                stage += 2
                if wp.static(rubs):
                    drive, friction = limited_efforts(asked, at, dt)
                    if stage == 4 and pushes(friction, rates):
                        efforts = drive
                        stage = 3
            elif not contradicts(asked, side, rates, dt) or (stage == 0 and rounds == wp.static(ROUNDS)):
                if stage == 0:
                    half_w = w + 0.5 * dt * turn
                    half_vel = 0.5 * (vel + rates)
                    if wp.static(in_fluid):
                        half_move = move + 0.5 * dt * (rise - fall)
                    at = rates
                stage = wp.where(stage == 0, 1, 6)
                rounds = 0
            elif rounds == wp.static(ROUNDS):
                drive, friction = limited_efforts(asked, at, dt)
                efforts = drive + friction
                stage = 2
            else:
                end = value - wp.cw_mul(slope, rates)
                share = wp.float32(1.0)
                if rounds > 0:
                    share = line_search(asked, at, efforts, rates, end, dt)
                efforts += share * (end - efforts)
                at += share * (rates - at)
                rounds += 1
        drive, friction = limited_efforts(asked, at, dt)
        if stage == 5:
            friction = joint_vector()
        if stage == 6:
            drive, friction = tangent_efforts(asked, side, rates, dt)
        return rates, turn, rise, drive, friction

    return solve_limits


def make_line_search(num_joints: int, laws: LimitFunctions) -> wp.Function:
    """Return the line search: a zero of the rising slope of the convex function, by the Illinois method.

    Arguments: asked; final rates and efforts; other final rates and their efforts; dt. Result: the share of the minimum.
    """
    joints, line_slope = vector_type(num_joints), laws.line_slope

    @wp.func
    def search_slope(
        share: float, asked: joints, rates: joints, efforts: joints, way: joints, change: joints, dt: float
    ) -> float:
        return line_slope(asked, rates + share * way, efforts + share * change, way, dt)

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
