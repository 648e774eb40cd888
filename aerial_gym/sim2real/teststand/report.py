"""Results of an identification: tables, figures, JSON, and a robot file with the new values."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from aerial_gym.config import dump_yaml
from aerial_gym.config.robot import RobotCfg, RotorCfg
from aerial_gym.config.rotor import POLYNOMIAL_MAP
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.json_values import write_json
from aerial_gym.sim2real.logs.flights import file_digests
from aerial_gym.sim2real.report.run_folder import atomic_run_folder, check_out_dir, write_record
from aerial_gym.sim2real.statistics import Estimate
from aerial_gym.sim2real.wording import render_findings, text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class ReportTable:
    """Table with a title and text cells."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True, kw_only=True)
class Study:
    """Result of an identification."""

    title: str
    intro: str
    mapping: dict[str, object]  # Content for JSON
    tables: tuple[ReportTable, ...]
    figures: "dict[str, Figure]" = field(default_factory=dict)  # Figures by file name without suffix
    notes: tuple[Finding, ...] = ()
    files: dict[str, str] = field(default_factory=dict)  # Text of further files by name

    def markdown(self) -> str:
        """Return the report as Markdown."""
        lines = [f"# {self.title}", "", self.intro, ""]
        for table in self.tables:
            lines += [f"## {table.title}", "", "| " + " | ".join(table.head) + " |", "| --- " * len(table.head) + "|"]
            lines += ["| " + " | ".join(row) + " |" for row in table.rows] + [""]
        for name in self.figures:
            lines += [f"![{name.replace('_', ' ')}]({name}.png)", ""]
        notes = [f"- {text(note)}" for note in self.notes] or ["- none"]
        return "\n".join([*lines, "## Notes", "", *notes, ""])


def interval_text(value: Estimate) -> str:
    """Return a value with its 95 % interval as text."""
    return f"{value.value:.4g} [{value.low:.4g}, {value.high:.4g}]"


def relative_change_text(before: float, after: float) -> str:
    """Return a relative change as text."""
    return f"{100.0 * (after / before - 1.0):+.0f} %"


def write_study(out_dir: Path, study: Study, config: dict[str, object], inputs: Sequence[str | Path]) -> None:
    """Write report.md, figures, result.json and the robot or rotor file; the folder appears only on success."""
    check_out_dir(out_dir)
    with atomic_run_folder(out_dir) as folder:
        for name, figure in study.figures.items():
            figure.savefig(folder / f"{name}.png", dpi=90, bbox_inches="tight")
        (folder / "report.md").write_text(study.markdown(), encoding="utf-8", errors="surrogateescape")
        write_json(folder / "result.json", render_findings(study.mapping))
        for name, text in study.files.items():
            (folder / name).write_text(text, encoding="utf-8", errors="surrogateescape")
        write_record(folder, config, file_digests(inputs))


def rotor_files(robot: RobotCfg | None, changes: dict[str, object], source: str) -> dict[str, str]:
    """Return robot.yaml with new rotor values, or rotor.yaml with these alone without a robot."""
    if robot is None:
        known = {name: list(v) if isinstance(v, tuple) else v for name, v in changes.items() if v is not None}
        lines = [f"  {name}: {value!r}" for name, value in (known | {"source": source}).items()]
        return {"rotor.yaml": "\n".join(["rotor:", *lines, ""])}
    declared = robot.the_rotor("writing the numbers of a bench into a robot file")
    if "thrust_map" in changes:
        changes = changes | {"rotor_map": POLYNOMIAL_MAP}
    rotor: RotorCfg = replace(declared, **changes, source=f"{source} Other numbers: {declared.source}")  # type: ignore[arg-type]
    kinds = {"rotor": rotor} if robot.rotor is not None else {"rotors": dict.fromkeys(robot.rotors, rotor)}
    return {"robot.yaml": dump_yaml(replace(robot, **kinds))}
