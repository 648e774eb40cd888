"""Studies of ``aerial-gym identify``: from files to tables, figures and notes."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.rotor import POLYNOMIAL_MAP
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.sim2real.findings import Finding, unit_suffix
from aerial_gym.sim2real.logs.readers.flight_log import read_flights
from aerial_gym.sim2real.logs.readers.mapping import LogMapping
from aerial_gym.sim2real.statistics import Estimate
from aerial_gym.sim2real.teststand import figures
from aerial_gym.sim2real.teststand.balance import Balance, HoverEffort, hover_effort, judge_balance
from aerial_gym.sim2real.teststand.hover import fit_hover
from aerial_gym.sim2real.teststand.joints.record import (
    ALTERNATE_S,
    PUBLISHED,
    creep_elements,
    errors_by_span,
    fit_joint,
    release_record,
)
from aerial_gym.sim2real.teststand.report import ReportTable, Study, interval_text, relative_change_text, rotor_files
from aerial_gym.sim2real.teststand.static import MapChoice, StaticFit, fit_static
from aerial_gym.sim2real.teststand.statistics import rms
from aerial_gym.sim2real.teststand.step import BOUNDS, StepFit, fit_steps, step_record
from aerial_gym.sim2real.teststand.tables import Bench

MOST_TESTS_SHOWN = 3


def study_motor(benches: Sequence[Bench], *, num_motors: int = 1, robot: RobotCfg | None = None) -> Study:
    """Return a study of rotor maps and lags from static tests and step records, distinguished by their columns."""
    static: list[StaticFit] = []
    steps, notes = [], []
    for bench in benches:
        if bench.column_of_quantity("command") is not None and bench.column_of_quantity("time") is not None:
            steps.append(step_record(bench))
        elif bench.column_of_quantity("thrust") is not None:
            fits, missed = fit_static(bench, num_motors=num_motors)
            static += fits
            notes += missed
        else:
            raise DataError(
                f"{bench.path}: is neither a static test (speed, thrust) nor a step record (time, command, measured); it has "
                f"the columns {', '.join(bench.table.columns)}. Name them with --columns and --units"
            )
    tables = static_tables(static)
    mapping: dict[str, object] = {
        "static": [fit.as_mapping() for fit in static],
        "left_out": [note.values["error"] for note in notes],
    }
    drawn = figures.static_figures(static[0]) if static else {}
    notes += [note for fit in static for note in fit.notes]
    lag = fit_steps(steps) if steps else None
    if lag is not None:
        tables.append(step_table(lag))
        notes += lag.notes
        mapping["steps"] = lag.as_mapping()
        drawn |= figures.step_figures(lag)
    notes += [note for fit in static[:MOST_TESTS_SHOWN] for note in curvature_notes(fit)]
    if len(static) > 1:
        mapping["all_tests"] = summary_of_tests(static)
    changes, files = rotor_fields_from_tests(static, lag), ", ".join(Path(bench.path).name for bench in benches)
    return Study(
        title="Motor identification",
        intro="Every interval is a 95 % interval; held-out errors are on rows or steps that the fit has not seen.",
        mapping=mapping,
        tables=tuple(tables),
        figures=drawn,
        notes=tuple(notes),
        files=rotor_files(robot, changes, f"aerial-gym identify motor: {files}.") if changes else {},
    )


def rotor_fields_from_tests(static: Sequence[StaticFit], lag: StepFit | None) -> dict[str, object]:
    """Return the rotor fields from one static test and the steps; no maps for several tests."""
    results: dict[str, object] = {}
    if len(static) == 1:
        fit = static[0]
        results["thrust_map"] = fit.thrust_map.best.polynomial()
        if fit.torque_map is not None and fit.torque_ratio is not None:
            constant = fit.torque_map.chosen == "torque ratio"
            results["torque_ratio"] = fit.torque_map.best.params["ratio"].value if constant else None
            results["torque_map"] = None if constant else fit.torque_map.best.polynomial()
        if fit.reverse is not None:
            results |= _reverse_rotor_fields(fit, fit.reverse)
    if lag is not None:
        params = lag.laws[lag.in_robot].params
        for way in ("up", "down"):
            results[f"time_constant_{way}"] = params.get(f"tau_{way}", params.get("tau")).value  # type: ignore[union-attr]
        results |= slew_rate_settings(params)
    return results


def _reverse_rotor_fields(fit: StaticFit, reverse: StaticFit) -> dict[str, object]:
    """Return the fields of a reversible rotor: reverse maps, and the range of measured thrust."""
    thrust_map = reverse.thrust_map.best.polynomial()
    results: dict[str, object] = {"reverse_thrust_map": thrust_map}
    results["thrust_range"] = -float(reverse.thrust.max()), float(fit.thrust.max())
    if reverse.torque_map is not None and reverse.torque_ratio is not None:
        best = reverse.torque_map.best
        constant = reverse.torque_map.chosen == "torque ratio"
        ratio = best.params["ratio"].value if constant else 0.0
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


def summary_of_tests(static: Sequence[StaticFit]) -> dict[str, object]:
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
        rows = [("c_t (w² alone) [N s²/rad²]", interval_text(fit.thrust_coefficient))]
        if fit.torque_ratio is not None:
            rows.append(("c_t2t, torque per thrust [m]", interval_text(fit.torque_ratio)))
        tables.append(ReportTable(f"Coefficients, {Path(fit.name).name}", ("quantity", "value"), rows))
        tables.append(_table_of_maps("Thrust", fit.thrust_map))
        if fit.torque_map is not None:
            tables.append(_table_of_maps("Torque", fit.torque_map))
    if len(static) > MOST_TESTS_SHOWN:
        rows = [(name.replace("_", " "), str(value)) for name, value in summary_of_tests(static).items()]
        tables.append(ReportTable("All tests", ("quantity", "value"), rows))
    return tables


def _table_of_maps(quantity: str, choice: MapChoice) -> ReportTable:
    rows = []
    for fit in choice.candidates.values():
        mark, numbers = " (chosen)" * (fit.name == choice.chosen), _parameter_text(fit.params)
        rows.append((fit.name + mark, f"{fit.fit_rms:.3g}", f"{fit.held_out_rms:.3g}", numbers))
    before, after = choice.rms_squared_only, choice.rms_chosen
    change = relative_change_text(before.value, after.value)
    rows.append(("before: w²", "", interval_text(before), ""))
    rows.append(("after: selected again without each row", "", interval_text(after), change))
    head = ("map", f"fit rms [{choice.unit}]", f"held-out rms [{choice.unit}]", "coefficients, 95 %")
    return ReportTable(f"{quantity} map", head, rows)


def _parameter_text(params: Mapping[str, Estimate]) -> str:
    return "; ".join(f"{name} {interval_text(value)}" for name, value in params.items())


def curvature_notes(fit: StaticFit) -> list[Finding]:
    """Return a finding for each residual with a curvature that a robot file's map cannot represent."""
    results = []
    for quantity, choice in (("thrust", fit.thrust_map), ("torque", fit.torque_map)):
        if choice is None:
            continue
        cubic, best = choice.candidates["w³, w² and w"], choice.best
        if cubic.held_out_rms < 0.8 * best.held_out_rms:
            key = unit_suffix(choice.unit)
            errors = {f"cubic_{key}": cubic.held_out_rms, f"chosen_{key}": best.held_out_rms}
            results.append(Finding("curvature_kept", Path(fit.name).name, {"quantity": quantity, **errors}))
    return results


