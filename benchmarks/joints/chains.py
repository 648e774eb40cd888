"""Chains and stars of joints: articulated-body recursion beside a factor of the mass matrix, in our own kernel.

The recursion of the library (``physics.articulated.fused.recursion``) eliminates link by link; ``solvers.factor`` works out the
mass matrix by composite inertias and factors it. Timed are the solve alone, again and again in two kernels that differ in
nothing else (``solvers.again``), and the whole step of the fused backend. On a CPU MuJoCo stands beside the step, which factors
the mass matrix too: C, float64, an engine of its own. Chains are rods on a free base with damped hinges that turn about y and
z in turn; steps take 2 ms and are implicit in the damping.

    python -m benchmarks.joints.chains    # on one thread of a CPU, in processor time
    python -m benchmarks.joints.chains --device cuda --num-envs 65536 --launches 10 --json
    python -m benchmarks.joints.chains --registers --robots morphy snakey    # sizes of kernels
"""

import math
import os
import statistics
import sys
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any
from unittest.mock import patch

import torch
import tyro
import warp as wp

from aerial_gym.config.joint import BASE, JointCfg, JointsCfg, LinkCfg, SpringCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.errors import AerialGymError, ConfigError
from aerial_gym.interop import compile_ahead, on_torch_stream, resolve_device, start_warp, wait_for
from aerial_gym.math.random import Randomness
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.articulated.articulation import articulation_of
from aerial_gym.physics.articulated.fused import kernel as fused_kernel
from aerial_gym.physics.mujoco.mjcf import write_mjcf
from aerial_gym.physics.state import JointedState, state_at_rest
from aerial_gym.physics.warp_backend import BLOCK_DIM, WarpBackend
from aerial_gym.robots import ROBOTS
from aerial_gym.workloads.output import device_name, print_figures, provenance
from benchmarks.joints.kernel_size import compiled_size, loaded_size
from benchmarks.joints.solvers.again import MAKERS, bends_of, model_of, random_motion, solve_kernel, solve_launch

DT = 0.002
LENGTH, MASS, DAMPING = 0.2, 0.1, 0.01
"""Of a rod [m] and [kg], and of each hinge [N m s/rad]."""


@dataclass(frozen=True)
class Contender:
    """A way to solve in one kernel."""

    robot: str
    what: str
    """``solve`` or ``step``."""

    way: str
    """Of ``MAKERS``, or ``mujoco``."""

    kernel: wp.Kernel | None
    run: Callable[[], object]
    """Makes one launch, of as many solves or steps as asked for."""

    found: torch.Tensor | None
    """Joint accelerations or rates, which it writes, (E, D)."""

    @property
    def name(self) -> str:
        """What it is called in progress."""
        return f"{self.robot}, {self.what}, {self.way}"


