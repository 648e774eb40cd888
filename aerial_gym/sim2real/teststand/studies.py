"""Studies of ``aerial-gym identify``: from files to tables, figures and notes."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.sim2real.findings import Finding, unit_key
from aerial_gym.sim2real.logs.readers.flight_log import read_flight_log
from aerial_gym.sim2real.logs.readers.mapping import LogMapping
from aerial_gym.sim2real.statistics import Rms
from aerial_gym.sim2real.teststand import figures
from aerial_gym.sim2real.teststand.balance import Balance, Change, HoverEffort, hover_effort, judge_balance
from aerial_gym.sim2real.teststand.hover import fit_hover
from aerial_gym.sim2real.teststand.joints.record import (
    ALTERNATE_S,
    PUBLISHED,
    creep_elements,
    fit_joint,
    release_record,
    spans,
)
from aerial_gym.sim2real.teststand.report import ReportTable, Study, rotor_files
from aerial_gym.sim2real.teststand.static import Choice, StaticFit, fit_static
from aerial_gym.sim2real.teststand.statistics import Estimate, rms
from aerial_gym.sim2real.teststand.step import BOUNDS, StepFit, fit_steps, step_record
from aerial_gym.sim2real.teststand.tables import Bench

MOST_TESTS_SHOWN = 3


def interval(value: Estimate | Rms) -> str:
    """Return a value with its 95 % interval as text."""
    return f"{value.value:.4g} [{value.low:.4g}, {value.high:.4g}]"


def change(before: float, after: float) -> str:
    """Return a relative change as text."""
    return f"{100.0 * (after / before - 1.0):+.0f} %"


def study_motor(benches: Sequence[Bench], *, num_motors: int = 1, robot: RobotCfg | None = None) -> Study:
    """Return a study of rotor maps and lags from static tests and step records, distinguished by their columns."""
    static: list[StaticFit] = []
    steps, left_out = [], []
    for bench in benches:
        if bench.column("command") is not None and bench.column("time") is not None:
            steps.append(step_record(bench))
        elif bench.column("thrust") is not None:
            fits, missed = fit_static(bench, num_motors=num_motors)
            static += fits
            left_out += missed
        else:
            raise DataError(
                f"{bench.path}: is neither a static test (speed, thrust) nor a step record (time, command, measured); it has "
                f"the columns {', '.join(bench.table.columns)}. Name them with --columns and --units"
            )
    lag = fit_steps(steps) if steps else None
    tables = [*static_tables(static), *([] if lag is None else step_tables(lag))]
    notes = [*left_out, *(note for fit in static for note in fit.notes)]
    notes += [] if lag is None else lag.notes
    notes += [note for fit in static[:MOST_TESTS_SHOWN] for note in curvature_notes(fit)]
    mapping: dict[str, object] = {
        "static": [fit.as_mapping() for fit in static],
        "left_out": [note.values["error"] for note in left_out],
    }
    if lag is not None:
        mapping["steps"] = lag.as_mapping()
    if len(static) > 1:
        mapping["all_tests"] = all_tests(static)
    shown = {} if not static else figures.static_figures(static[0])
    changes = rotor_changes(static, lag)
    return Study(
        title="Motor identification",
        intro="Every interval is a 95 % interval; held-out errors are on rows or steps that the fit has not seen.",
        mapping=mapping,
        tables=tuple(tables),
        figures=shown | ({} if lag is None else figures.step_figures(lag)),
        notes=tuple(notes),
        files={} if not changes else rotor_files(robot, changes, f"aerial-gym identify motor: {names(benches)}."),
    )


def names(benches: Sequence[Bench]) -> str:
    """Return the file names."""
    return ", ".join(Path(bench.path).name for bench in benches)


def rotor_changes(static: Sequence[StaticFit], lag: StepFit | None) -> dict[str, object]:
    """Return the rotor fields from one static test and the steps; no maps for several tests."""
    results: dict[str, object] = {}
    if len(static) == 1:
        fit = static[0]
        results["thrust_map"] = fit.thrust_map.best.polynomial()
        if fit.torque_map is not None and fit.torque_ratio is not None:
            constant = fit.torque_map.chosen == "torque ratio"
            results["torque_ratio"] = fit.torque_map.best.coefficients["ratio"].value if constant else None
            results["torque_map"] = None if constant else fit.torque_map.best.polynomial()
        if fit.reverse is not None:
            results |= _reverse_changes(fit, fit.reverse)
    if lag is not None:
        params = lag.laws[lag.in_robot].params
        for way in ("up", "down"):
            results[f"time_constant_{way}"] = params.get(f"tau_{way}", params.get("tau")).value  # type: ignore[union-attr]
        results |= slew_rate_settings(params)
    return results


def _reverse_changes(fit: StaticFit, reverse: StaticFit) -> dict[str, object]:
    """Return the fields of a reversible rotor: reverse maps, and the range of measured thrust."""
    thrust_map = reverse.thrust_map.best.polynomial()
    results: dict[str, object] = {"reverse_thrust_map": thrust_map}
    results["thrust_range"] = -float(reverse.thrust.max()), float(fit.thrust.max())
    if reverse.torque_map is not None and reverse.torque_ratio is not None:
        best = reverse.torque_map.best
        constant = reverse.torque_map.chosen == "torque ratio"
        ratio = best.coefficients["ratio"].value if constant else 0.0
        c0, c1, c2 = thrust_map
        results["reverse_torque_map"] = (ratio * c0, ratio * c1, ratio * c2) if constant else best.polynomial()
    return results


def slew_rate_settings(params: Mapping[str, Estimate]) -> dict[str, object]:
    """Return the slew rates of a rotor from a law; None for one that no step reaches."""
    rates = {way: params.get(f"slew_{way}") for way in ("up", "down")}
    reached = {way: rate for way, rate in rates.items() if rate is not None and rate.high < BOUNDS[f"slew_{way}"][2]}
    up, down = (reached[way].value if way in reached else None for way in ("up", "down"))
    if up is not None and down is None:  # otherwise the rising limit would apply to falling speeds
        down = BOUNDS["slew_down"][2]
    return {"slew_rate": up, "slew_rate_down": down}


def all_tests(static: Sequence[StaticFit]) -> dict[str, object]:
    """Return a summary of map selection over many tests, with errors relative to the highest thrust."""
    before = np.array([fit.thrust_map.rms_squared_only.value / fit.thrust.max() for fit in static])
    after = np.array([fit.thrust_map.rms_chosen.value / fit.thrust.max() for fit in static])
    chosen = [fit.thrust_map.chosen for fit in static]
    return {
        "tests": len(static),
        "chosen": {name: chosen.count(name) for name in dict.fromkeys(chosen)},
        "median_relative_error_before": float(np.median(before)),
        "median_relative_error_after": float(np.median(after)),
        "share_of_tests_better": float((after < before).mean()),
    }


def static_tables(static: Sequence[StaticFit]) -> list[ReportTable]:
    """Return the tables of static tests: all candidates for few tests, a summary for many."""
    tables = []
    parts = [part for fit in static for part in (fit, fit.reverse) if part is not None]
    for fit in parts if len(static) <= MOST_TESTS_SHOWN else []:
        rows = [("c_t (w² alone) [N s²/rad²]", interval(fit.thrust_coefficient))]
        if fit.torque_ratio is not None:
            rows.append(("c_t2t, torque per thrust [m]", interval(fit.torque_ratio)))
        tables.append(
            ReportTable(title=f"Coefficients, {Path(fit.name).name}", head=("quantity", "value"), rows=tuple(rows))
        )
        tables.append(_choice_table("Thrust", fit.thrust_map))
        if fit.torque_map is not None:
            tables.append(_choice_table("Torque", fit.torque_map))
    if len(static) > MOST_TESTS_SHOWN:
        results = all_tests(static)
        rows = [(name.replace("_", " "), str(value)) for name, value in results.items()]
        tables.append(ReportTable(title="All tests", head=("quantity", "value"), rows=tuple(rows)))
    return tables


def _choice_table(quantity: str, choice: Choice) -> ReportTable:
    rows = []
    for fit in choice.candidates.values():
        numbers = "; ".join(f"{name} {interval(value)}" for name, value in fit.coefficients.items())
        mark = " (chosen)" if fit.name == choice.chosen else ""
        rows.append((fit.name + mark, f"{fit.fit_rms:.3g}", f"{fit.held_out_rms:.3g}", numbers))
    before, after = choice.rms_squared_only, choice.rms_chosen
    rows.append(("before: w²", "", interval(before), ""))
    rows.append(("after: selected again without each row", "", interval(after), change(before.value, after.value)))
    head = ("map", f"fit rms [{choice.unit}]", f"held-out rms [{choice.unit}]", "coefficients, 95 %")
    return ReportTable(title=f"{quantity} map", head=head, rows=tuple(rows))


def curvature_notes(fit: StaticFit) -> list[Finding]:
    """Return a finding for each residual with a curvature that a robot file's map cannot represent."""
    results = []
    for quantity, choice in (("thrust", fit.thrust_map), ("torque", fit.torque_map)):
        if choice is None:
            continue
        cubic, best = choice.candidates["w³, w² and w"], choice.best
        if cubic.held_out_rms < 0.8 * best.held_out_rms:
            key = unit_key(choice.unit)
            errors = {f"cubic_{key}": cubic.held_out_rms, f"chosen_{key}": best.held_out_rms}
            results.append(Finding("curvature_kept", Path(fit.name).name, {"quantity": quantity, **errors}))
    return results


