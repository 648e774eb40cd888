"""Speed of vehicles with joints against MuJoCo and MuJoCo Warp: ``python -m benchmarks.joints.bending --help``.

All take steps of 2 ms with joints that resist by a spring and a damper, implicitly, and a force on every link that carries a
rotor. Ours also run the rotors, their lag and the law of the joints (for Morphy a quadratic one, where MuJoCo has a linear
spring). Prints a JSON object a line.
"""

import json
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import torch
import tyro

from aerial_gym.interop import resolve_device
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.articulated.tree import Links
from aerial_gym.physics.mujoco.mjcf import write_mjcf
from aerial_gym.physics.vehicle import vehicle_from_config
from aerial_gym.robots import ROBOTS
from aerial_gym.workloads.flight import make_flight

DT = 0.002
LEAST = 1e-5  # Of mass [kg] and principal moments [kg m²] of links that have none here: MuJoCo takes no such links
LINEAR, DAMPING = 0.3, 0.018  # Of every joint there [N m/rad], [N m s/rad]: Morphy's in hover


@dataclass(frozen=True, kw_only=True)
class Bending:
    """Measure the speed of vehicles with joints."""

    robots: tuple[str, ...] = ("morphy",)  # Registered robots with joints
    device: str = "cpu"  # Torch device
    num_envs: tuple[int, ...] = (1024,)  # Environments side by side
    substeps: tuple[int, ...] = (1, 10)  # Of ours in one launch
    engines: tuple[str, ...] = ("ours", "mujoco_warp", "mujoco")  # MuJoCo: CPU, one environment, one thread
    seconds: float = 1.0  # About how long each of five repeats lasts

    def run(self) -> None:
        """Measure and print."""
        for robot, engine in product(self.robots, self.engines):
            counts = (1,) if engine == "mujoco" else self.num_envs
            for num_envs, substeps in product(counts, self.substeps if engine == "ours" else (1,)):
                self._measure_engine(robot, engine, num_envs, substeps)

    def _measure_engine(self, robot: str, engine: str, num_envs: int, substeps: int) -> None:
        device = resolve_device(self.device)
        where, steps, run = _MAKERS[engine](robot, num_envs, substeps, device)
        result = {"engine": engine, "robot": robot, "device": where, "num_envs": num_envs, "substeps": substeps}
        figures = _step_rates(run, steps * num_envs, self.seconds, cuda=device.type == "cuda" and engine != "mujoco")
        print(json.dumps(result | figures), flush=True)


def _step_rates(run: Callable[[], object], steps: int, seconds: float, *, cuda: bool) -> dict[str, float]:
    def measure(times: int) -> float:
        start = time.perf_counter()
        for _ in range(times):
            run()
        if cuda:
            torch.cuda.synchronize()
        return time.perf_counter() - start

    measure(2)
    times = max(1, round(seconds / max(measure(3) / 3, 1e-6)))
    rates = [times * steps / measure(times) for _ in range(5)]
    return {"steps_per_s": statistics.median(rates), "steps_per_s_min": min(rates), "steps_per_s_max": max(rates)}


EngineRun = tuple[str, int, Callable[[], object]]  # Hardware, steps of a call, and the call


def _package_case(robot: str, num_envs: int, substeps: int, device: torch.device) -> EngineRun:
    names = {
        "backend": "warp", "robot": robot, "controller": "rotor_speed_control", "effects": (), "integrator": "euler",
    }  # fmt: skip
    flight = make_flight(**names, num_envs=num_envs, substeps=substeps, dt=DT, device=device)
    return _device_name(device), substeps * flight.launches_per_batch, flight.run_batch


def _device_name(device: torch.device) -> str:
    return torch.cuda.get_device_name(device) if device.type == "cuda" else f"cpu, {torch.get_num_threads()} threads"


def _mujoco_model(robot: str):
    import mujoco

    cfg = ROBOTS.get(robot)
    vehicle = vehicle_from_config(cfg, num_envs=1, dtype=torch.float64)
    articulation = build_articulation(cfg, like=vehicle.mass)
    assert articulation is not None
    links = articulation.links(vehicle)
    least = LEAST * torch.eye(3, dtype=torch.float64) * (links.inertia.sum((-1, -2)) == 0.0)[..., None, None]
    heavy = Links(mass=links.mass.clamp_min(LEAST), com=links.com, inertia=links.inertia + least)
    text = write_mjcf(articulation.tree, heavy, gravity=9.81, dt=DT, integrator="implicitfast")
    model = mujoco.MjModel.from_xml_string(text)
    model.jnt_stiffness[1:] = LINEAR
    model.dof_damping[6:] = DAMPING
    return mujoco, model, articulation.rotor_links, cfg.body.mass * 9.81 / cfg.num_rotors


def _mujoco_case(robot: str, num_envs: int, substeps: int, device: torch.device) -> EngineRun:
    del num_envs, substeps, device
    mujoco, model, rotor_links, thrust = _mujoco_model(robot)
    data = mujoco.MjData(model)
    for link in rotor_links:
        data.xfrc_applied[1 + link, 2] = thrust
    return "cpu, 1 thread", 1000, lambda: mujoco.mj_step(model, data, 1000)


def _mujoco_warp_case(robot: str, num_envs: int, substeps: int, device: torch.device) -> EngineRun:
    import mujoco_warp
    import warp as wp

    del substeps
    _, model, rotor_links, thrust = _mujoco_model(robot)
    wp.init()
    where = wp.get_device("cuda:0" if device.type == "cuda" else "cpu")
    with wp.ScopedDevice(where):
        compiled = mujoco_warp.put_model(model)
        data = mujoco_warp.make_data(model, nworld=num_envs, nconmax=1, njmax=1)
        pushes = wp.to_torch(data.xfrc_applied)
        for link in rotor_links:
            pushes[:, 1 + link, 2] = thrust
        mujoco_warp.step(compiled, data)
        steps = 20 if device.type == "cuda" else 1
        if device.type == "cuda":
            with wp.ScopedCapture() as capture:
                for _ in range(steps):
                    mujoco_warp.step(compiled, data)

    def run() -> None:
        with wp.ScopedDevice(where):
            if device.type == "cuda":
                wp.capture_launch(capture.graph)
            else:
                mujoco_warp.step(compiled, data)

    return _device_name(device), steps, run


_MAKERS = {"ours": _package_case, "mujoco": _mujoco_case, "mujoco_warp": _mujoco_warp_case}

if __name__ == "__main__":
    tyro.cli(Bending).run()
