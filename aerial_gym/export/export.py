"""Writing a policy as ONNX, TorchScript, C99 or for an engine on board, and comparing the written files with it.

Letters: O entries of an observation, M numbers of memory.
"""

from collections.abc import Callable, Iterable
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from aerial_gym.config.changes import settings_of_run
from aerial_gym.config.storage import storage_errors, write_atomic
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.export import c99, c99_images
from aerial_gym.export.agreement import Agreement, Comparison, inputs_not_finite
from aerial_gym.export.encoder import compare_encoder, write_encoder
from aerial_gym.export.layout import Layout, ObservationImage, policy_layout
from aerial_gym.export.module import DeployablePolicy, onnx_bytes, torchscript_bytes
from aerial_gym.export.pilot import load_exported
from aerial_gym.export.targets import crazyflie, raptor, tflm
from aerial_gym.interop import usual_settings
from aerial_gym.rl_training.policies.load import check_fits, load_policy
from aerial_gym.rl_training.policies.policy import Policy
from aerial_gym.sensors.encoder.file import load_encoder
from aerial_gym.sim2real.preflight.result_file import read_result
from aerial_gym.task import task_registry
from aerial_gym.task.images import TYPES
from aerial_gym.task.terms.observations import LATENTS

CHECKED, STEPS = 100_000, 10  # Observations of the comparison, in sequences of so many steps, which use a memory
CHECKED_WITH_IMAGES = 10_000  # With how many where it sees images, each of which costs as much as hundreds of vectors
SPREAD = 2.0  # Spread of random observations around the normaliser's mean, in its standard deviations


@dataclass(frozen=True, kw_only=True)
class Exported:
    """One file."""

    to: str  # Format

    file: Path
    largest_difference: float | None  # Largest difference from torch, in the output's unit; None: `not_checked`
    agreement: Agreement | None = None  # The output nearest to its limit, or furthest beyond it; None: `not_checked`
    not_checked: str | None = None  # Why it could not be run here

    @property
    def agrees(self) -> bool | None:
        """Whether the file agrees with the policy (``aerial_gym.export.agreement``); None: ``not_checked``."""
        return None if self.agreement is None else self.agreement.holds


@usual_settings
def export_policy(
    source: str | Path, out: str | Path, to: Iterable[str], *, robot: str | None = None, name: str | None = None,
    check: bool = True, preflight: Path | None = None, allow_contradicted: bool = False,
) -> list[Exported]:  # fmt: skip
    """Write the policy of a run folder or checkpoint in some formats, with ``policy.json`` beside it.

    Args:
        source: Run folder, or one checkpoint in it.
        out: Folder; made if it is not there.
        to: Names of ``FORMATS``.
        robot: Registered robot, or a robot file, that it is to fly in place of that of its training: its limits and the
            range and places of its rotors are written.
        name: Of files and C functions; that of the task if not given.
        check: Run the files on ``CHECKED`` random observations and compare them with torch.
        preflight: Result of ``aerial-gym preflight``, whose hash goes into ``policy.json``.
        allow_contradicted: Write the policy although the preflight log contradicts its robot file.

    Raises:
        ConfigError: If there is no such policy or format, the policy cannot be written so, or the log contradicts its robot.
        CapabilityError: If a package is missing.
        StorageError: If the folder cannot be written.
    """
    for each in (wanted := list(to)):
        if each not in FORMATS:
            raise ConfigError(f"format {each!r}: must be {', '.join(FORMATS)}")
    checked = None if preflight is None else _result_of_preflight(preflight, allow_contradicted)
    policy, cfg = load_policy(source)
    cfg = replace(cfg, robot=robot or cfg.robot, settings=settings_of_run(cfg.settings, robot=robot, task=None))
    with task_registry.make_task(
        cfg.task, num_envs=1, robot=cfg.robot, controller=cfg.controller, encoder=cfg.encoder, settings=cfg.settings
    ) as task:
        task.require_one_vehicle("export")
        check_fits(policy, task, cfg.task)
        named = name or Path(cfg.task.rpartition(":")[2]).stem
        layout = policy_layout(policy, cfg, task, name=named, source=str(source))
    return write_policy(policy, replace(layout, preflight=checked), Path(out), wanted, check=check)


def _result_of_preflight(path: Path, allow_contradicted: bool) -> dict[str, str]:
    """Return verdict, robot, log and hash of a preflight result; refuse a contradicted one unless it is allowed."""
    result = read_result(path)
    wrong = [one["text"] for one in result["findings"] if one["code"].endswith("_contradicted")]
    if wrong and not allow_contradicted:
        raise ConfigError(
            f"{path}: the log contradicts {result['robot']}. {' '.join(wrong)} Correct the robot file and train again, or "
            "give --allow-contradicted"
        )
    return {name: result[name] for name in ("verdict", "robot", "log", "sha256")}


def write_policy(policy: Policy, layout: Layout, out: Path, to: Iterable[str], *, check: bool = True) -> list[Exported]:
    """Write a policy with its layout; see ``export_policy``."""
    flown, wanted = DeployablePolicy(policy, layout).eval(), list(to)
    if faults := [fault for each in wanted if each in FAULTS for fault in FAULTS[each](flown, layout)]:
        raise ConfigError(*faults)
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    layout.write(out)
    files = []
    for each in wanted:
        file = FORMATS[each](flown, layout, out)
        files.append(_compare_file(each, file, lambda file: compare_policy(flown, layout, file), check))
    observes_latents = any(seen.term == LATENTS for seen in layout.observation)
    return files + (_write_encoders(layout.encoder, layout, out, wanted, check=check) if observes_latents else [])