def step_tables(lag: StepFit) -> list[ReportTable]:
    """Return the table of lag laws."""
    rows = []
    for law in lag.laws.values():
        mark = " (chosen)" * (law.name == lag.chosen) + " (in robot file)" * (law.name == lag.in_robot)
        numbers = "; ".join(f"{name} {interval(value)}" for name, value in law.params.items())
        rows.append((law.name + mark, f"{law.fit_rms:.3g}", interval(law.error), numbers))
    before, after = lag.laws["one time constant"], lag.laws[lag.chosen]
    rows.append(("change against one time constant", "", change(before.held_out_rms, after.held_out_rms), ""))
    head = ("law", "fit rms [rad/s]", "held-out rms [rad/s], steps left out", "tau, delay [s]; slew [rad/s²]")
    return [ReportTable(title="Step responses", head=head, rows=tuple(rows))]


def study_joint(bench: Bench, *, release: float = 0.0) -> Study:
    """Return a study of a compliant joint's law from a release record."""
    study = fit_joint(release_record(bench, release=release))
    record, best = study.record, study.laws[study.chosen]
    rows = []
    published = spans(record.time, study.published)
    rows.append(("published quadratic spring, without a fit", "", *_angles(published), "", "", ""))
    for law in study.laws.values():
        mark = " (chosen)" * (law.name == study.chosen)
        fit, held_out = spans(record.time, law.residual), spans(record.time, law.held_out)
        shown = (
            f"{np.degrees(fit['rms']):.3g}",
            *_angles(held_out),
            f"{np.degrees(study.forecast[law.name].value):.3g}",
            *_angles(spans(record.time, study.alternate[law.name]))[:2],
        )
        rows.append((law.name + mark, *shown))
    head = (
        "law",
        "fit rms [deg]",
        "held-out rms [deg]",
        "first second [deg]",
        "largest [deg]",
        "second half forecast [deg]",
        f"every second {1e3 * ALTERNATE_S:g} ms held out [deg]",
        "first second of these [deg]",
    )
    params = [(name, interval(value)) for name, value in best.params.items()]
    units = "release, time [s]; stiffness [1/s²], damping [1/s] per inertia of the joint; rest [rad]"
    law_text = f"# {study.chosen}: {units}\n" + joint_text(study.chosen, {n: p.value for n, p in best.params.items()})
    change_text = change(published["rms"], rms(best.held_out))
    early = change(published["rms_first_second"], spans(record.time, best.held_out)["rms_first_second"])
    return Study(
        title="Compliant joint",
        intro=f"Held-out error against the published law: {change_text}; in the first second: {early}. "
        "Blocks of time are left out in turn, the first 30 ms included.",
        mapping=study.as_mapping(),
        tables=(
            ReportTable(title="Laws", head=head, rows=tuple(rows)),
            ReportTable(
                title=f"Parameters of the {study.chosen} ({units})", head=("parameter", "95 %"), rows=tuple(params)
            ),
        ),
        figures=figures.joint_figures(study),
        notes=(
            Finding("published_law", "", PUBLISHED),
            Finding("one_record"),
        ),
        files={"joint.yaml": f"{law_text}\n  source: 'aerial-gym identify joint: {Path(bench.path).name}'\n"},
    )


