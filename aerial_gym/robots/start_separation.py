"""Room between the starts of the vehicles of an environment: starts are redrawn until they are far enough apart.

A vehicle keeps its drawn start if that is free. Otherwise its position is redrawn, at most ``NUM_ATTEMPTS`` times; without a
free draw it takes the one with the most room. Vehicles are placed in the order of their slots, those that keep flying first.
Frames: world of each environment, z up. Letters: E environments, T vehicles of an environment over all kinds, V those of one
kind, N = E T rows over all kinds, A obstacles.
"""

import warp as wp

from aerial_gym.assets.clearance import least_gap
from aerial_gym.assets.obstacles import Obstacles
from aerial_gym.assets.scene_arrays import ABSENT_BELOW, SceneArrays
from aerial_gym.assets.vehicle_collision import Slot
from aerial_gym.math.draws import RandomArrays, draw_vec3, episode_stream
from aerial_gym.math.random import Purpose

NUM_ATTEMPTS = 64  # Largest number of redraws of a start. If half of its range is blocked, 1 in 2e19 finds no room
FIRST_REDRAW = 4  # Quantities of ``Purpose.START`` below it belong to ``initial_state``


@wp.struct
class StartRanges:
    """Draws of the start positions of one kind."""

    random: RandomArrays  # (B,)
    ratio_low: wp.vec3  # share of the bounds
    ratio_high: wp.vec3
    bounds_min: wp.array[wp.vec3]  # (B,) world [m]
    bounds_max: wp.array[wp.vec3]
    room: float  # to other vehicles, beyond their hulls [m]
    obstacle_room: float  # of the body origin to drawn obstacles [m]


@wp.struct
class ObstacleDraws:
    """Obstacles to keep away from."""

    scene: SceneArrays
    obstacles: Obstacles
    first_part: wp.array2d[wp.int32]  # (E, A), or (E, 0) to keep away from none
    end_part: wp.array2d[wp.int32]


@wp.kernel(enable_backward=False)
def separate_starts(
    starts: wp.array2d[wp.bool],  # (E, T) vehicles that start
    # params
    slots: wp.array[Slot],  # (T,)
    first_slot: int,  # of this kind
    vehicles: int,  # V of this kind
    ranges: StartRanges,
    around: ObstacleDraws,
    keeps_obstacles: wp.array[wp.bool],  # (E,) where obstacles stay, so that starts keep away from them
    # out
    states_out: wp.array2d[float],  # (N, 13) position first, world [m]; read, and written where a start moves
    position_out: wp.array[wp.vec3],  # (B,) world [m], likewise
):
    """Move starts that are too close to another vehicle or a standing obstacle."""
    env = wp.tid()
    for v in range(vehicles):
        i = first_slot + v
        if starts[env, i]:
            own = env * vehicles + v
            place = position_out[own]
            best = place
            most = float(-wp.inf)
            attempt = wp.int32(0)
            while attempt <= wp.static(NUM_ATTEMPTS):
                least = float(wp.inf)
                for j in range(slots.shape[0]):
                    if j != i and (j < i or not starts[env, j]):
                        row = slots[j].first_row + env * slots[j].row_step
                        y = wp.vec3(states_out[row, 0], states_out[row, 1], states_out[row, 2])
                        gap = wp.length(place - y) - slots[i].hull - slots[j].hull - ranges.room
                        if gap < least:  # not if the other one is at NaN
                            least = gap
                if keeps_obstacles[env]:
                    for a in range(around.first_part.shape[1]):
                        drawn = around.obstacles.table[around.obstacles.asset[env, a]].is_drawn != 0
                        if drawn and around.obstacles.position[env, a][2] >= ABSENT_BELOW:
                            first = around.first_part[env, a]
                            gap = least_gap(around.scene, env, first, around.end_part[env, a], place, wp.inf)
                            least = wp.min(least, gap - ranges.obstacle_room)
                if least > most:
                    most = least
                    best = place
                attempt += 1
                if least >= 0.0:
                    attempt = wp.static(NUM_ATTEMPTS) + 1
                else:
                    stream = episode_stream(ranges.random, own, wp.static(int(Purpose.START)))
                    share = draw_vec3(stream, wp.static(FIRST_REDRAW) + attempt, ranges.ratio_low, ranges.ratio_high)
                    low = ranges.bounds_min[own]
                    place = low + wp.cw_mul(ranges.bounds_max[own] - low, share)
            row = slots[i].first_row + env * slots[i].row_step
            position_out[own] = best
            for n in range(3):
                states_out[row, n] = best[n]