@dataclass(frozen=True, kw_only=True)
class Chains:
    """Measure both ways to solve; a row of a table, or a JSON object, for each vehicle and what is timed."""

    joints: tuple[int, ...] = (2, 4, 6, 8, 10, 12)
    """Lengths of chains."""

    robots: tuple[str, ...] = ("morphy",)
    """Registered robots with joints beside them."""

    device: str = "cpu"
    """Torch device; a CPU is used in one thread, and its processor time is taken."""

    num_envs: int = 64
    """Environments side by side."""

    substeps: int = 50
    """Solves or steps in a launch."""

    launches: int = 1
    """In each repeat."""

    repeats: int = 21
    """In which both take turns."""

    mujoco: bool = True
    """Beside the step of chains on a CPU, if MuJoCo is there."""

    registers: bool = False
    """Print the size of each kernel and time nothing; without a GPU it is compiled for ``arch``."""

    arch: int = 90
    """Architecture that sizes are of where there is no GPU; 90 is that of H100 and H200."""

    json: bool = False
    """One JSON object a line in place of a table."""

    def run(self) -> None:
        """Measure and print."""
        start_warp()
        torch.set_num_threads(1)
        device = resolve_device(self.device)
        if rigid := [name for name in self.robots if ROBOTS.get(name).joints is None]:
            raise ConfigError(f"--robots {' '.join(rigid)}: no joints. Take morphy, snakey or another robot that bends")
        vehicles = {f"chain of {n}": chain(n) for n in self.joints} | {name: ROBOTS.get(name) for name in self.robots}
        each = [
            [make(name, robot, way, self, device) for way in MAKERS]
            for name, robot in vehicles.items()
            for make in (solving, stepping)
        ]
        if self.registers:
            for contender in [one for pair in each for one in pair]:
                self._print({"kernel": contender.name} | _size(contender, device, self.arch))
            return
        compile_all([one for pair in each for one in pair], device)
        if not self.json:
            print("| vehicle | timed | recursion [1/s] | factor [1/s] | factor / recursion | MuJoCo [1/s] |")
            print("| --- | --- | --- | --- | --- | --- |")
        for pair in each:
            beside = []
            if self.mujoco and device.type == "cpu" and pair[0].what == "step" and pair[0].robot not in self.robots:
                beside.append(mujoco(pair[0].robot, vehicles[pair[0].robot], self.num_envs * self.substeps))
            self._report([*pair, *beside], device)

    def _report(self, contenders: list[Contender], device: torch.device) -> None:
        rates = measure(contenders, self.launches, self.repeats, self.num_envs * self.substeps, device)
        ratios = [b / a for a, b in zip(rates["recursion"], rates["factor"], strict=True)]
        first, middle, third = statistics.quantiles(ratios, n=4) if len(ratios) > 1 else ratios * 3
        medians = {way: statistics.median(found) for way, found in rates.items()}
        robot, what = contenders[0].robot, contenders[0].what
        if self.json:
            size = {}
            if device.type == "cuda":
                size = {one.way: _size(one, device, self.arch) for one in contenders}
            self._print(
                {"robot": robot, "what": what, "per_s": medians, "ratio": middle, "ratio_quartiles": [first, third]}
                | {"size": size, "num_envs": self.num_envs, "substeps": self.substeps, "repeats": self.repeats}
                | {"device": device_name(device)} | provenance("mujoco")
            )  # fmt: skip
            return
        cells = [f"{medians[way]:.3g}" for way in MAKERS]
        print(
            f"| {robot} | {what} | {cells[0]} | {cells[1]} | {middle:.2f} ({first:.2f} to {third:.2f}) | "
            f"{medians.get('mujoco', math.nan):.3g} |".replace("nan", ""),
            flush=True,
        )

    def _print(self, figures: Mapping[str, object]) -> None:
        print_figures(figures, as_json=self.json)
        sys.stdout.flush()


def chain(num_joints: int) -> RobotCfg:
    """Return a body of 1 kg with rods in a row along x."""
    across = MASS * LENGTH**2 / 12.0
    inertia = ((1e-4, 0.0, 0.0), (0.0, across, 0.0), (0.0, 0.0, across))
    layout = tuple(
        JointCfg(
            name=f"rod_{k}",
            parent=BASE if k == 0 else f"rod_{k - 1}",
            axis=(0.0, 1.0, 0.0) if k % 2 == 0 else (0.0, 0.0, 1.0),
            position=(LENGTH * k, 0.0, 0.0),
            link=LinkCfg(mass=MASS, com=(LENGTH * (k + 0.5), 0.0, 0.0), inertia=inertia),
            spring=SpringCfg(damping=DAMPING),
        )
        for k in range(num_joints)
    )
    mass = 1.0 + num_joints * MASS
    places = [LENGTH * (k + 0.5) for k in range(num_joints)]
    com = MASS * sum(places) / mass
    wide = 0.01 + com**2 + sum(across + MASS * (x - com) ** 2 for x in places)
    plain = ROBOTS.get("base_quadrotor")
    whole = ((0.01 + num_joints * 1e-4, 0.0, 0.0), (0.0, wide, 0.0), (0.0, 0.0, wide))
    body = replace(plain.body, mass=mass, com=(com, 0.0, 0.0), inertia=whole)
    return replace(plain, body=body, joints=JointsCfg(layout=layout, source="made up"))


def solving(name: str, robot: RobotCfg, way: str, asked: Chains, device: torch.device) -> Contender:
    """Return what solves for accelerations alone."""
    model = model_of(robot, asked.num_envs, device)
    kernel, motion = solve_kernel(model, way), random_motion(model)
    recorded = None

    def run() -> None:
        nonlocal recorded
        with on_torch_stream(motion.joint_pos):
            if recorded is None:
                recorded = solve_launch(model, kernel, motion, dt=DT, repeats=asked.substeps)
            recorded.launch()

    return Contender(name, "solve", way, kernel, run, motion.joint_acc)


