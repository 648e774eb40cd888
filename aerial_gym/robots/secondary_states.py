"""Secondary states of a robot (Euler angles, body-frame velocities) and the check for NaN and infinity, in one launch.

Frames: world z up; body x forward, y left, z up; *vehicle* is the world turned by the yaw alone. Letters: E environments.
"""

from dataclasses import dataclass

import torch
import warp as wp
from torch import Tensor

from aerial_gym.interop import ReusableLaunch, make_struct, start_warp
from aerial_gym.interop.rows.transport import load_quat, store_row, store_vector
from aerial_gym.math.warp_functions import euler_angles
from aerial_gym.physics import BodyState
from aerial_gym.robots.finite_watch import NonFinite

RootRow = wp.types.vector(length=13, dtype=wp.float32)  # Position, attitude, velocity, angular velocity


@wp.struct
class SecondaryArrays:
    """Output arrays, each (E,)."""

    ang_vel_world: wp.array[wp.vec3]  # [rad/s]
    lin_vel_body: wp.array[wp.vec3]  # [m/s]
    vehicle_attitude: wp.array[wp.quat]  # vehicle to world
    vehicle_lin_vel: wp.array[wp.vec3]  # [m/s]
    euler: wp.array[wp.vec3]  # ZYX roll, pitch, yaw [rad]
    root_state: wp.array2d[float]  # (E, 13)


@wp.func
def derive(q: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3):
    """Return the derived states of one environment."""
    euler = euler_angles(q)
    level = wp.quat(0.0, 0.0, wp.sin(0.5 * euler[2]), wp.cos(0.5 * euler[2]))
    turn = wp.quat_rotate(q, ang_vel)
    lin_vel_body = wp.quat_rotate_inv(q, lin_vel)
    return turn, lin_vel_body, level, wp.quat_rotate_inv(level, lin_vel), euler


@wp.func
def write_derived(out: SecondaryArrays, e: int, position: wp.vec3, q: wp.quat, lin_vel: wp.vec3, ang_vel: wp.vec3):
    """Write the derived states of one environment."""
    turn, lin_vel_body, level, vehicle_lin_vel, euler = derive(q, lin_vel, ang_vel)
    out.ang_vel_world[e] = turn
    out.lin_vel_body[e] = lin_vel_body
    out.vehicle_attitude[e] = level
    out.vehicle_lin_vel[e] = vehicle_lin_vel
    out.euler[e] = euler
    for i in range(3):
        out.root_state[e, i] = position[i]
        out.root_state[e, 7 + i] = lin_vel[i]
        out.root_state[e, 10 + i] = turn[i]
    for i in range(4):
        out.root_state[e, 3 + i] = q[i]


@wp.func
def write_states(out: SecondaryArrays, e: int, x: wp.vec3, q: wp.quat, v: wp.vec3, ang_vel: wp.vec3):
    """Write the secondary states of environment ``e``, for kernels that hold its motion."""
    turn, lin_vel_body, level, vehicle_lin_vel, euler = derive(q, v, ang_vel)
    store_vector(out.ang_vel_world, e, turn)
    store_vector(out.lin_vel_body, e, lin_vel_body)
    store_vector(out.vehicle_attitude, e, level)
    store_vector(out.vehicle_lin_vel, e, vehicle_lin_vel)
    store_vector(out.euler, e, euler)
    root = RootRow(x[0], x[1], x[2], q[0], q[1], q[2], q[3], v[0], v[1], v[2], turn[0], turn[1], turn[2])
    store_row(out.root_state, e, root)


@wp.func
def all_finite(rows: wp.array2d[float], e: int) -> bool:
    """Return whether no number of a row is NaN or infinite: zero times such a number is NaN."""
    total = wp.float32(0.0)
    for i in range(rows.shape[1]):
        total += 0.0 * rows[e, i]
    return total == 0.0


@wp.kernel(enable_backward=False)
def _derive_states(
    # state
    position: wp.array[wp.vec3],  # (E,) world [m]
    attitude: wp.array[wp.quat],  # (E,) body to world, xyzw
    lin_vel: wp.array[wp.vec3],  # (E,) world [m/s]
    ang_vel: wp.array[wp.vec3],  # (E,) body [rad/s]
    rotor_speed: wp.array2d[float],  # (E, R) [rad/s]
    actions: wp.array2d[float],  # (E, U)
    # out
    out: SecondaryArrays,
    non_finite_out: wp.array[wp.int32],  # (E,) bits of NonFinite
    crashes_out: wp.array[wp.bool],  # (E,) set where anything is not finite
):
    """Write secondary states and non-finite bits of every environment; all inputs are read before the first write."""
    e = wp.tid()
    x = position[e]
    q = load_quat(attitude, e)
    v = lin_vel[e]
    w = ang_vel[e]
    bits = wp.int32(0)
    if not all_finite(actions, e):
        bits = wp.static(int(NonFinite.ACTION))
    good = wp.isfinite(x) and wp.isfinite(q) and wp.isfinite(v) and wp.isfinite(w) and all_finite(rotor_speed, e)
    if not good:
        bits = bits | wp.static(int(NonFinite.STATE))
    non_finite_out[e] = bits
    if bits != 0:
        crashes_out[e] = True
    write_states(out, e, x, q, v, w)


@dataclass(frozen=True, kw_only=True)
class FiniteCheck:
    """Tensors checked besides the motion, and the flags of NaN or infinite values."""

    actions: Tensor  # (E, U)
    non_finite: Tensor  # Receives bits of `NonFinite`, int32 (E,)
    crashes: Tensor  # Set where there are any, bool (E,)

    @classmethod
    def placeholder(cls, state: BodyState) -> "FiniteCheck":
        """Return tensors that nobody reads."""
        rows, device = state.num_envs, state.position.device
        return cls(
            actions=torch.zeros(rows, 1, device=device),
            non_finite=torch.zeros(rows, dtype=torch.int32, device=device),
            crashes=torch.zeros(rows, dtype=torch.bool, device=device),
        )


class SecondaryStates:
    """Keeps the derived states of one robot per environment, with all views made at construction."""

    def __init__(
        self, state: BodyState, *, ang_vel_world: Tensor, lin_vel_body: Tensor, vehicle_attitude: Tensor,
        vehicle_lin_vel: Tensor, euler: Tensor, root_state: Tensor, checked: FiniteCheck | None = None,
    ) -> None:  # fmt: skip
        """Take the motion as input, the output tensors (E, 3), (E, 4) and (E, 13), and the check."""
        start_warp()
        self._like = state.position
        self._checked = checked = checked or FiniteCheck.placeholder(state)
        self.arrays = make_struct(
            SecondaryArrays, ang_vel_world=ang_vel_world, lin_vel_body=lin_vel_body,
            vehicle_attitude=vehicle_attitude, vehicle_lin_vel=vehicle_lin_vel, euler=euler, root_state=root_state,
        )  # fmt: skip
        self._command = ReusableLaunch(
            _derive_states,
            dim=state.num_envs,
            inputs=[*state.tensors()[:5], checked.actions, self.arrays, checked.non_finite, checked.crashes],
            device=self._like.device,
        )

    def refresh(self) -> None:
        """Write the secondary states of this instant; launched on torch's current stream, not waited for."""
        self._command.launch(self._like)
