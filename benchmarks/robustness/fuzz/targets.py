"""Targets of fuzzing: valid inputs, mutations, and a use of each input as far as a user would go."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from aerial_gym.assets.mesh_files import load_mesh
from aerial_gym.assets.urdf import load_urdf
from aerial_gym.config import dump_yaml, family_files, load
from aerial_gym.config.environment import load_environment
from aerial_gym.config.robot import load_robot
from aerial_gym.config.sensor import load_any_sensor
from aerial_gym.config.task import TaskCfg
from aerial_gym.env_manager import EnvManager, SimBuilder
from aerial_gym.env_manager.catalog import SIMS
from aerial_gym.rl_training import load_policy, load_settings, settings_for
from aerial_gym.rl_training.run.run_folder import RunFolder
from aerial_gym.sim2real.logs.conversion import convert_log
from aerial_gym.sim2real.logs.flights import load_flights
from aerial_gym.sim2real.logs.inspection import inspect_log
from aerial_gym.sim2real.logs.mapping_draft import draft_mapping
from aerial_gym.sim2real.logs.readers.mapping import MAPPING_DIR, find_mapping
from aerial_gym.task import Task
from benchmarks.robustness.fuzz.mutations import BINARY, PLAIN, TEXT, TREE, Mutation
from tests.unit.sim2real import flat_flights, ulog_files
from tests.unit.sim2real.logs.readers import blackbox_files, crazyflie_files, dataflash_files, mavlink_files, ros_bags

NUM_ENVS = 2
BANDWIDTH = 10.0
LOG_S, LOG_BYTES = 1.0, 10**9  # Most time [s] and memory [B] for a damaged log


@dataclass(frozen=True, kw_only=True)
class Target:
    """One kind of input."""

    name: str  # How a finding is named
    suffix: str  # Of the files
    inputs: tuple[bytes, ...]  # Valid ones
    ways: tuple[Mutation, ...]  # To spoil them
    use: Callable[[Path], object]  # What is done with a file
    limit_s: float | None = None  # Longest time of one input [s]
    limit_bytes: int | None = None  # Most memory of one input beside that of the process [B]


def _build_simulation(**changes: object) -> EnvManager:
    names = {"env_name": "empty_env", "robot_name": "base_quadrotor", "controller_name": "lee_position_control"}
    sim = replace(SIMS.get("base_sim"), backend="torch")  # composes no kernel for every robot
    return SimBuilder().build_env(sim_name=sim, **(names | changes), num_envs=NUM_ENVS, device="cpu")


def _fly_one_step(**changes: object) -> None:
    env = _build_simulation(**changes)
    env.reset()
    env.step(torch.zeros(NUM_ENVS, 4))
    env.render()
    env.close()


def _fly_task(path: Path) -> None:
    cfg = load(TaskCfg, path)
    names = {"env_name": cfg.env, "robot_name": cfg.robot, "controller_name": cfg.controller}
    with Task(cfg, _build_simulation(**names)) as task:
        task.reset()
        assert task.action_space.shape is not None
        task.step(torch.zeros(NUM_ENVS, task.action_space.shape[0]))


def _load_log(path: Path, mapping: Path | None = None) -> None:
    layout = None if mapping is None else find_mapping(mapping)
    load_flights([path], flat_flights.ROBOT, mapping=layout, bandwidth=BANDWIDTH)


def _log_targets(folder: Path) -> tuple[Target, ...]:
    """Return one target for each format of logs; ``folder`` receives files that their writers need."""
    ulog = folder / "valid.ulg"
    parts = ulog_files.topics(flat_flights.flight(0, seconds=3.0, rate=100.0))
    parts["vehicle_attitude[1]"] = parts["vehicle_attitude"]
    ulog_files.write_ulog(ulog, parts, {"MAV_TYPE": 2.0, "PWM_MAIN_FUNC1": 101.0})
    bags = [folder / f"valid_{kind}.bag" for kind in (None, "BZ2", "LZ4")]
    for path, kind in zip(bags, (None, "BZ2", "LZ4"), strict=True):
        ros_bags.write_bag(path, kind, count=300)
    storages = {
        (name, packed): folder / f"valid_{name}_{packed}"
        for name in ("SQLITE3", "MCAP")
        for packed in (None, "MESSAGE")
    }
    for (name, packed), path in storages.items():
        ros_bags.write_folder(path, name, count=300, packed=packed)
    rows = blackbox_files.random_rows(0, 600)
    rows[:, 1] = 5_000_000 + 10_000 * np.arange(600)
    databases, mcaps = (
        tuple(next(path.glob(f"*.{suffix}")).read_bytes() for (name, _), path in storages.items() if name == kind)
        for kind, suffix in (("SQLITE3", "db3"), ("MCAP", "mcap"))
    )
    inputs = {
        "blackbox": (blackbox_files.flight(rows[:300]) + blackbox_files.flight(rows[300:]),),
        "dataflash": (dataflash_files.log()[0], dataflash_files.log(message=dataflash_files.line)[0]),
        "crazyflie": (crazyflie_files.card(count=1200)[0],),
        "mavlink": (mavlink_files.log()[0], mavlink_files.log(version=1)[0]),
        "ulog": (ulog.read_bytes(),),
        "bag": tuple(path.read_bytes() for path in bags),
        "database": databases,
        "mcap": mcaps,
    }
    inputs["export"] = (convert_log(ulog, "mcap", folder)[0].read_bytes(),)
    foreign = folder / "foreign.csv"
    flat_flights.flight(0, seconds=3.0, rate=100.0).rename(columns={"t": "stamp"}).to_csv(foreign, index=False)

    def use_part(part: Path, path: Path) -> object:
        part.write_bytes(path.read_bytes())
        return inspect_log(part.parent)

    uses: dict[str, tuple[Path, Callable[[Path], object]]] = {
        "draft": (foreign, lambda path: inspect_log(path, draft_mapping(path).mapping))
    }
    for name, place in (("metadata", -1), ("parquet", 0)):
        part = convert_log(ulog, "parquet", folder / name)[place]
        uses[name] = part, partial(use_part, part)
    uses_of_inputs = [(name, data, inspect_log) for name, data in inputs.items()]
    uses_of_inputs += [(name, (file.read_bytes(),), use) for name, (file, use) in uses.items()]
    return tuple(
        Target(
            name=f"log_{name}",
            suffix=f".{name}",
            inputs=data,
            ways=BINARY,
            use=use,
            limit_s=LOG_S,
            limit_bytes=LOG_BYTES,
        )
        for name, data, use in uses_of_inputs
    )


def _checkpoint_bytes(folder: Path) -> bytes:
    """Return a small checkpoint; the folder then holds the settings that it belongs to."""
    cfg = load_settings(settings_for("rl_games", "position_setpoint_task"))
    run = RunFolder(folder)
    if not run.config_file.exists():
        run.create(replace(cfg, ppo=replace(cfg.ppo, hidden_layers=(8,))))
    model = {"a2c_network.actor_mlp.0.weight": torch.zeros(8, 13), "a2c_network.actor_mlp.0.bias": torch.zeros(8)}
    model |= {"a2c_network.mu.weight": torch.zeros(4, 8), "a2c_network.mu.bias": torch.zeros(4)}
    return run.write_checkpoint(1, {"model": model, "run": {"trainer": "rl_games", "env_steps": 1}}).read_bytes()


URDF = b"""<robot name="lamp"><material name="red"><color rgba="1 0 0 1"/></material>
<link name="base"><visual><origin xyz="0 0 1" rpy="0 0 0"/><geometry><box size="1 2 3"/></geometry>
<material name="red"/></visual></link>
<link name="arm"><collision><geometry><cylinder radius="0.1" length="1"/></geometry></collision></link>
<link name="bulb"><visual><geometry><mesh filename="package://x/bulb.obj" scale="1 1 1"/></geometry></visual></link>
<joint name="a" type="revolute"><origin xyz="0 0 1"/><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="b" type="fixed"><origin xyz="0 0 1"/><parent link="arm"/><child link="bulb"/></joint></robot>
"""
OBJ = b"# tetrahedron\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nvt 0 0\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
STL = b"solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid s\n"


def targets(folder: Path) -> tuple[Target, ...]:
    """Return all targets; ``folder`` receives the files that their inputs need."""
    (folder / "bulb.obj").write_bytes(OBJ)
    valid_log = folder / "valid_log.csv"
    flat_flights.flight(0, seconds=3.0, rate=100.0).to_csv(valid_log, index=False)

    def files(kind: str) -> tuple[bytes, ...]:
        return tuple(path.read_bytes() for path in family_files(kind).values())

    own = (MAPPING_DIR / "aerial_gym.yaml").read_bytes()
    paired = own + b"companion: {log: other}\nwind: {log: [1.0, 0.0, 0.0]}\nlift_off_m: 0.1\nhover_above_m: 0.5\n"
    rest = tuple(path.read_bytes() for path in sorted(MAPPING_DIR.glob("*.yaml")))
    mappings = (*(own, paired) * 4, *rest)
    robots = (*files("robots"), dump_yaml(flat_flights.ROBOT).encode())

    def yaml(name: str, inputs: tuple[bytes, ...], use: Callable[[Path], object]) -> Target:
        return Target(name=name, suffix=".yaml", inputs=inputs, ways=TREE, use=use)

    return (
        yaml("robot", robots, lambda path: _fly_one_step(robot_name=load_robot(path))),
        yaml("environment", files("environments"), lambda path: _fly_one_step(env_name=load_environment(path))),
        yaml("task", files("tasks"), _fly_task),
        yaml("settings", files("training"), load_settings),
        yaml("sensor", files("sensors"), load_any_sensor),
        yaml("mapping", mappings, lambda path: _load_log(valid_log, path)),
        Target(name="log", suffix=".csv", inputs=(valid_log.read_bytes(),), ways=TEXT, use=_load_log),
        *_log_targets(folder),
        Target(name="urdf", suffix=".urdf", inputs=(URDF,), ways=TEXT, use=load_urdf),
        Target(name="obj", suffix=".obj", inputs=(OBJ,), ways=TEXT, use=lambda path: load_mesh(path, scale=1.0)),
        Target(name="stl", suffix=".stl", inputs=(STL,), ways=TEXT, use=lambda path: load_mesh(path, scale=1.0)),
        Target(name="checkpoint", suffix=".pth", inputs=(_checkpoint_bytes(folder),), ways=PLAIN, use=load_policy),
    )