def stepping(name: str, robot: RobotCfg, way: str, asked: Chains, device: torch.device) -> Contender:
    """Return what makes whole steps of the fused backend."""
    model, num_envs = model_of(robot, asked.num_envs, device), asked.num_envs
    law, backend = make_controller(CONTROLLERS.get("no_control"), model.vehicle, model.gravity, dt=DT), WarpBackend()
    with (
        patch.object(fused_kernel, "make_recursion", MAKERS[way]),
        patch("aerial_gym.physics.warp_backend.compile_ahead"),
    ):
        backend.allocate(model, law, integrator="euler", random=Randomness(num_envs, device=device))
    still = state_at_rest(num_envs, model.vehicle.num_rotors, device=device, dtype=torch.float32)
    rest = bends_of(model).reference.repeat(num_envs, 1)
    state = JointedState(**vars(still), joint_pos=rest + 0.1, joint_vel=torch.zeros_like(rest))
    action = torch.zeros(num_envs, model.vehicle.num_rotors + bends_of(model).num_driven, device=device)

    def run() -> None:
        backend.step(state, action, DT, asked.substeps)

    return Contender(name, "step", way, backend.kernel, run, state.joint_vel)


def mujoco(name: str, robot: RobotCfg, steps: int) -> Contender:
    """Return what advances one environment of MuJoCo by as many steps as all of ours together."""
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
    bends = articulation_of(robot, like=vehicle.mass)
    assert bends is not None
    engine: Any = import_module("mujoco")
    text = write_mjcf(bends.tree, bends.links(vehicle), gravity=9.81, dt=DT, integrator="implicitfast")
    model = engine.MjModel.from_xml_string(text)
    model.dof_damping[6:] = DAMPING
    data = engine.MjData(model)
    data.qpos[7:] = 0.1
    return Contender(name, "step", "mujoco", None, lambda: engine.mj_step(model, data, steps), None)


def compile_all(contenders: list[Contender], device: torch.device) -> None:
    """Compile the kernels of all, on a GPU side by side, and tell on stderr what is done and how long it took."""
    where, begun = wp.device_from_torch(device), time.perf_counter()

    def load(kernel: wp.Kernel) -> float:
        start = time.perf_counter()
        if where.is_cpu:
            compile_ahead(kernel, where)
            wait_for(kernel, where)
        else:
            kernel.module.load(where, block_dim=BLOCK_DIM)
        return time.perf_counter() - start

    with ThreadPoolExecutor(1 if where.is_cpu else len(os.sched_getaffinity(0))) as pool:
        waiting = {pool.submit(load, one.kernel): one for one in contenders if one.kernel is not None}
        for count, future in enumerate(as_completed(waiting), 1):
            took, so_far = future.result(), time.perf_counter() - begun
            what = f"{count} of {len(waiting)} kernels, {so_far:.0f} s: {waiting[future].name} took {took:.1f} s"
            print(what, file=sys.stderr, flush=True)


def measure(
    contenders: list[Contender], launches: int, repeats: int, steps: int, device: torch.device
) -> dict[str, list[float]]:
    """Return steps per second of each way in each repeat, in which they take turns.

    Args:
        contenders: What is timed.
        launches: Of each, in a repeat.
        repeats: After one that is not counted.
        steps: In a launch.
        device: Of a CPU processor time is taken.

    Raises:
        ArithmeticError: If one has found what is no number.
    """
    clock, rates = (
        time.perf_counter if device.type == "cuda" else time.process_time,
        {one.way: [] for one in contenders},
    )
    for repeat in range(repeats + 1):
        for one in contenders:
            if device.type == "cuda":
                torch.cuda.synchronize()
            start = clock()
            for _ in range(launches):
                one.run()
            if device.type == "cuda":
                torch.cuda.synchronize()
            if repeat:
                rates[one.way].append(launches * steps / (clock() - start))
    for one in contenders:
        if one.found is not None and not bool(one.found.isfinite().all()):
            raise ArithmeticError(f"{one.name}: motion is not finite any more")
    return rates


def _size(contender: Contender, device: torch.device, arch: int) -> dict[str, Any]:
    """Return the size of a kernel on the GPU, or on ``arch`` where the device is a CPU."""
    kernel = contender.kernel
    assert kernel is not None
    if device.type == "cuda":
        return vars(loaded_size(kernel, wp.device_from_torch(device), block_dim=BLOCK_DIM))
    return vars(compiled_size(kernel, arch=arch)) | {"arch": f"sm_{arch}"}


if __name__ == "__main__":
    try:
        tyro.cli(Chains).run()
    except AerialGymError as error:
        print(f"chains: {error}", file=sys.stderr)
        sys.exit(2)
