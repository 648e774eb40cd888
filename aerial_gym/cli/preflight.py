"""``aerial-gym preflight``: a log of the real vehicle against the robot file and the training of a policy."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from aerial_gym.cli.terminal import print_table, progress_bar
from aerial_gym.config.console import json_line

if TYPE_CHECKING:
    from aerial_gym.sim2real.preflight.check import Preflight

STATES = ("contradicted", "measured", "assumed")


@dataclass(frozen=True, kw_only=True)
class PreflightCmd:
    """Compare a log of the vehicle with its robot file before a policy flies it: constants, signs, delays, link."""

    robot: Annotated[str, tyro.conf.Positional]  # Registered robot, or the robot file of the policy's training
    log: Annotated[Path, tyro.conf.Positional]  # Two minutes of flight: hover, climbs, a yaw turn, steps of body rates
    policy: Path | None = None  # Run folder, checkpoint or pretrained/NAME: lists the motion outside its training
    rate_hz: float | None = None  # Rate of the commands in training [Hz]; that of --policy, if given
    mapping: str | None = None  # Mapping of a CSV file, or of further topics: a name or a file (.yaml)
    out: Path | None = None  # File for the result (.json), which export takes as --preflight
    json: bool = False  # Print one JSON object

    def run(self) -> int:
        """Compare and print; return 0, or 1 if the log contradicts the file."""
        result = self.result()
        if self.out is not None:
            result.write(self.out)
        if self.json:
            print(json_line(result.as_mapping(), allow_nan=False))
        else:
            _print_result(result)
        return int(bool(result.contradictions))

    def result(self) -> "Preflight":
        """Return the result of the comparison."""
        from dataclasses import replace

        from aerial_gym.errors import ConfigError
        from aerial_gym.sim2real.logs.readers.mapping import find_mapping
        from aerial_gym.sim2real.preflight.check import preflight
        from aerial_gym.sim2real.preflight.ranges import TrainingConditions

        if self.rate_hz is not None and not self.rate_hz > 0.0:
            raise ConfigError(f"--rate-hz {self.rate_hz!r}: must be > 0")
        mapping = None if self.mapping is None else find_mapping(self.mapping)
        with progress_bar() as progress:
            conditions = TrainingConditions()
            if self.policy is not None:
                from aerial_gym.export.training_range import training_conditions

                progress("flying the policy", 0.0)
                conditions = training_conditions(self.policy)
            if self.rate_hz is not None:
                conditions = replace(conditions, link=replace(conditions.link, rate=self.rate_hz))
            return preflight(self.robot, self.log, training=conditions, mapping=mapping, progress=progress)


def _print_result(result: "Preflight") -> None:
    from rich.console import Console

    from aerial_gym.sim2real.wording import text

    console = Console(markup=False, highlight=False)
    states = [one.code.rpartition("_")[2] for one in result.findings]
    counts = Counter(state for state in states if state in STATES)
    console.print(f"{result.verdict}: {', '.join(f'{counts[state]} {state}' for state in STATES)}")
    for state in STATES:
        for finding in (one for one, known in zip(result.findings, states, strict=True) if known == state):
            console.print(f"{state}: {text(finding)}", soft_wrap=True)
    outside = [one for one in result.findings if one.code == "outside_training"]
    if result.policy:
        rows = [
            (one.subject, *(f"{one.values[name]:.3g}" for name in ("low", "high", "trained_low", "trained_high")),
             f"{100.0 * one.values['share']:.2g} %") for one in outside
        ]  # fmt: skip
        head = ("quantity", "lowest", "highest", "lowest trained", "highest trained", "time outside")
        print_table(rows, head, title=f"outside the training of {result.policy}: {len(rows)} quantities")