def step_table(lag: StepFit) -> ReportTable:
    """Return the table of lag laws."""
    rows = []
    for law in lag.laws.values():
        mark = " (chosen)" * (law.name == lag.chosen) + " (in robot file)" * (law.name == lag.in_robot)
        rows.append((law.name + mark, f"{law.fit_rms:.3g}", interval_text(law.error), _parameter_text(law.params)))
    before, after = lag.laws["one time constant"], lag.laws[lag.chosen]
    change = relative_change_text(before.held_out_rms, after.held_out_rms)
    rows.append(("change against one time constant", "", change, ""))
    head = ("law", "fit rms [rad/s]", "held-out rms [rad/s], steps left out", "tau, delay [s]; slew [rad/s²]")
    return ReportTable("Step responses", head, rows)


def study_joint(bench: Bench, *, release: float = 0.0) -> Study:
    """Return a study of a compliant joint's law from a release record."""
    study = fit_joint(release_record(bench, release=release))
    time, best = study.record.time, study.laws[study.chosen]
    published, held_out = errors_by_span(time, study.published), errors_by_span(time, best.held_out)
    rows = [["published quadratic spring, without a fit", "", *_error_texts(published), "", "", ""]]
    for law in study.laws.values():
        shown = (
            _degree_text(rms(law.residual)),
            *_error_texts(errors_by_span(time, law.held_out)),
            _degree_text(study.forecast[law.name].value),
            *_error_texts(errors_by_span(time, study.alternate[law.name]))[:2],
        )
        rows.append([law.name + " (chosen)" * (law.name == study.chosen), *shown])
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
    params = [(name, interval_text(value)) for name, value in best.params.items()]
    units = "release, time [s]; stiffness [1/s²], damping [1/s] per inertia of the joint; rest [rad]"
    law = joint_law_yaml(study.chosen, {name: value.value for name, value in best.params.items()})
    whole, early = (relative_change_text(published[name], held_out[name]) for name in ("rms", "rms_first_second"))
    return Study(
        title="Compliant joint",
        intro=f"Held-out error against the published law: {whole}; in the first second: {early}. "
        "Blocks of time are left out in turn, the first 30 ms included.",
        mapping=study.as_mapping(),
        tables=(
            ReportTable("Laws", head, rows),
            ReportTable(f"Parameters of the {study.chosen} ({units})", ("parameter", "95 %"), params),
        ),
        figures=figures.joint_figures(study),
        notes=(Finding("published_law", "", PUBLISHED), Finding("one_record")),
        files={
            "joint.yaml": f"# {study.chosen}: {units}\n{law}\n  source: 'aerial-gym identify joint: {Path(bench.path).name}'\n"
        },
    )


