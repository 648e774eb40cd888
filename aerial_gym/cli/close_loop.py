"""``aerial-gym close-loop``: flights in, a named effect and a corrected robot file out."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from aerial_gym.cli.terminal import open_in_browser, print_table, progress_bar
from aerial_gym.config.console import json_line
from aerial_gym.config.set_option import SetOption
from aerial_gym.lazy import pause_garbage_collection

if TYPE_CHECKING:
    from aerial_gym.sim2real import Verdict


@dataclass(frozen=True, kw_only=True)
class CloseLoopCmd:
    """Find what a declared robot lacks in measured flights, and write the corrected robot."""

    robot: str = field(kw_only=False)  # Registered robot, or a robot file (.yaml)
    train: tuple[Path, ...]  # Flight logs to fit on; four or more with different motions are best
    test: tuple[Path, ...]  # Flight logs to judge on; nothing is fitted to them

    out: Path
    """Folder of the results: verdict.json, robot.yaml, report.html, report.md, residuals.csv, profiles.csv, evidence.csv. New,
    or of an earlier run."""

    mapping: str | None = None
    """Layout of the logs: a name (idsia_nanodrone) or a mapping file (.yaml); the package's own layout if not given."""

    pair: Annotated[tuple[tuple[Path, Path], ...], tyro.conf.UseAppendAction] = ()
    """Logs of two vehicles in one flight, each with its own position in the same world frame. Can be repeated, with the
    vehicles in the same order. Each log then has the other vehicle's wake. Both vehicles share the robot's parameters."""

    pair_clock_s: tuple[float, ...] = ()
    """Added to the times of the second log of each --pair, which gives those of the first [s]; 0 if not given."""

    bandwidth_hz: float = 10.0
    """Measured and predicted are compared below this frequency [Hz]; at most a fifth of the logs' rate is used."""

    tolerances: Path | None = None
    """How well the robot is declared (.yaml): standard deviations of mass, thrust, inertia, time_constant, com, acc_bias,
    gyro_bias, acc_of_flight, attitude, sensor_delay, acc_scale, imu_place, nominal_voltage, command_hold, joint_rest,
    command_clock, command_gain, products, velocity_place, load_place; docs/guides/identify_from_flights.md has those that are
    left out."""

    effects: tuple[str, ...] | None = None
    """Effects that are looked for; if not given all but blade_element and vortex_ring (docs/results/propellers.md) and
    torque_gain, which inertia, arm length and torque ratio look like."""

    material: float = 0.05  # An effect is named if a residual rises, or may rise, by this share without it
    seed: int = 0  # Seed of the resampling behind the 95 % intervals

    set: SetOption = ()
    """Setting of the declared robot, the tolerances or the acceptance criteria, such as robot.body.mass=0.3,
    tolerances.mass=0.01 or criteria.significance=0.01; can be repeated."""

    failures: bool = False
    """Look through each flight for a rotor or supply that fails in it, and compare it up to there only. Give it where something
    failed or may have: on measured flights that the declared vehicle misses by much there are false alarms. Without it a
    note says what looks like a failure, and nothing is made of it."""

    joints: bool = False
    """Fit stiffness, damping, rest angle and friction of the robot's joints as well: by their angles (columns joint_NAME), or
    by what the body felt if no log has any, which takes minutes."""

    learn_residual: bool = False
    """Add a small network for what no named effect explains, if it predicts flights left out better. It fades to zero
    outside its training data, has no name, and changes nothing in the verdict."""

    ranges: bool = False
    """Let robot.yaml draw what was found from its intervals at every reset (``randomize:``), so that a policy trains on what is
    uncertain."""

    open: bool = False  # Open report.html in the browser
    json: bool = False  # Print verdict.json on stdout instead of tables

    def run(self) -> int:
        """Run the loop and print the verdict; return the exit status."""
        verdict = self.result()
        if self.json:
            from aerial_gym.sim2real.report.verdict_json import verdict_json

            print(json_line(verdict_json(verdict)))
        else:
            _print_verdict(verdict, self.out)
        return 0

    def result(self) -> "Verdict":
        """Run the loop and write the report and the corrected robot."""
        with pause_garbage_collection():
            from aerial_gym.config import load
            from aerial_gym.sim2real import close_loop
            from aerial_gym.sim2real.identify.selection.criteria import Criteria
            from aerial_gym.sim2real.predict.tolerances import Tolerances

        with progress_bar() as progress:
            verdict = close_loop(
                self.robot, self.train, self.test, self.out, mapping=self.mapping, bandwidth=self.bandwidth_hz,
                seed=self.seed, criteria=Criteria(material=self.material),
                tolerances=None if self.tolerances is None else load(Tolerances, self.tolerances),
                effects=self.effects, failures=self.failures, joints=self.joints, learn_residual=self.learn_residual,
                ranges=self.ranges, settings=self.set, pairs=self.pair, pair_clocks=self.pair_clock_s, progress=progress,
            )  # fmt: skip
        if self.open:
            open_in_browser(self.out / "report.html")
        return verdict


def _print_verdict(verdict: "Verdict", out: Path) -> None:
    from aerial_gym.sim2real.judge.answer import answer_parts
    from aerial_gym.sim2real.report.tables import (
        SHOWN_NOTES,
        channel_rows,
        channels_by_outcome,
        rollout_rows,
        text_rows_of_effects,
    )
    from aerial_gym.sim2real.wording import answer_texts, join_texts, text

    console = Console(markup=False)
    console.print(f"verdict: {verdict.verdict}")
    for sentence in answer_texts(answer_parts(verdict)):
        console.print(sentence)
    shown = verdict.notes[:SHOWN_NOTES]
    for note in shown:
        if note.code == "flight_left_out":
            console.print(text(note))
    for effect in text_rows_of_effects(verdict):
        console.print(f"  {effect['name']}: {effect['parameters']}; {effect['sure']}")
    for state, channels in channels_by_outcome(verdict).items():
        console.print(f"  {state}: {channels}")
    if verdict.learned is not None:
        console.print(f"  {join_texts(verdict.learned.findings)}")
    for note in shown:
        if note.code != "flight_left_out":
            console.print(f"  note: {text(note)}")
    if (more := len(verdict.notes) - len(shown)) > 0:
        console.print(f"  {more} more notes in the report")
    after = verdict.after if verdict.corrects else None
    keys = ("name", "before", "after", "change", "became", "floor")
    rows = channel_rows(verdict.before, after, verdict.outcomes, intervals=False)
    head = ("channel", "declared", "corrected", "change", "became", "noise floor")
    print_table([[str(row[key]) for key in keys] for row in rows], head, title="residual on the test flights (rms)")
    keys = ("quantity", "horizon", "before", "after", "change", "became")
    head = ("quantity", "after [s]", "declared", "corrected", "change", "became")
    for variant in verdict.before.rollout:
        rows = rollout_rows(verdict, variant, intervals=False)
        title = f"open-loop error, {variant.replace('_', ' ')} (rms)"
        print_table([[row[key] for key in keys] for row in rows], head, title=title)
    if verdict.not_testable:
        console.print(f"not testable: {', '.join(verdict.not_testable)}")
    console.print(
        f"written: {out}/report.html, report.md, verdict.json, robot.yaml, residuals.csv, profiles.csv, evidence.csv"
    )
