"""A payload that the vehicles of an environment carry together on cables without mass.

A substep of the physics moves vehicles and payload apart from each other. Impulses along the cables then join them. With the
vector d from the anchor on a vehicle to the payload before the substep, its relative velocity U after it, and the length l::

    (d . U + dt U² / 2) / l = (l² - d²) / (2 l dt)

so that the cable has its length after the substep. The impulses act along the cables as they were before the substep. This is
SHAKE on top of semi-implicit Euler. It conserves momentum and, with anchors at the centres of mass, angular momentum. The
energy of rigid cables oscillates in proportion to dt, without drift. A slack cable has ``<=`` for ``=``, and no push. It
becomes taut by an inelastic impact. All impulses are solved together, with a Newton iteration on the directions at the end.
Sources: Ryckaert, Ciccotti, Berendsen (1977), J. Comput. Phys. 23, eq. 5.4 (SHAKE); Lee, Sreenath, Kumar (2013), Geometric
control of cooperating multiple quadrotor UAVs with a suspended payload, eq. 1-4 (point mass on massless links).
Letters: E environments, V vehicles of each, B = E V bodies, K substeps.
"""

from collections.abc import Mapping
from math import cos, pi, sin

import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.vehicles import MOST_CARRIERS, PayloadCfg
from aerial_gym.errors import ShapeError
from aerial_gym.interop import ReusableLaunch, make_struct, start_warp
from aerial_gym.math.quaternion import quat_rotate
from aerial_gym.math.rows import sum_slices
from aerial_gym.math.warp_functions import rotate, rotate_inverse, rotation_quat, unit_quat
from aerial_gym.physics import Trajectory
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec

ITERATIONS = wp.constant(3)  # Of Newton's method; the error is squared in each, from (dt U / l)²
RECOVERY = wp.constant(0.1)  # Share of a stretch by rounding that a substep removes: all of it would be noise of 1 / dt
ROUNDING = wp.constant(1.0e-6)  # Error of a difference of float32 positions per position: 8 units in the last place

Vectors = wp.types.matrix(shape=(MOST_CARRIERS, 3), dtype=wp.float32)


@wp.struct
class Carriers:
    """The vehicles of all environments after a substep without cables; a launch corrects them."""

    count: int  # V
    mass: wp.array[float]  # (B,) [kg]
    inertia: wp.array[wp.mat33]  # (B,) about the centre of mass, body [kg m²]
    com: wp.array[wp.vec3]  # (B,) from the body origin, body [m]
    position: wp.array[wp.vec3]  # (B,) body origin, world [m]
    attitude: wp.array[wp.quat]  # (B,) body to world, xyzw
    lin_vel: wp.array[wp.vec3]  # (B,) of the body origin, world [m/s]
    ang_vel: wp.array[wp.vec3]  # (B,) body [rad/s]


KEYS_OF_CARRIERS = {
    "mass": "robot_mass", "inertia": "robot_inertia", "position": "robot_position", "attitude": "robot_orientation",
    "lin_vel": "robot_linvel", "ang_vel": "robot_body_angvel",
}  # fmt: skip


@wp.struct
class Load:
    """Payload and cables."""

    mass: float  # [kg]
    length: float  # of every cable [m]
    anchor: wp.vec3  # of the cable from the body origin, body [m]
    slack: wp.bool  # whether cables only pull
    gravity: float  # [m/s²]
    ground: float  # height of the ground, world [m]
    position: wp.array[wp.vec3]  # (E,) world [m]
    lin_vel: wp.array[wp.vec3]  # (E,) world [m/s]


@wp.func
def _impulses(system: wp.mat44, target: wp.vec4, count: int, slack: wp.bool) -> wp.vec4:
    """Return x with ``system x = target``; of slack cables ``x >= 0``, ``system x >= target``, one of them an equality.

    Without rounding one set of taut cables fulfils all three. The set with the least violation [m/s] is taken.
    """
    best = wp.vec4()
    least = wp.float32(wp.inf)
    taut = (1 << count) - 1  # bits of the cables
    last = wp.where(slack, 0, taut)
    while taut >= last and least > 0.0:
        matrix = wp.identity(n=4, dtype=float)
        side = wp.vec4()
        for i in range(count):
            if (taut >> i) & 1 == 1:
                side[i] = target[i]
                for j in range(count):
                    if (taut >> j) & 1 == 1:
                        matrix[i, j] = system[i, j]
        x = wp.inverse(matrix) * side
        rest = system * x - target
        fault = wp.float32(0.0)
        if slack:
            for i in range(count):
                fault = wp.max(fault, wp.where((taut >> i) & 1 == 1, -x[i] * system[i, i], -rest[i]))
        if fault < least:
            least = fault
            best = x
        taut -= 1
    return best


