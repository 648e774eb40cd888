"""``aerial-gym train --for-real``: preflight, training, export and robustness of a policy for one real vehicle.

Each stage is kept in ``for_real.json`` of the run folder. The same command continues with the first stage that is missing.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
    record = _load_or_plan(cmd)
    if "training" not in record:
        result = _training_command(cmd, record).result()
        if result.interrupted:
            return record | {"training": asdict(result)}
        record = _store(cmd.out, record | {"training": asdict(result)})
    if "export" not in record:
        from aerial_gym.export import export_policy

        checked = {"preflight": cmd.out / RESULT, "allow_contradicted": True}  # the plan contains the contradictions
        files = export_policy(cmd.out, cmd.out / "export", ("onnx",), **checked)
        record = _store(cmd.out, record | {"export": {str(each.file): each.agrees is not False for each in files}})
    if "robustness" not in record:
        tested = asdict(RobustnessCmd(policy=cmd.out, quick=True, out=cmd.out).result())
        record = _store(cmd.out, record | {"robustness": tested})
    return record


def print_record(cmd: "TrainCmd", record: Mapping[str, Any]) -> int:
    """Print the summary; return the exit status, 1 if the training was interrupted or an exported file differs from it."""
    if cmd.json:
        print(json.dumps(record))
    elif record["training"]["interrupted"]:
        print("interrupted: the same command continues")
    else:
        _print_summary(cmd.out, record)
    return int(not all(record.get("export", {"": False}).values()))


def _load_or_plan(cmd: "TrainCmd") -> dict[str, Any]:
    """Return the record in the run folder, or a new one with the plan of the training."""
    given = {name: None if (value := getattr(cmd, name)) is None else str(value) for name in (*OWN, "task")}
    file = cmd.out / RECORD
    if file.exists():
        record = json.loads(file.read_text(encoding="utf-8"))
        if record["request"] != given:
            raise ConfigError(
                f"{cmd.out}: holds a training with other options ({record['request']}). Choose another --out"
            )
        return record
    if cmd.resume:
        raise ConfigError(f"{cmd.out}: holds no training for a real vehicle. Leave --resume out")
    if cmd.robot is not None:
        raise ConfigError(f"--robot {cmd.robot}: --for-real names the robot. Leave it out")
    if (cmd.log is None) == (cmd.preflight is None):
        raise ConfigError("--for-real: give --log LOG, or --preflight RESULT of aerial-gym preflight --out")
    return _store(cmd.out, {"request": given} | _plan(cmd))


def _plan(cmd: "TrainCmd") -> dict[str, Any]:
    from aerial_gym.config.changes import changes_simulation
    from aerial_gym.for_real.plan import plan_training, robot_for_training
    from aerial_gym.rl_training.policy_task import PolicyTask
    from aerial_gym.rl_training.settings import load_task_settings
    from aerial_gym.sim2real.preflight.result_file import read_result

    assert cmd.for_real is not None
    cfg = load_task_settings(cmd.config, trainer=cmd.trainer, task=cmd.task, device=cmd.device or "auto")
    task = PolicyTask(
        name=cfg.task, robot=robot_for_training(cmd.for_real, cmd.log), controller=cmd.controller or cfg.controller,
        encoder=None, backend=cmd.backend, level=None, settings=tuple(filter(changes_simulation, cmd.set)), device="cpu",
        seed=0,
    )  # fmt: skip
    source = cmd.preflight
    if source is None:
        assert cmd.log is not None
        _, _, env, sim = task.configurations()
        rate = 1.0 / (sim.dt * env.physics_steps_per_env_step)
        cmd.out.mkdir(parents=True, exist_ok=True)
        source = cmd.out / RESULT
        PreflightCmd(robot=str(task.robot), log=cmd.log, rate_hz=rate, mapping=cmd.mapping).result().write(source)
    result = read_result(source)
    plan = plan_training(task, result)
    write_atomic(cmd.out / RESULT, source.read_bytes())
    return {"verdict": result["verdict"]} | asdict(plan)


def _training_command(cmd: "TrainCmd", record: Mapping[str, Any]) -> "TrainCmd":
    """Return the command of the training alone, which continues a run that is there."""
    plain = replace(cmd, **dict.fromkeys(OWN))
    if (cmd.out / "config.yaml").exists():
        kept = {"out": cmd.out, "watch": cmd.watch, "view": cmd.view, "port": cmd.port, "wandb": cmd.wandb}
        limits = {"max_time_s": cmd.max_time_s, "max_env_steps": cmd.max_env_steps, "device": cmd.device}
        return type(cmd)(resume=True, **kept, **limits)
    return replace(plain, robot=record["robot"], set=(*record["settings"], *cmd.set))


def _store(out: Path, record: dict[str, Any]) -> dict[str, Any]:
    out.mkdir(parents=True, exist_ok=True)
    write_atomic(out / RECORD, json.dumps(record, indent=1))
    return record


def _print_summary(out: Path, record: Mapping[str, Any]) -> None:
    def number(value: float | None) -> str:
        return "" if value is None else f"{value:.4g}"

    rows = [(one["name"], one["state"], number(one["low"]), number(one["high"]), one["setting"])
            for one in record["choices"]]  # fmt: skip
    head = ("quantity", "by the log", "lowest", "highest", "setting, or reason for none")
    print_table(rows, head, title=f"training of {record['robot']}: the log is {record['verdict']}")
    for text in record["corrections"]:
        print(f"correct on the vehicle, which no training contains: {text}")
    clean, cells = record["robustness"]["clean"], record["robustness"]["cells"][:WORST]
    print(f"success within these ranges: {clean['success_rate']:.1%} of {clean['flights']} flights")
    print_table([(one["label"], f"{one['success_rate']:.1%}", one["outcome"]) for one in cells],
                ("worst conditions", "success", "result"))  # fmt: skip
    for file in (file for file, agrees in record["export"].items() if not agrees):
        print(f"do not fly {file}: it differs from the policy; export another format")
    print(f"policy: {out}; exported: {', '.join(record['export'])}; all conditions: {out / 'robustness.json'}")