def joint_text(law: str, params: Mapping[str, float]) -> str:
    """Return a joint's law as YAML; element stiffness times an inertia is that of a robot file."""
    lines = ["joint:", f"  law: {law!r}"]
    lines += [f"  {name}: {value!r}" for name, value in params.items() if name != "release"]
    stiffness, times = creep_elements(params)
    elements = [f"{{stiffness: {k:.6g}, time: {t:.6g}}}" for k, t in zip(stiffness, times, strict=True)]
    if elements:
        lines.append(f"  elements: [{', '.join(elements)}] # times an inertia: spring.creep of a robot file")
    return "\n".join(lines)


def _angles(value: dict[str, float]) -> tuple[str, str, str]:
    return tuple(f"{np.degrees(value[name]):.3g}" for name in ("rms", "rms_first_second", "largest"))  # type: ignore[return-value]


def study_hover(
    paths: Sequence[Path],
    *,
    layout: LogMapping | None,
    mass: float,
    mass_std: float = 0.0,
    robot: RobotCfg | None = None,
) -> Study:
    """Return a study of the thrust coefficient from hover in flight logs."""
    logs = [read_flight_log(path, mapping=layout) for path in paths]
    declared = None if robot is None else robot.the_rotor("identify hover").thrust_map
    fit = fit_hover(logs, mass=mass, mass_std=mass_std, declared=declared)
    rows = [("c_t [N s²/rad²]", interval(fit.thrust_coefficient))]
    if fit.scale is not None:
        rows.append(("factor on the declared thrust map", interval(fit.scale)))
    rows += [(f"c_t of {name}", f"{value:.4g}") for name, value in fit.by_flight.items()]
    models = tuple(
        (name + " (chosen)" * (name == fit.chosen), interval(model.error)) for name, model in fit.models.items()
    )
    head = ("map", "measured minus predicted thrust over mass [m/s²]")
    best = fit.models[fit.chosen].thrust_map
    return Study(
        title="Thrust coefficient from hover",
        intro=f"{fit.force.size} windows of hover, mass {fit.mass:g} kg. Errors are on flights (or parts of the only one) "
        "left out of the fit.",
        mapping=fit.as_mapping(),
        tables=(
            ReportTable(title="Coefficients", head=("quantity", "value"), rows=tuple(rows)),
            ReportTable(title="Held-out errors", head=head, rows=models),
        ),
        figures=figures.hover_figures(fit),
        notes=fit.notes,
        files={} if robot is None else rotor_files(robot, {"thrust_map": best}, "aerial-gym identify hover."),
    )