@wp.kernel(enable_backward=False)
def _join(
    # params
    load: Load,  # read and written
    substep: int,
    dt: float,  # [s]
    # state
    carriers: Carriers,  # read and written
    # out
    position_out: wp.array2d[wp.vec3],  # (K + 1, B) poses at the start of a step, read, and after each substep
    attitude_out: wp.array2d[wp.quat],  # (K + 1, B)
    tension_out: wp.array2d[float],  # (E, V) [N]
    crashes_out: wp.array[wp.bool],  # (B,) set if the payload is below the ground
):
    """Move the payload by a substep and apply the impulses of its cables."""
    env = wp.tid()
    count = carriers.count
    place = load.position[env]
    free = load.lin_vel[env] - wp.vec3(0.0, 0.0, load.gravity * dt)
    offset = Vectors()  # from each anchor to the payload before the substep [m]
    along = Vectors()  # its direction
    moves = Vectors()  # velocity of the centre of mass without cables [m/s]
    spin = Vectors()  # change of angular velocity per impulse, body [rad/s / (N s)]
    allowed = wp.vec4()  # relative velocity along the cable [m/s]
    for i in range(count):
        b = env * count + i
        before = attitude_out[substep, b]
        anchor = position_out[substep, b] + rotate(before, load.anchor)
        d = place - anchor
        n = wp.normalize(d)
        gap = (load.length * load.length - wp.dot(d, d)) / (2.0 * load.length)
        is_loose = load.slack and gap > ROUNDING * (wp.length(anchor) + load.length)
        allowed[i] = wp.where(is_loose, gap, RECOVERY * gap) / dt
        offset[i] = d
        along[i] = n
        moves[i] = carriers.lin_vel[b] + rotate(carriers.attitude[b], wp.cross(carriers.ang_vel[b], carriers.com[b]))
        spin[i] = wp.inverse(carriers.inertia[b]) * wp.cross(load.anchor - carriers.com[b], rotate_inverse(before, n))
    impulse = wp.vec4()
    for _iteration in range(ITERATIONS):
        pulled = free
        for i in range(count):
            pulled -= (impulse[i] / load.mass) * along[i]
        system = wp.mat44()
        target = wp.vec4()
        for i in range(count):
            b = env * count + i
            lever = load.anchor - carriers.com[b]
            turned = carriers.attitude[b] * rotation_quat(dt * impulse[i] * spin[i])
            swing = (rotate(turned, lever) - rotate(attitude_out[substep, b], lever)) / dt
            velocity = pulled - moves[i] - (impulse[i] / carriers.mass[b]) * along[i] - swing
            after = (offset[i] + dt * velocity) / load.length
            mobility = along[i] / carriers.mass[b] + rotate(turned, wp.cross(spin[i], lever))
            for j in range(count):
                system[i, j] = wp.dot(after, along[j]) / load.mass
            system[i, i] = system[i, i] + wp.dot(after, mobility)
            excess = wp.dot(offset[i], velocity) + 0.5 * dt * wp.dot(velocity, velocity)
            target[i] = excess / load.length - allowed[i]
        impulse = _impulses(system, target + system * impulse, count, load.slack)
    for i in range(count):
        b = env * count + i
        free -= (impulse[i] / load.mass) * along[i]
        if impulse[i] != 0.0:
            q = carriers.attitude[b]
            com = carriers.com[b]
            push = (impulse[i] / carriers.mass[b]) * along[i]
            w = carriers.ang_vel[b] + impulse[i] * spin[i]
            turned = unit_quat(q * rotation_quat(dt * impulse[i] * spin[i]))
            carriers.position[b] = carriers.position[b] + dt * push + (rotate(q, com) - rotate(turned, com))
            carriers.lin_vel[b] = (moves[i] + push) - rotate(turned, wp.cross(w, com))
            carriers.ang_vel[b] = w
            carriers.attitude[b] = turned
        position_out[substep + 1, b] = carriers.position[b]
        attitude_out[substep + 1, b] = carriers.attitude[b]
        tension_out[env, i] = impulse[i] / dt
    load.lin_vel[env] = free
    load.position[env] = place + dt * free
    if place[2] + dt * free[2] < load.ground:
        for i in range(count):
            crashes_out[env * count + i] = True


