"""What vehicles of an environment know of each other: range, bearing and velocity by a network, and line of sight by a ray.

Frames: world of each environment, z up; what a vehicle knows is in its own body frame. Letters: E environments, T vehicles of
an environment over all kinds (*slots*), V those of one kind, B = E V bodies of a kind, N = E T rows over all kinds, K past
states. The columns of a vehicle are all slots but its own, in order.
"""

from collections.abc import Sequence

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.part_rays import ray_distance_to_part
from aerial_gym.assets.scene import Scene
from aerial_gym.assets.scene_arrays import SceneArrays, part_is_present, part_position
from aerial_gym.assets.vehicle_collision import Slot, SlotTable
from aerial_gym.config.vehicles import NetworkCfg
from aerial_gym.interop import ReusableLaunch, make_struct
from aerial_gym.math.draws import RandomArrays, episode_stream, random_arrays, substream
from aerial_gym.math.random import Purpose, Randomness
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec
from aerial_gym.sensors.images import latency_steps

MESSAGE = ("position", "velocity")  # What a vehicle sends

_KEYS = (
    ("neighbour_range", 1, torch.float32, "m", "-", "distance of the body origins, as last received"),
    ("neighbour_bearing", 3, torch.float32, "-", "body", "unit vector to the other body origin, as last received"),
    ("neighbour_velocity", 3, torch.float32, "m/s", "body", "velocity of the other as last received, less the own one"),
    ("neighbour_age", 1, torch.float32, "s", "-", "time since the other vehicle was in the state last received"),
    ("neighbour_in_sight", 1, torch.bool, "-", "-", "no obstacle and no ground lies between the body origins now"),
)


@wp.struct
class _Network:
    """The messages of all vehicles."""

    slots: wp.array[Slot]  # (T,)
    position: wp.array[wp.vec3]  # (N,) world [m]
    attitude: wp.array[wp.quat]  # (N,) body to world, xyzw
    velocity: wp.array[wp.vec3]  # (N,) world [m/s]
    starts: wp.array2d[wp.bool]  # (E, T) vehicles that begin an episode
    sent: wp.array[wp.int32]  # (N,) messages since that
    sent_position: wp.array2d[wp.vec3]  # (K, N) state of message m in row m % K
    sent_velocity: wp.array2d[wp.vec3]  # (K, N)
    dt: wp.float32  # time between two messages [s]
    dropout: wp.float32
    needs_sight: wp.bool


@wp.struct
class _Reception:
    """What the vehicles of one kind know of all others."""

    random: RandomArrays
    position: wp.array2d[wp.vec3]  # (B, T - 1) as last received, world [m]
    velocity: wp.array2d[wp.vec3]  # (B, T - 1) world [m/s]
    age: wp.array2d[wp.int32]  # (B, T - 1) [steps]
    range_out: wp.array2d[float]  # (B, T - 1) [m]
    bearing_out: wp.array2d[wp.vec3]  # (B, T - 1) body
    velocity_out: wp.array2d[wp.vec3]  # (B, T - 1) body [m/s]
    age_out: wp.array2d[float]  # (B, T - 1) [s]
    in_sight_out: wp.array2d[wp.bool]  # (B, T - 1)


@wp.kernel(enable_backward=False)
def _send(network: _Network, begins: wp.bool):
    """Send the state of each vehicle, or that of vehicles whose episode begins, as message 0."""
    env, t = wp.tid()
    if begins and not network.starts[env, t]:
        return
    row = network.slots[t].first_row + env * network.slots[t].row_step
    count = wp.where(begins, 0, network.sent[row] + 1)
    network.sent[row] = count
    k = count % network.sent_position.shape[0]
    network.sent_position[k, row] = network.position[row]
    network.sent_velocity[k, row] = network.velocity[row]


@wp.func
def _sees(scene: SceneArrays, env: int, start: wp.vec3, end: wp.vec3) -> wp.bool:
    """Return whether no obstacle and no ground lies between two points."""
    limit = wp.length(end - start)
    ray = wp.normalize(end - start)
    for part in range(scene.num_solid):
        if part_is_present(scene, env, part):
            to = part_position(scene, env, part) - start
            aside = wp.length(to - wp.clamp(wp.dot(to, ray), 0.0, limit) * ray)
            near = aside <= scene.radius[env, part]  # within the bounding sphere
            if near and ray_distance_to_part(scene, env, part, start, ray, limit) < limit:
                return False
    return True


