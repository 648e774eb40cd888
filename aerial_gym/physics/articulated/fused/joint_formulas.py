"""Warp functions of the laws of joints, traced from ``articulated.joint_laws``.

The effort that a drive is asked for is its unlimited effort at the final rate 0.
Letters: D joints, C joints with a drive, K bounded laws, N creep elements of a joint.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import nan
from typing import Any

import torch
import warp as wp
from torch import Tensor

from aerial_gym.interop.rows.warp_function import function_lines
from aerial_gym.math.warp_functions import vector_type
from aerial_gym.physics.articulated.articulation import Articulation
from aerial_gym.physics.articulated.joint_laws import EffortLimits, has_driving_friction, joint_effort
from aerial_gym.physics.fused.torch_trace import compile_traced, trace_arguments, trace_to_warp


def dashpots_type(articulation: Articulation) -> Any:
    """Return the type of the positions of all dashpots, a vector of N D."""
    return vector_type(max(articulation.num_creep * articulation.num_joints, 1))


def make_passive_efforts(articulation: Articulation) -> list[wp.Function]:
    """Return ``Effort.at_end_of_step`` of springs, dampers, soft ends and creep, one function per joint.

    Arguments: positions, rates, dashpots, dt. The recursion calls them where it needs a joint: results of all joints, computed
    in advance, would take registers over the whole step.
    """
    joints = vector_type(articulation.num_joints)

    def efforts(pos: Tensor, vel: Tensor, crept: Tensor, dt: Tensor) -> tuple[Tensor, Tensor]:
        laws = articulation.laws(_unflatten(articulation, crept) if articulation.num_creep else None)
        return joint_effort(laws, pos, vel).at_end_of_step(vel, dt)

    arguments = {"pos": joints, "vel": joints, "crept": dashpots_type(articulation), "dt": float}
    traced = trace_arguments("passive_efforts", arguments, efforts, constants={}, shared=["dt"])

    def one_joint(k: int) -> wp.Function:
        own = replace(traced.trace, outputs=[([numbers[k]], (), kind) for numbers, _, kind in traced.trace.outputs])
        lines = function_lines(own, traced.code_of_entry, ["", ""])
        return compile_traced("passive_effort", arguments, [float, float], lines, own, differentiable=False)

    return [one_joint(k) for k in range(articulation.num_joints)]


def make_creep(articulation: Articulation) -> tuple[wp.Function, wp.Function]:
    """Return ``Articulation.initialise_creep`` and ``advance_creep``: (dashpots, positions[, dt]) -> dashpots."""
    dashpots, num_creep = dashpots_type(articulation), articulation.num_creep

    def initialise(crept: Tensor, pos: Tensor) -> Tensor:
        return articulation.initialise_creep(_unflatten(articulation, crept), pos).flatten(1) if num_creep else crept

    def advance(crept: Tensor, pos: Tensor, dt: Any) -> Tensor:
        return articulation.advance_creep(_unflatten(articulation, crept), pos, dt).flatten(1) if num_creep else crept

    arguments = {"crept": dashpots, "pos": vector_type(articulation.num_joints)}
    return (
        trace_to_warp("initialise_creep", arguments, initialise, [dashpots], constants={}),
        trace_to_warp("advance_creep", {**arguments, "dt": float}, advance, [dashpots], constants={}, shared=["dt"]),
    )


def _unflatten(articulation: Articulation, crept: Tensor) -> Tensor:
    return crept.unflatten(1, (articulation.num_creep, articulation.num_joints))


@dataclass(frozen=True)
class LimitFunctions:
    """Functions of the bounded laws of all joints, of ``EffortLimits``."""

    sides_type: Any  # Vector of sides, K D
    ask: wp.Function  # (positions, commands) -> efforts that the drives are asked for
    sides: wp.Function  # (asked, final rates, dt) -> sides
    tangent: wp.Function  # (asked, sides, dt) -> total effort at the final rate 0, and its decrease with the rate
    contradicts: wp.Function  # (asked, sides, final rates, dt) -> whether any law has another side
    line_slope: wp.Function  # (asked, rates, efforts, change of rates, dt) -> slope of the convex function
    efforts: wp.Function  # (asked, final rates, dt) -> efforts of drives and of dry friction within their limits
    tangent_efforts: (
        wp.Function
    )  # (asked, sides, final rates, dt) -> efforts of drives and dry friction in a tangent step
    pushes: wp.Function  # (efforts of dry friction, rates) -> whether any acts along its rate


def make_effort_limit_functions(articulation: Articulation) -> LimitFunctions:
    """Return the Warp functions of the effort limits of a vehicle's drives and dry friction."""
    joints, has_drive = vector_type(articulation.num_joints), bool(articulation.driven)
    laws = _end_laws(articulation, torch.zeros(1, articulation.num_joints).to(articulation.friction), 0.0)
    count = laws.demand.shape[1]
    sides_type, command = vector_type(laws.limit.numel()), vector_type(max(articulation.num_driven, 1))
    driven = torch.zeros(articulation.num_joints)
    driven[list(articulation.driven)] = nan
    idle = torch.where((laws.slope == 0.0).flatten(), 0.0, nan)
    if has_drive:  # a drive to an effort has no slope
        idle[: articulation.num_joints] = driven
    constants = {"asked": driven, "side": idle}

    def trace_law_to_warp(
        name: str, arguments: Mapping[str, Any], function: Any, returns: list[Any], *, in_time: bool = True
    ) -> Any:
        known = {key: value for key, value in constants.items() if key in arguments}
        more = {"dt": float} if in_time else {}
        return trace_to_warp(name, {**arguments, **more}, function, returns, constants=known, shared=list(more))

    def by_kind(rows: Tensor) -> tuple[Tensor, Tensor]:
        none = torch.zeros_like(rows[:, 0])
        return rows[:, 0] if has_drive else none, rows[:, -1] if articulation.rubs else none

    def ask(pos: Tensor, command: Tensor) -> Tensor:
        drive = articulation.drive(command)
        return torch.zeros_like(pos) if drive is None else drive.effort_demand(pos, torch.zeros_like(pos))

    def sides(asked: Tensor, rates: Tensor, dt: Any) -> Tensor:
        return _end_laws(articulation, asked, dt).side(rates).flatten(1)

    def tangent(asked: Tensor, side: Tensor, dt: Any) -> tuple[Tensor, ...]:
        lines = _end_laws(articulation, asked, dt).tangent(side.unflatten(1, (count, -1)))
        return tuple(rows.sum(1) for rows in lines)

    def contradicts(asked: Tensor, side: Tensor, rates: Tensor, dt: Any) -> Tensor:
        return _end_laws(articulation, asked, dt).contradicts(side.unflatten(1, (count, -1)), rates)

    def line_slope(asked: Tensor, rates: Tensor, effort: Tensor, way: Tensor, dt: Any) -> Tensor:
        return _end_laws(articulation, asked, dt).line_slope(rates, effort, way)

    def efforts(asked: Tensor, rates: Tensor, dt: Any) -> tuple[Tensor, Tensor]:
        return by_kind(_end_laws(articulation, asked, dt).evaluate_effort(rates))

    def tangent_efforts(asked: Tensor, side: Tensor, rates: Tensor, dt: Any) -> tuple[Tensor, Tensor]:
        value, slope = _end_laws(articulation, asked, dt).tangent(side.unflatten(1, (count, -1)))
        return by_kind(value - slope * rates.unsqueeze(1))

    def pushes(friction: Tensor, rates: Tensor) -> Tensor:
        return has_driving_friction(friction, rates)

    rates = {"asked": joints, "rates": joints}
    side = {"asked": joints, "side": sides_type}
    return LimitFunctions(
        sides_type,
        trace_law_to_warp("ask_drives", {"pos": joints, "command": command}, ask, [joints], in_time=False),
        trace_law_to_warp("find_sides", rates, sides, [sides_type]),
        trace_law_to_warp("find_tangent", side, tangent, [joints] * 2),
        trace_law_to_warp("contradicts_sides", {**side, "rates": joints}, contradicts, [bool]),
        trace_law_to_warp("line_slope", {**rates, "effort": joints, "way": joints}, line_slope, [float]),
        trace_law_to_warp("limited_efforts", rates, efforts, [joints] * 2),
        trace_law_to_warp("tangent_efforts", {**side, "rates": joints}, tangent_efforts, [joints] * 2),
        trace_law_to_warp("has_driving_friction", {"friction": joints, "rates": joints}, pushes, [bool], in_time=False),
    )


def _end_laws(articulation: Articulation, asked: Tensor, dt: Any) -> EffortLimits:
    """Return the laws of drives and dry friction at the end of a step; ``asked`` (E, D) replaces the demand of drives."""
    drive = articulation.drive(asked.new_zeros(len(asked), articulation.num_driven))
    laws = [law for law in (drive, articulation.dry_friction_law) if law is not None]
    demand = [asked if law is drive else torch.zeros_like(asked) for law in laws]
    return replace(EffortLimits.at_end_of_step(laws, asked, dt), demand=torch.stack(demand, dim=1))
