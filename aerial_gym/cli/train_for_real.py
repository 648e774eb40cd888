"""``aerial-gym train --for-real``: preflight, training, export and robustness of a policy for one real vehicle.

Each stage is kept in ``for_real.json`` of the run folder. The same command continues with the first one that is missing.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from aerial_gym.cli.export import ExportCmd
from aerial_gym.cli.preflight import PreflightCmd
from aerial_gym.cli.robustness import RobustnessCmd
from aerial_gym.cli.terminal import print_table
from aerial_gym.config.storage import write_atomic
from aerial_gym.errors import ConfigError

if TYPE_CHECKING:
    from aerial_gym.cli.train import TrainCmd

RECORD, RESULT = "for_real.json", "preflight.json"  # Files of the run folder
OWN = ("for_real", "log", "preflight", "mapping")  # Options of this command alone
WORST = 5  # Cells of the robustness test in the summary


def train_for_real(cmd: "TrainCmd") -> dict[str, Any]:
    """Train, export and test; return the record of all stages, or up to the training if that was interrupted."""
    request = {name: None if (value := getattr(cmd, name)) is None else str(value) for name in (*OWN, "task")}
    file = cmd.out / RECORD
    record: dict[str, Any] = {"request": request}
    if file.exists():
        record = json.loads(file.read_text(encoding="utf-8"))
    if record["request"] != request:
        raise ConfigError(f"{cmd.out}: holds a training with other options, {record['request']}. Choose another --out")
    for name, stage in (("plan", _plan), ("training", _train), ("export", _export), ("robustness", _test)):
        if name not in record:
            record[name] = stage(cmd, record)
            if name == "training" and record[name]["interrupted"]:
                break
            cmd.out.mkdir(parents=True, exist_ok=True)
            write_atomic(file, json.dumps(record, indent=1))
    return record


def _plan(cmd: "TrainCmd", _: Mapping[str, Any]) -> dict[str, Any]:
    from aerial_gym.config.changes import changes_simulation
    from aerial_gym.for_real.plan import plan_training, robot_for_training
    from aerial_gym.rl_training.policy_task import PolicyTask
    from aerial_gym.rl_training.settings import load_task_settings
    from aerial_gym.sim2real.preflight.result_file import read_result

    if cmd.robot is not None or cmd.resume:
        raise ConfigError("--for-real: names the robot, and continues by itself. Leave --robot and --resume out")
    if cmd.for_real is None or (cmd.log is None) == (cmd.preflight is None):
        raise ConfigError("--for-real: give --log LOG, or --preflight RESULT of aerial-gym preflight --out")
    cfg = load_task_settings(cmd.config, trainer=cmd.trainer, task=cmd.task, device=cmd.device or "auto")
    task = PolicyTask(
        name=cfg.task, robot=robot_for_training(cmd.for_real, cmd.log), controller=cmd.controller or cfg.controller,
        encoder=None, backend=cmd.backend, level=None, settings=tuple(filter(changes_simulation, cmd.set)), device="cpu",
        seed=0,
    )  # fmt: skip
    if cmd.preflight is not None:
        read_result(cmd.preflight)  # before anything is written
    cmd.out.mkdir(parents=True, exist_ok=True)
    if cmd.log is not None:
        env, sim = task.configurations()[2:]
        rate = 1.0 / (sim.dt * env.physics_steps_per_env_step)
        check = PreflightCmd(robot=str(task.robot), log=cmd.log, rate_hz=rate, mapping=cmd.mapping)
        check.result().write(cmd.out / RESULT)
    elif cmd.preflight is not None:
        write_atomic(cmd.out / RESULT, cmd.preflight.read_bytes())
    result = read_result(cmd.out / RESULT)
    return {"verdict": result["verdict"]} | asdict(plan_training(task, result))


def _train(cmd: "TrainCmd", record: Mapping[str, Any]) -> dict[str, Any]:
    plain = replace(cmd, **dict.fromkeys(OWN))
    if (cmd.out / "config.yaml").exists():
        names = ("out", "watch", "view", "port", "wandb", "max_time_s", "max_env_steps", "device")
        return asdict(type(cmd)(resume=True, **{name: getattr(cmd, name) for name in names}).result())
    plan = record["plan"]
    return asdict(replace(plain, robot=plan["robot"], set=(*plan["settings"], *cmd.set)).result())


def _export(cmd: "TrainCmd", _: Mapping[str, Any]) -> dict[str, bool]:
    """Return the exported files, and whether each agrees with the policy; the plan contains the contradictions."""
    files = ExportCmd(policy=cmd.out, preflight=cmd.out / RESULT, allow_contradicted=True).result()
    return {str(each.file): each.agrees is not False for each in files}


def _test(cmd: "TrainCmd", _: Mapping[str, Any]) -> dict[str, Any]:
    return asdict(RobustnessCmd(policy=cmd.out, quick=True, out=cmd.out).result())


def print_record(cmd: "TrainCmd", record: Mapping[str, Any]) -> int:
    """Print the summary; return the exit status, 1 if the training was interrupted or an exported file differs from it."""
    if cmd.json:
        print(json.dumps(record))
    elif record["training"]["interrupted"]:
        print("interrupted: the same command continues")
    else:
        _print_summary(cmd, record)
    return int(not all(record.get("export", {"": False}).values()))


def _print_summary(cmd: "TrainCmd", record: Mapping[str, Any]) -> None:
    plan, tested = record["plan"], record["robustness"]
    rows = [(one["name"], one["state"], *("" if one[end] is None else f"{one[end]:.4g}" for end in ("low", "high")),
             one["setting"]) for one in plan["choices"]]  # fmt: skip
    head = ("quantity", "by the log", "lowest", "highest", "setting, or reason for none")
    print_table(rows, head, title=f"training for {plan['robot']}: the log is {plan['verdict']}")
    for text in plan["corrections"]:
        print(f"correct on the vehicle, which no training contains: {text}")
    print(f"success in these ranges: {tested['clean']['success_rate']:.1%} of {tested['clean']['flights']} flights")
    worst = ((one["label"], f"{one['success_rate']:.1%}", one["outcome"]) for one in tested["cells"][:WORST])
    print_table(worst, ("worst conditions", "success", "result"))
    for file in (file for file, agrees in record["export"].items() if not agrees):
        print(f"do not fly {file}: it differs from the policy; export another format")
    print(f"policy: {cmd.out}; exported: {', '.join(record['export'])}; all conditions: {cmd.out / 'robustness.json'}")
