"""Random race tracks: nominal and actual places of gates and poles, drawn at a reset.

One thread draws the track of an environment; the numbers depend only on seed, environment, episode and quantity.
Frames: world of each environment, z up. Letters: E environments, G gates, P poles.
"""

from collections.abc import Sequence

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.obstacles import Obstacles
from aerial_gym.config.environment import LayoutCfg, TrackCfg
from aerial_gym.interop import ReusableLaunch, make_struct, start_warp
from aerial_gym.math.draws import RandomArrays, draw_vec3, episode_stream, quat_from_angles, random_arrays, substream
from aerial_gym.math.random import Purpose, Randomness

NUM_ATTEMPTS = 64  # Attempts to keep the distances; then the best counts. If they leave 5 % of the area, 4 % fail

PLACE, IN_CORRIDOR, YAW, POSITION_OFFSET, EULER_OFFSET, POLE_PLACE, POLE_OFFSET = (wp.constant(i) for i in range(7))
"""Drawn quantities of a gate and of the pole before it."""

NUM_DRAWS = wp.constant(7)


@wp.struct
class TrackLayout:
    """Kernel form of ``LayoutCfg``."""

    is_drawn: wp.int32
    lower: wp.vec2  # [m]
    upper: wp.vec2
    start_distance: wp.float32  # [m], as all below
    gate_distance: wp.float32
    pole_to_gate: wp.float32
    pole_distance: wp.float32
    corridor: wp.float32
    yaw_range: wp.float32  # [rad]


@wp.struct
class TrackParameters:
    """Kernel form of ``TrackCfg``."""

    gate_position: wp.array[wp.vec3]  # (G,) nominal, world [m]
    gate_euler: wp.array[wp.vec3]  # (G,) [rad]
    pole: wp.array[wp.vec3]  # (P,) [m]
    gate_position_low: wp.vec3
    gate_position_high: wp.vec3
    gate_euler_low: wp.vec3
    gate_euler_high: wp.vec3
    pole_low: wp.vec3
    pole_high: wp.vec3
    layout: TrackLayout


@wp.struct
class TrackPoses:
    """Poses of gates and positions of poles."""

    gate_position: wp.array2d[wp.vec3]  # (E, G) world [m]
    gate_attitude: wp.array2d[wp.quat]  # (E, G) gate to world, xyzw
    pole_position: wp.array2d[wp.vec3]  # (E, P) tops, world [m]


@wp.func
def _horizontal(place: wp.vec3) -> wp.vec2:
    return wp.vec2(place[0], place[1])


@wp.func
def _least_margin(
    nominal: TrackPoses,
    env: int,
    gates: int,  # number of gates with a known place
    poles: int,
    start: wp.vec2,
    point: wp.vec2,
    to_start: float,
    to_gate: float,
    to_pole: float,
) -> float:
    """Return the smallest margin of a point above its required distances [m]; negative if one is violated."""
    room = wp.length(point - start) - to_start
    for g in range(gates):
        room = wp.min(room, wp.length(point - _horizontal(nominal.gate_position[env, g])) - to_gate)
    for p in range(poles):
        room = wp.min(room, wp.length(point - _horizontal(nominal.pole_position[env, p])) - to_pole)
    return room


@wp.func
def _gate_place(
    nominal: TrackPoses, layout: TrackLayout, env: int, g: int, poles: int, start: wp.vec2, random: wp.uint32
):
    """Draw the place of the next gate [m], and its heading from the previous one [rad]."""
    best = wp.vec2()
    most = float(-wp.inf)
    attempt = wp.int32(0)
    while attempt < NUM_ATTEMPTS and most < 0.0:
        share = substream(random, attempt)
        point = layout.lower + wp.cw_mul(wp.vec2(wp.randf(share), wp.randf(share)), layout.upper - layout.lower)
        room = _least_margin(
            nominal, env, g, poles, start, point, layout.start_distance, layout.gate_distance, layout.pole_to_gate
        )
        if room > most:
            most = room
            best = point
        attempt += 1
    last = start
    if g > 0:
        last = _horizontal(nominal.gate_position[env, g - 1])
    return best, wp.atan2(best[1] - last[1], best[0] - last[0])


@wp.func
def _pole_place(
    nominal: TrackPoses, layout: TrackLayout, env: int, g: int, start: wp.vec2, near: wp.uint32, far: wp.uint32
):
    """Draw the place [m] of the pole before a gate of known place."""
    last = start
    if g > 0:
        last = _horizontal(nominal.gate_position[env, g - 1])
    way = _horizontal(nominal.gate_position[env, g]) - last
    left = wp.normalize(wp.vec2(-way[1], way[0]))
    best = wp.vec2()
    most = float(-wp.inf)
    attempt = wp.int32(0)
    if 0.25 * wp.dot(way, way) + layout.corridor * layout.corridor < layout.pole_to_gate * layout.pole_to_gate:
        attempt = NUM_ATTEMPTS  # even the middle of the corridor's edges is too near to both gates
    while attempt < 2 * NUM_ATTEMPTS and most < 0.0:
        point = wp.vec2()
        if attempt < NUM_ATTEMPTS:
            share = substream(near, attempt)
            along = wp.randf(share)
            point = last + along * way + (2.0 * wp.randf(share) - 1.0) * layout.corridor * left
        else:
            share = substream(far, attempt)
            point = layout.lower + wp.cw_mul(wp.vec2(wp.randf(share), wp.randf(share)), layout.upper - layout.lower)
        inside = point[0] >= layout.lower[0] and point[1] >= layout.lower[1]
        inside = inside and point[0] <= layout.upper[0] and point[1] <= layout.upper[1]
        room = _least_margin(
            nominal, env, g + 1, g, start, point, layout.start_distance, layout.pole_to_gate, layout.pole_distance
        )
        if inside and room > most:
            most = room
            best = point
        attempt += 1
    return best