class PayloadOnCables:
    """The payloads of all environments, one launch after each substep; all views are made at construction."""

    def __init__(
        self, cfg: PayloadCfg, gtd: GlobalTensorDictionary, bodies: Mapping[str, Tensor], followed: Trajectory, *,
        com: Tensor, starts: Tensor, gravity: float, dt: float, ground_height: float | None,
    ) -> None:  # fmt: skip
        """Declare the state of the payloads.

        Args:
            gtd: Of the environments, (E, V, ...).
            bodies: The vehicles by the keys of their dictionary, (B, ...).
            followed: Receives the poses of the vehicles after each substep, (K + 1, B).
            com: Centres of mass from the body origins [m], body, (B, 3).
            starts: Vehicles that start, bool, (B,); read at every ``hang``.
            gravity: Downward acceleration of free fall [m/s²].
            dt: Length of a substep [s].
            ground_height: Height of the ground [m], world; None without ground.
        """
        start_warp()
        self._bodies, self._followed, self._starts = bodies, followed, starts
        self.position, self.lin_vel, self.tension = (
            gtd.declare(TensorSpec(key=key, shape=shape, unit=unit, frame=frame, owner="env", meaning=meaning))
            for key, shape, unit, frame, meaning in (
                ("payload_position", ("E", 3), "m", "world", "place of the payload that all vehicles carry"),
                ("payload_linvel", ("E", 3), "m/s", "world", "its velocity"),
                ("payload_tension", ("E", "V"), "N", "-", "pull of each vehicle's cable in the last substep"),
            )
        )
        num_envs, count = self.tension.shape
        carriers = make_struct(
            Carriers, count=count, com=com, **{name: bodies[key] for name, key in KEYS_OF_CARRIERS.items()}
        )
        load = make_struct(
            Load, mass=cfg.mass, length=cfg.cable_length, anchor=wp.vec3(*cfg.anchor), slack=cfg.cables == "slack",
            gravity=gravity, ground=-1e30 if ground_height is None else ground_height, position=self.position,
            lin_vel=self.lin_vel,
        )  # fmt: skip
        outputs = [followed.position, followed.attitude, self.tension, bodies["crashes"]]
        self._join = [
            ReusableLaunch(
                _join, dim=num_envs, inputs=[load, k, dt, carriers], outputs=outputs, device=gtd.device
            )
            for k in range(followed.max_substeps)
        ]  # fmt: skip
        yaw = torch.arange(count, device=gtd.device) * (2.0 * pi / count)
        circle = torch.stack((yaw.cos(), yaw.sin(), torch.zeros_like(yaw)), dim=1)
        self._circle = cfg.cable_length * sin(cfg.angle) * circle
        self._below = torch.tensor((0.0, 0.0, cfg.cable_length * cos(cfg.angle)), device=gtd.device)
        self._anchor = torch.tensor(cfg.anchor, device=gtd.device).expand(num_envs * count, 3)

    def begin(self, substeps: int) -> None:
        """Record the poses at the start of ``substeps``."""
        if substeps > len(self._join):
            raise ShapeError(f"substeps = {substeps}: this environment has room for {len(self._join)}")
        self._followed.position[0].copy_(self._bodies["robot_position"])
        self._followed.attitude[0].copy_(self._bodies["robot_orientation"])

    def join(self, substep: int) -> None:
        """Move the payloads by a substep (from 0) that the vehicles have just flown, and pull on both."""
        self._join[substep].launch(self.position)

    @torch.no_grad()
    def hang(self) -> None:
        """Put vehicles that start on a circle about their mean place, above the payload, and all at their mean velocity."""
        shape = self.tension.shape
        starts = self._starts.view(shape)[:, :1]
        place, velocity = (self._bodies[key].unflatten(0, shape) for key in ("robot_position", "robot_linvel"))
        center, mean = (sum_slices(each, 1) / shape[1] for each in (place, velocity))
        anchor = quat_rotate(self._bodies["robot_orientation"], self._anchor).unflatten(0, shape)
        for target, rows in (
            (place, center.unsqueeze(1) + self._circle - anchor),
            (velocity, mean.unsqueeze(1)),
            (self.position, center - self._below),
            (self.lin_vel, mean),
            (self.tension, torch.zeros_like(self.tension)),
        ):
            target.copy_(torch.where(starts.unsqueeze(-1) if target.dim() == 3 else starts, rows, target))