@wp.kernel(enable_backward=False)
def _receive(scene: SceneArrays, network: _Network, heard: _Reception, first_slot: int, begins: wp.bool):
    """Write what a vehicle knows of another one after a message, or where the episode of either begins."""
    env, v, n = wp.tid()
    i = first_slot + v
    j = n + wp.where(n < i, 0, 1)
    own = network.slots[i].first_row + env * network.slots[i].row_step
    other = network.slots[j].first_row + env * network.slots[j].row_step
    body = own - network.slots[first_slot].first_row
    start = network.position[own]
    end = network.position[other]
    in_sight = _sees(scene, env, start, end)
    past = network.sent_position.shape[0]
    late = wp.min(past - 1, network.sent[other])
    if begins:
        late = wp.where(network.starts[env, i] or network.starts[env, j], 0, -1)
    else:
        heard.age[body, n] = heard.age[body, n] + 1
        stream = episode_stream(heard.random, body, wp.static(int(Purpose.NETWORK)))
        lost = wp.randf(substream(substream(stream, network.sent[own]), j)) < network.dropout
        if lost or (network.needs_sight and not in_sight):
            late = wp.int32(-1)
    if late >= 0:
        k = (network.sent[other] + past - late) % past
        position = network.sent_position[k, other]
        velocity = network.sent_velocity[k, other]
        if wp.isfinite(position) and wp.isfinite(velocity):
            heard.position[body, n] = position
            heard.velocity[body, n] = velocity
            heard.age[body, n] = late
    turn = network.attitude[own]
    offset = wp.quat_rotate_inv(turn, heard.position[body, n] - start)
    heard.range_out[body, n] = wp.length(offset)
    heard.bearing_out[body, n] = wp.normalize(offset)
    heard.velocity_out[body, n] = wp.quat_rotate_inv(turn, heard.velocity[body, n] - network.velocity[own])
    heard.age_out[body, n] = network.dt * float(heard.age[body, n])
    heard.in_sight_out[body, n] = in_sight


class VehicleNetwork:
    """Messages between all vehicles of each environment; all views are made at construction."""

    def __init__(
        self, cfg: NetworkCfg, slots: SlotTable, kinds: Sequence[tuple[GlobalTensorDictionary, Randomness]], scene: Scene,
        *, states: Tensor, starts: Tensor, dt: float,
    ) -> None:  # fmt: skip
        """Declare the keys of all kinds and take views of the tensors, which must stay where they are.

        Args:
            kinds: Tensors and random numbers of the bodies of each kind.
            states: Position, attitude and velocity of all vehicles first, world, (N, 13).
            starts: Vehicles that begin an episode, bool, (E, T); read where ``exchange`` begins.
            dt: Length of an environment step [s].
        """
        device, (num_envs, total) = states.device, starts.shape
        past = latency_steps(cfg.latency_s, dt) + 1
        self._like, self._scene = states, scene
        self._kept = {"sent": torch.zeros(len(states), dtype=torch.int32, device=device)}
        self._kept |= {f"sent_{name}": torch.zeros(past, len(states), 3, device=device) for name in MESSAGE}
        network = make_struct(
            _Network, slots=slots.array(device), starts=starts, position=states[:, :3], attitude=states[:, 3:7],
            velocity=states[:, 7:10], **self._kept, dt=dt, dropout=cfg.dropout,
            needs_sight=cfg.needs_line_of_sight,
        )  # fmt: skip
        heard = [self._declare(number, *kind, total - 1) for number, kind in enumerate(kinds)]
        self._launches = {
            begins: [
                ReusableLaunch(_send, dim=(num_envs, total), inputs=[network, begins], device=device),
                *(ReusableLaunch(
                    _receive, dim=(num_envs, slots.counts[kind], total - 1), device=device,
                    inputs=[scene.arrays, network, each, slots.first_slot(kind), begins],
                ) for kind, each in enumerate(heard)),
            ]
            for begins in (False, True)
        }  # fmt: skip

    def _declare(self, kind: int, bodies: GlobalTensorDictionary, random: Randomness, neighbours: int) -> _Reception:
        """Declare the keys of a kind and return what its kernel writes."""
        size = (random.num_envs, neighbours)
        kept = {name: torch.zeros(*size, 3, device=bodies.device) for name in MESSAGE}
        kept["age"] = torch.zeros(size, dtype=torch.int32, device=bodies.device)
        self._kept |= {f"{kind}.{name}": each for name, each in kept.items()}
        for key, width, dtype, unit, frame, meaning in _KEYS:
            shape = ("E", neighbours) if width == 1 else ("E", neighbours, width)
            spec = TensorSpec(key=key, shape=shape, dtype=dtype, unit=unit, frame=frame, owner="env", meaning=meaning)
            kept[f"{key.removeprefix('neighbour_')}_out"] = bodies.declare(spec)
        return make_struct(_Reception, random=random_arrays(random), **kept)

    def exchange(self, *, begins: bool = False) -> None:
        """Exchange the states at the end of a step, or tell each other those of vehicles that begin an episode."""
        for launch in self._launches[begins]:
            launch.launch(self._like)

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state, by name."""
        return self._kept