@wp.kernel(enable_backward=False)
def _draw_track(
    mask: wp.array[wp.bool],  # (E,)
    # state
    start: wp.array[wp.vec3],  # (E,) of the robot, world [m]
    # params
    random: RandomArrays,
    track: TrackParameters,
    # out
    nominal_out: TrackPoses,
    places_out: TrackPoses,
    obstacles_out: Obstacles,
):
    """Draw the track of masked environments: nominal and actual places of gates and poles, the first G + P instances."""
    env = wp.tid()
    if not mask[env]:
        return
    stream = episode_stream(random, env, wp.static(int(Purpose.TRACK)))
    gates = track.gate_position.shape[0]
    poles = track.pole.shape[0]
    layout = track.layout
    from_there = _horizontal(start[env])
    for g in range(gates):
        first = g * NUM_DRAWS
        place = track.gate_position[g]
        euler = track.gate_euler[g]
        if layout.is_drawn == 1:
            known = wp.min(g, poles)
            gate_place, heading = _gate_place(
                nominal_out, layout, env, g, known, from_there, substream(stream, first + PLACE)
            )
            turn = layout.yaw_range * (2.0 * wp.randf(substream(stream, first + YAW)) - 1.0)
            place = wp.vec3(gate_place[0], gate_place[1], place[2])
            euler = wp.vec3(euler[0], euler[1], heading + turn)
        nominal_out.gate_position[env, g] = place
        nominal_out.gate_attitude[env, g] = quat_from_angles(euler)
        offset = draw_vec3(stream, first + POSITION_OFFSET, track.gate_position_low, track.gate_position_high)
        turn_offset = draw_vec3(stream, first + EULER_OFFSET, track.gate_euler_low, track.gate_euler_high)
        there = place + offset
        turned = quat_from_angles(euler + turn_offset)
        places_out.gate_position[env, g] = there
        places_out.gate_attitude[env, g] = turned
        obstacles_out.position[env, g] = there
        obstacles_out.attitude[env, g] = turned
        if g < poles and layout.is_drawn == 1:
            near = substream(stream, first + IN_CORRIDOR)
            spot = _pole_place(nominal_out, layout, env, g, from_there, near, substream(stream, first + POLE_PLACE))
            nominal_out.pole_position[env, g] = wp.vec3(spot[0], spot[1], track.pole[g][2])
    for p in range(poles):
        if layout.is_drawn == 0:
            nominal_out.pole_position[env, p] = track.pole[p]
        shift = draw_vec3(stream, p * NUM_DRAWS + POLE_OFFSET, track.pole_low, track.pole_high)
        top = nominal_out.pole_position[env, p] + shift
        places_out.pole_position[env, p] = top
        obstacles_out.position[env, gates + p] = top
        obstacles_out.attitude[env, gates + p] = wp.quat_identity()


def _layout_struct(cfg: LayoutCfg | None) -> TrackLayout:
    layout = TrackLayout()
    if cfg is not None:
        layout.is_drawn, layout.lower, layout.upper = 1, wp.vec2(*cfg.lower), wp.vec2(*cfg.upper)
        for name in ("start_distance", "gate_distance", "pole_to_gate", "pole_distance", "corridor", "yaw_range"):
            setattr(layout, name, getattr(cfg, name))
    return layout


def _pose_arrays(tensors: Sequence[Tensor]) -> TrackPoses:
    position, attitude, pole = tensors
    return make_struct(TrackPoses, gate_position=position, gate_attitude=attitude, pole_position=pole)


class TrackPlacement:
    """Draws of the tracks of masked environments; all views are made at construction."""

    def __init__(
        self, cfg: TrackCfg, obstacles: Obstacles, *, nominal: Sequence[Tensor], places: Sequence[Tensor],
        start: Tensor, random: Randomness,
    ) -> None:  # fmt: skip
        """Record the launch.

        Args:
            nominal: Gate positions [m], world, (E, G, 3), gate attitudes, gate to world, xyzw, (E, G, 4), and pole tops
                [m], world, (E, P, 3); written.
            places: The actual ones, likewise.
            start: Start of the robot [m], world, (E, 3); read at every draw.
        """
        start_warp()
        device = start.device
        lists = [[gate.position for gate in cfg.gates], [gate.euler for gate in cfg.gates], cfg.poles]
        given = [torch.tensor(rows, device=device, dtype=torch.float32).reshape(-1, 3) for rows in lists]
        track = make_struct(TrackParameters, gate_position=given[0], gate_euler=given[1], pole=given[2])
        for name in ("gate_position", "gate_euler", "pole"):
            for end in ("low", "high"):
                setattr(track, f"{name}_{end}", wp.vec3(*getattr(cfg, f"{name}_{end}")))
        track.layout = _layout_struct(cfg.layout)
        self._mask = random.mask
        self._command = ReusableLaunch(
            _draw_track, dim=start.shape[0], inputs=[self._mask, start, random_arrays(random), track],
            outputs=[_pose_arrays(nominal), _pose_arrays(places), obstacles], device=device,
        )  # fmt: skip

    def draw(self) -> None:
        """Launch the draw for the masked environments of ``random`` on torch's current stream."""
        self._command.launch(self._mask)