def _write_encoders(encoder: str | None, layout: Layout, out: Path, to: list[str], *, check: bool) -> list[Exported]:
    """Write the image encoder of a policy that observes latents."""
    assert encoder is not None
    module, results = load_encoder(encoder), []
    for each in to:
        file = write_encoder(encoder, out / f"{layout.name}_encoder{ENDINGS[each]}")
        results.append(_compare_file(each, file, lambda file: compare_encoder(module, file), check))
    return results


def _compare_file(to: str, file: Path, comparison: Callable[[Path], Comparison], check: bool) -> Exported:
    """Return a written file, compared with torch if asked for and possible."""
    reason = "not asked for" if not check else UNCHECKED.get(to)
    if reason is not None:
        return Exported(to=to, file=file, largest_difference=None, not_checked=reason)
    try:
        result = comparison(file)
    except CapabilityError as error:
        return Exported(to=to, file=file, largest_difference=None, not_checked=str(error))
    return Exported(to=to, file=file, largest_difference=result.largest_difference, agreement=result.worst)


@torch.no_grad()
def compare_policy(flown: DeployablePolicy, layout: Layout, file: Path) -> Comparison:
    """Return the comparison of an exported policy with torch, on random observations and some with NaN or infinity."""
    result, step = Comparison(flown.output_names), load_exported(file).step
    exact, generator = deepcopy(flown).double(), torch.Generator().manual_seed(0)
    rows = (CHECKED_WITH_IMAGES if layout.images else CHECKED) // STEPS
    file_memory = torch.zeros(rows, layout.memory)
    torch_memory = [(file_memory.double(),), (file_memory,)] if layout.memory else [(), ()]
    mean, std, _ = flown.normalization()
    for _ in range(STEPS):
        seen = (mean + SPREAD * std * torch.randn(rows, len(mean), generator=generator)) / flown.scale
        images = [random_image(image, rows, generator) for image in layout.images]
        outputs = (
            exact(seen.double(), *images, *torch_memory[0]),
            flown(seen, *images, *torch_memory[1]),
            step(seen, file_memory, *images),
        )
        result.add(*(torch.cat(output, dim=-1) for output in outputs))
        torch_memory, file_memory = [output[2:] for output in outputs[:2]], outputs[2][2]
    bad = inputs_not_finite(layout.num_observations, range(layout.num_observations))
    images = [random_image(image, len(bad), generator) for image in layout.images]
    result.add_not_finite(torch.cat(step(bad, torch.zeros(len(bad), layout.memory), *images), dim=-1))
    return result


def random_image(image: ObservationImage, rows: int, generator: torch.Generator) -> Tensor:
    """Return random images (B, C, H, W): walls at random distances with some noise pixels."""
    shape = (rows, *image.shape)
    walls = torch.rand(rows, image.shape[0], 1, image.shape[2], generator=generator).expand(shape)
    noise, chosen = torch.rand(shape, generator=generator), torch.rand(shape, generator=generator)
    shares = torch.where(chosen < 0.2, noise, walls)
    return (255.0 * shares + 0.5).to(torch.uint8) if image.dtype == "uint8" else shares.to(TYPES[image.dtype][0])


ENDINGS = {"onnx": ".onnx", "torchscript": ".pt", "c99": ".c"}  # Of an encoder's file, by the format


def _write_onnx(flown: DeployablePolicy, layout: Layout, out: Path) -> Path:
    file, (inputs, outputs) = out / f"{layout.name}.onnx", flown.input_and_output_names
    batch, num_states = {0: torch.export.Dim("rows")}, len(inputs) - 1
    dynamic = (batch, (batch,) * num_states) if num_states else (batch,)
    write_atomic(file, onnx_bytes(flown, flown.example_inputs(), inputs, outputs, dynamic))
    return file


def _write_torchscript(flown: DeployablePolicy, layout: Layout, out: Path) -> Path:
    file = out / f"{layout.name}.pt"
    write_atomic(file, torchscript_bytes(flown, flown.example_inputs()))
    return file


def _write_c99(flown: DeployablePolicy, layout: Layout, out: Path) -> Path:
    file, text = out / f"{layout.name}.c", c99.policy_source(flown, layout)
    work = c99_images.image_code(flown, layout, lambda _, __: "").work
    write_atomic(file.with_suffix(".h"), c99.policy_header(layout, work=work))
    write_atomic(file, text)
    return file


def _write_files(
    name: str, files: Callable[[DeployablePolicy, Layout], dict[str, str | bytes]], flown: DeployablePolicy, layout: Layout,
    out: Path,
) -> Path:  # fmt: skip
    """Write the files of an engine into a folder of its own, with ``policy.json``; return the last one, which is checked."""
    folder = out / name
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    layout.write(folder)
    contents = files(flown, layout)
    for place, content in contents.items():
        write_atomic(folder / place, content)
    return folder / [*contents][-1]


Writer = Callable[[DeployablePolicy, Layout, Path], Path]

UNCHECKED = {raptor.NAME: "the module checks it at its start"}  # Reasons why a format is not run here
TARGETS = (crazyflie, tflm, raptor)  # Engines on vehicles

FORMATS: dict[str, Writer] = {
    "onnx": _write_onnx, "torchscript": _write_torchscript, "c99": _write_c99,
    **{target.NAME: partial(_write_files, target.NAME, target.files) for target in TARGETS},
}  # fmt: skip
"""Writer of each format."""

FAULTS: dict[str, Callable[[DeployablePolicy, Layout], Iterable[str]]] = {
    target.NAME: target.faults for target in TARGETS
}
"""Reasons why an engine cannot fly a policy, each with the alternative."""
