"""How should the state of a batch lie in memory? The same plant step on three layouts, on one GPU.

    python benchmarks/speed/state_layout.py [--json]

``rows13``: position, attitude and velocity are columns of one (E, 13) tensor; ``separate``: one contiguous tensor each;
``columns``: separate, transposed, so that neighbouring environments lie side by side. The step is rotor lag, thrust, linear
drag and semi-implicit Euler, written for this measurement; K substeps are taken in registers. Launches are replayed from a
CUDA graph of 20 and timed between two synchronisations; median of five.
"""

import argparse
import json
import statistics
import time

import torch
import warp as wp

from aerial_gym.config.sim import STANDARD_GRAVITY

LAUNCHES = 20
REPEATS = 5


@wp.struct
class Plant:
    """A symmetric quadrotor of 0.25 kg."""

    mass: float
    inertia: wp.mat33
    inertia_inverse: wp.mat33
    thrust_coeff: float
    torque_ratio: float
    tau: float
    lever: float
    drag: float
    gravity: float


@wp.kernel(enable_backward=False)
def _step(
    # state
    position: wp.array2d[float],  # (E, 3)
    attitude: wp.array2d[float],  # (E, 4)
    lin_vel: wp.array2d[float],  # (E, 3)
    ang_vel: wp.array2d[float],  # (E, 3)
    rotor: wp.array2d[float],  # (E, 4)
    command: wp.array2d[float],  # (E, 4)
    plant: Plant,
    dt: float,
    substeps: int,
):
    """Advance one environment in place."""
    e = wp.tid()
    x = wp.vec3(position[e, 0], position[e, 1], position[e, 2])
    q = wp.quat(attitude[e, 0], attitude[e, 1], attitude[e, 2], attitude[e, 3])
    v = wp.vec3(lin_vel[e, 0], lin_vel[e, 1], lin_vel[e, 2])
    w = wp.vec3(ang_vel[e, 0], ang_vel[e, 1], ang_vel[e, 2])
    n = wp.vec4(rotor[e, 0], rotor[e, 1], rotor[e, 2], rotor[e, 3])
    c = wp.vec4(command[e, 0], command[e, 1], command[e, 2], command[e, 3])
    decay = wp.exp(-dt / plant.tau)
    for _k in range(substeps):
        n = c + (n - c) * decay
        t = wp.cw_mul(n, n) * plant.thrust_coeff
        roll = plant.lever * (t[2] + t[3] - t[0] - t[1])
        pitch = plant.lever * (t[1] + t[2] - t[0] - t[3])
        yaw = plant.torque_ratio * (t[1] + t[3] - t[0] - t[2])
        force = wp.vec3(0.0, 0.0, t[0] + t[1] + t[2] + t[3]) - plant.drag * wp.quat_rotate_inv(q, v)
        acc = wp.quat_rotate(q, force) / plant.mass
        ang_acc = plant.inertia_inverse * (wp.vec3(roll, pitch, yaw) - wp.cross(w, plant.inertia * w))
        v = v + dt * wp.vec3(acc[0], acc[1], acc[2] - plant.gravity)
        w = w + dt * ang_acc
        x = x + dt * v
        h = 0.5 * dt * w
        q = wp.normalize(q * wp.quat(h[0], h[1], h[2], 1.0))
    for i in range(3):
        position[e, i] = x[i]
        lin_vel[e, i] = v[i]
        ang_vel[e, i] = w[i]
    for i in range(4):
        attitude[e, i] = q[i]
        rotor[e, i] = n[i]


def make_plant() -> Plant:
    """Return the numbers of base_quadrotor with some drag."""
    plant = Plant()
    plant.mass, plant.gravity, plant.drag, plant.tau = 0.25, STANDARD_GRAVITY, 0.05, 0.04
    plant.inertia = wp.mat33(4.225e-4, 0.0, 0.0, 0.0, 4.225e-4, 0.0, 0.0, 0.0, 8.45e-4)
    plant.inertia_inverse = wp.inverse(plant.inertia)
    plant.thrust_coeff, plant.torque_ratio, plant.lever = 3.485449e-7, 0.01, 0.13
    return plant


def make_state(layout: str, num_envs: int, device: str) -> list[torch.Tensor]:
    """Return position, attitude, velocities, rotor speeds and commands near hover, in a layout."""
    widths = (3, 4, 3, 3, 4, 4)
    if layout == "columns":
        tensors = [torch.zeros(width, num_envs, device=device).T for width in widths]
    else:
        tensors = [torch.zeros(num_envs, width, device=device) for width in widths]
    if layout == "rows13":
        rows = torch.zeros(num_envs, 13, device=device)
        tensors[:3] = [rows[:, 0:3], rows[:, 3:7], rows[:, 7:10]]
    tensors[1][:, 3] = 1.0
    tensors[4][:] = 1326.0
    tensors[5][:] = 1326.0 + torch.randn(num_envs, 1, device=device)  # equal rotors: nothing spins up
    return tensors


def measure(layout: str, num_envs: int, substeps: int, device: str) -> float:
    """Return environment substeps per second."""
    tensors = make_state(layout, num_envs, device)
    arrays = [wp.from_torch(tensor, dtype=wp.float32) for tensor in tensors]
    inputs = [*arrays, make_plant(), 0.002, substeps]

    def launch() -> None:
        wp.launch(_step, dim=num_envs, inputs=inputs, device=device, block_dim=128)

    launch()
    with wp.ScopedCapture(device=device) as capture:
        for _ in range(LAUNCHES):
            launch()
    rates, replays = [], max(1, int(3e8 / (num_envs * substeps * LAUNCHES)))
    for _ in range(REPEATS):
        torch.cuda.synchronize()
        start = time.perf_counter()
        for _ in range(replays):
            wp.capture_launch(capture.graph)
        torch.cuda.synchronize()
        rates.append(num_envs * substeps * LAUNCHES * replays / (time.perf_counter() - start))
    if not all(torch.isfinite(tensor).all() for tensor in tensors):
        raise RuntimeError(f"layout {layout}: the state is not finite")
    return statistics.median(rates)


def main() -> None:
    """Print one line per layout, batch and number of substeps."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    as_json = parser.parse_args().json
    if not torch.cuda.is_available():
        raise SystemExit("this measurement needs a CUDA GPU")
    wp.init()
    for num_envs in (4096, 65536, 1048576):
        for substeps in (1, 10):
            for layout in ("rows13", "separate", "columns"):
                rate = measure(layout, num_envs, substeps, "cuda:0")
                row = {"layout": layout, "num_envs": num_envs, "substeps": substeps, "steps_per_s": rate}
                print(json.dumps(row) if as_json else f"{layout:9} E {num_envs:8} K {substeps:3} {rate:.3e} steps/s")


if __name__ == "__main__":
    main()