def study_balance(
    baseline: Sequence[Path],
    flights: Sequence[Path],
    *,
    layout: LogMapping | None,
    robot: RobotCfg,
    test: Sequence[Path] = (),
    repeats: Sequence[Path] = (),
    added_mass: float | None = None,
) -> Study:
    """Return a study of the cause of changed rotor efforts at hover against a baseline."""
    named = [path.resolve() for path in (*baseline, *flights, *test)]
    if len(set(named)) < len(named):
        raise ConfigError("a log is named twice among flights, --baseline and --test; each log has one role")
    repeats_only = [path for whole, path in {path.resolve(): path for path in repeats}.items() if whole not in named]

    def read(paths: Sequence[Path]) -> list[HoverEffort]:
        return [hover_effort(read_flight_log(path, mapping=layout, hover=True)) for path in paths]

    results = judge_balance(
        read(baseline), read(flights), robot=robot, test=read(test), repeats=read(repeats_only), added_mass=added_mass
    )
    return Study(
        title="Balance at hover",
        intro=f"Verdict: {results.verdict}. Candidates: {', '.join(results.candidates) or 'none'}. Intervals of 95 % come from "
        f"the scatter between logs of one condition, known from {results.freedom} repeats.",
        mapping=results.as_mapping(),
        tables=tuple(_balance_tables(results)),
        notes=(*results.notes, *results.tell_apart),
    )


def _balance_tables(value: Balance) -> list[ReportTable]:
    def row(name: str, change: Change) -> tuple[str, ...]:
        return name, interval(change.baseline), interval(change.flights), interval(change.change)

    rows = [row(f"share of rotor {number}", share) for number, share in enumerate(value.shares, start=1)]
    rows.append(row("sum of squared speeds; relative change", value.total))
    tables = [
        ReportTable(title="Effort at hover", head=("quantity", "baseline", "flights", "change"), rows=tuple(rows))
    ]
    rows = []
    for fit in value.fits:
        numbers = "; ".join(f"{name} {interval(value)}" for name, value in fit.params.items())
        if fit.place is not None:
            numbers += "; weight at " + ", ".join(interval(axis) for axis in fit.place)
        mark = " (possible)" * (fit.cause.name in value.candidates)
        judged = ("", "") if fit.judged is None else (f"{fit.judged:.2g}", f"{fit.held_out:.3g}")
        rows.append((fit.cause.name + mark, numbers, f"{fit.probability:.2g}", f"{fit.fit.misfit:.2g}", *judged))
    head = (
        "candidate",
        "dm [kg]; x, y [m] of the centre of mass; place of the weight [m]; scale, torque_ratio of the rotor",
        "probability",
        "p-value of its residual",
        "p-value of its error on left-out logs",
        "relative error on left-out logs",
    )
    return [*tables, *([ReportTable(title="Candidates", head=head, rows=tuple(rows))] if rows else [])]