def joint_law_yaml(law: str, params: Mapping[str, float]) -> str:
    """Return a joint's law as YAML; element stiffness times an inertia is that of a robot file."""
    lines = ["joint:", f"  law: {law!r}"]
    lines += [f"  {name}: {value!r}" for name, value in params.items() if name != "release"]
    stiffness, times = creep_elements(params)
    elements = [f"{{stiffness: {k:.6g}, time: {t:.6g}}}" for k, t in zip(stiffness, times, strict=True)]
    if elements:
        lines.append(f"  elements: [{', '.join(elements)}] # times an inertia: spring.creep of a robot file")
    return "\n".join(lines)


def _degree_text(angle: float) -> str:
    return f"{np.degrees(angle):.3g}"


def _error_texts(errors: Mapping[str, float]) -> list[str]:
    return [_degree_text(errors[name]) for name in ("rms", "rms_first_second", "largest")]


def study_hover(
    paths: Sequence[Path], *, layout: LogMapping | None, mass: float, mass_std: float = 0.0,
    robot: RobotCfg | None = None,
) -> Study:  # fmt: skip
    """Return a study of the thrust coefficient from hover in flight logs."""
    logs = read_flights(paths, mapping=layout)
    rotor = None if robot is None else robot.the_rotor("identify hover")
    declared = rotor.thrust_map if rotor is not None and rotor.rotor_map == POLYNOMIAL_MAP else None
    fit = fit_hover(logs, mass=mass, mass_std=mass_std, declared=declared)
    rows = [("c_t [N s²/rad²]", interval_text(fit.thrust_coefficient))]
    if fit.scale is not None:
        rows.append(("factor on the declared thrust map", interval_text(fit.scale)))
    rows += [(f"c_t of {name}", f"{value:.4g}") for name, value in fit.by_flight.items()]
    models = [(name + " (chosen)" * (name == fit.chosen), interval_text(m.error)) for name, m in fit.models.items()]
    head = ("map", "measured minus predicted thrust over mass [m/s²]")
    best = fit.models[fit.chosen].thrust_map
    return Study(
        title="Thrust coefficient from hover",
        intro=f"{fit.force.size} windows of hover, mass {fit.mass:g} kg. Errors are on flights (or parts of the only one) "
        "left out of the fit.",
        mapping=fit.as_mapping(),
        tables=(ReportTable("Coefficients", ("quantity", "value"), rows), ReportTable("Held-out errors", head, models)),
        figures=figures.hover_figures(fit),
        notes=fit.notes,
        files={} if robot is None else rotor_files(robot, {"thrust_map": best}, "aerial-gym identify hover."),
    )


def study_balance(
    baseline: Sequence[Path], flights: Sequence[Path], *, layout: LogMapping | None, robot: RobotCfg,
    test: Sequence[Path] = (), repeats: Sequence[Path] = (), added_mass: float | None = None,
) -> Study:  # fmt: skip
    """Return a study of the cause of changed rotor efforts at hover against a baseline."""
    named = [path.resolve() for path in (*baseline, *flights, *test)]
    if len(set(named)) < len(named):
        raise ConfigError("a log is named twice among flights, --baseline and --test; each log has one role")
    repeats_only = [path for whole, path in {path.resolve(): path for path in repeats}.items() if whole not in named]

    def read(paths: Sequence[Path]) -> list[HoverEffort]:
        return [hover_effort(log) for log in read_flights(paths, mapping=layout, hover=True)]

    results = judge_balance(
        read(baseline), read(flights), robot=robot, test=read(test), repeats=read(repeats_only), added_mass=added_mass
    )
    return Study(
        title="Balance at hover",
        intro=f"Verdict: {results.verdict}. Candidates: {', '.join(results.candidates) or 'none'}. Intervals of 95 % come from "
        f"the scatter between logs of one condition, known from {results.freedom} repeats.",
        mapping=results.as_mapping(),
        tables=_balance_tables(results),
        notes=(*results.notes, *results.tell_apart),
    )


def _balance_tables(balance: Balance) -> tuple[ReportTable, ...]:
    changes = {f"share of rotor {number}": share for number, share in enumerate(balance.shares, start=1)}
    changes["sum of squared speeds; relative change"] = balance.total
    rows = [(name, *map(interval_text, (c.baseline, c.flights, c.change))) for name, c in changes.items()]
    efforts = ReportTable("Effort at hover", ("quantity", "baseline", "flights", "change"), rows)
    rows = []
    for fit in balance.fits:
        numbers = _parameter_text(fit.params)
        if fit.place is not None:
            numbers += "; weight at " + ", ".join(interval_text(axis) for axis in fit.place)
        mark = " (possible)" * (fit.cause.name in balance.candidates)
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
    return (efforts, ReportTable("Candidates", head, rows)) if rows else (efforts,)
