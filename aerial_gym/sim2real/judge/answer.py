"""The answer of a verdict in four parts: the result, the gain on unseen flights, worse or open results, the next step.

Every part is a list of findings with numbers from the verdict.
"""

from collections.abc import Iterator, Sequence

from aerial_gym.sim2real.findings import Finding, unit_suffix
from aerial_gym.sim2real.judge.outcome import BETTER, NOT_SHOWN, WORSE, Outcome
from aerial_gym.sim2real.judge.verdict import NamedEffect, Verdict, notes_on_materiality
from aerial_gym.sim2real.predict.channels import KINEMATIC, UNITS
from aerial_gym.sim2real.predict.rollout import QUANTITIES

MOST_GAINS = 2  # Largest number of errors that the gain names
OF_PAIRS = {
    "vehicle_alone",
    "clock_contradicted",
    "clock_undecided",
    "gusts_undecided",
}  # Open points that state the next step themselves
GAIN_HORIZON_S = 1.0  # Horizon of the rollout that the gain may name [s]


def answer_parts(verdict: Verdict) -> dict[str, tuple[Finding, ...]]:
    """Return the answer by part: result, gain, open (worse, remaining and open results), and next."""
    parts = {"result": _result_findings, "gain": _gain_findings, "open": _open_findings, "next": _next_steps}
    return {name: tuple(findings(verdict)) for name, findings in parts.items()}


def all_findings(verdict: Verdict) -> tuple[Finding, ...]:
    """Return all findings: the answer, its meaning, the notes, and the reasons why effects could not be tested."""
    parts = (finding for part in answer_parts(verdict).values() for finding in part)
    learned = () if verdict.learned is None else verdict.learned.findings
    all_of = (*parts, *trust_findings(verdict), *learned, *verdict.notes, *verdict.not_testable.values())
    return tuple(dict.fromkeys(all_of))


def trust_findings(verdict: Verdict) -> tuple[Finding, ...]:
    """Return the findings on trust: errors that the correction raises or lowers, ties, and open channels."""
    kind = verdict.verdict
    if kind == "explained" and not verdict.effects and (verdict.failures or verdict.joint_findings):
        kind = NOT_SHOWN if verdict.not_shown else "none"
    worse, better = (_errors_in_state(verdict.outcomes, state) for state in (WORSE, BETTER))
    findings = [Finding("correction_harms", "", {"errors": worse})] if worse else []
    tied = {effect.name: list(effect.ties) for effect in verdict.effects if effect.ties}
    certain = [effect.name for effect in verdict.effects if not effect.ties]
    findings += [Finding("ties_named", name, {"others": rivals}) for name, rivals in tied.items()]
    if tied and certain:
        findings.append(Finding("certain_beside_ties", "", {"effects": certain}))
    if not tied:
        findings.append(Finding("trust_as_trained" if kind == NOT_SHOWN and verdict.effects else TRUST[kind]))
    if verdict.outcomes:
        findings.append(Finding("correction_helps", "", {"errors": better}) if better else Finding("no_error_falls"))
    if verdict.not_shown and kind != NOT_SHOWN:
        findings.append(Finding("open_in_channels", "", {"channels": list(verdict.not_shown)}))
    if verdict.joint_findings:
        findings.append(Finding("rigid_vehicle_only"))
    if flights := [failure.flight for failure in verdict.failures]:
        findings.append(Finding("until_failure_only", "", {"flights": flights}))
    return tuple(findings)


TRUST = {
    "explained": "trust_corrected",
    "none": "trust_declared",
    NOT_SHOWN: "trust_as_shown",
    "unexplained": "trust_nothing",
    "ambiguous": "trust_ambiguous",
}
"""Finding on trust for each kind of verdict."""


def _errors_in_state(outcomes: Sequence[Outcome], state: str) -> list[str]:
    """Return the errors in a state, without horizon unless another horizon has the opposite state."""
    opposite = {one.quantity for one in outcomes if one.state == (BETTER if state == WORSE else WORSE)}
    names = (one.name if one.quantity in opposite else one.quantity for one in outcomes if one.state == state)
    return list(dict.fromkeys(names))


def _result_findings(verdict: Verdict) -> Iterator[Finding]:
    named = {effect.name for effect in verdict.effects}
    yield from (failure.finding for failure in verdict.failures if failure.name not in named)
    yield from verdict.joint_findings
    yield from (effect.finding for effect in verdict.effects)
    yield from notes_on_materiality(verdict.effects)
    if verdict.effects and not named <= {failure.name for failure in verdict.failures}:
        return
    if verdict.unexplained:
        yield from (
            _with_errors(verdict, point) for point in verdict.open_points if point.code == "remains_unexplained"
        )
        if verdict.verdict == "unexplained":
            yield Finding("effects_none")
    elif any(point.code in ("left_open", "floor_unknown") for point in verdict.open_points):
        yield Finding("effects_none")
    else:
        until = {"until_failure": bool(verdict.failures), "rigid": bool(verdict.joint_findings)}
        yield Finding("declared_explains", "", until)


def _with_errors(verdict: Verdict, point: Finding) -> Finding:
    """Return a finding on unexplained channels with their residuals and noise floors added."""
    rows, after = [], verdict.after
    for place, channel in enumerate(after.channels):
        if channel.name in point.values["channels"]:  # type: ignore[operator]
            unit, floor = unit_suffix(channel.unit), None if after.floor is None else after.floor[place]
            rows.append({"channel": channel.name, f"rms_{unit}": after.residual[place].value, f"floor_{unit}": floor})
    return Finding(point.code, point.subject, {**point.values, "errors": rows})


def _gain_findings(verdict: Verdict) -> Iterator[Finding]:
    if not verdict.outcomes:
        return
    if {effect.name for effect in verdict.effects} == {"gusts"}:
        yield Finding("gusts_lower_no_error")
        return
    better = sorted((one for one in verdict.outcomes if one.state == BETTER), key=lambda one: one.rise.value)
    best: dict[str, Outcome] = {}
    for one in better:
        kind, _, axis = one.quantity.partition(".")
        if (one.horizon is None and kind not in KINEMATIC) or (kind == "free" and one.horizon == GAIN_HORIZON_S):
            best.setdefault(kind if axis.isdigit() else one.quantity, one)  # only the best rotor
    ranked = sorted(best.values(), key=lambda one: one.horizon is not None)  # rollouts after channels
    errors = [
        _error_change(verdict, one) for one in ranked[:MOST_GAINS] if one.rise.value <= 0.5 * ranked[0].rise.value
    ]
    yield Finding("errors_fall", "", {"errors": errors}) if errors else Finding("no_error_falls")


def _error_change(verdict: Verdict, one: Outcome) -> dict[str, object]:
    """Return an error before and after the correction, with the interval of its relative change."""
    if one.horizon is None:
        names = [channel.name for channel in verdict.before.channels]
        place, unit = names.index(one.quantity), UNITS[one.quantity.partition(".")[0]]
        before, after = (model.residual[place] for model in (verdict.before, verdict.after))
    else:
        variant, _, quantity = one.quantity.partition(".")
        unit = QUANTITIES[quantity]
        before, after = (model.rollout[variant][quantity][one.horizon] for model in (verdict.before, verdict.after))
    key = unit_suffix(unit)
    change: dict[str, object] = {"rise": one.rise.value, "rise_low": one.rise.low, "rise_high": one.rise.high}
    if one.rise.low < 0.0 < one.rise.high and one.state in (BETTER, WORSE):
        change["flights_agree"] = True
    return {"quantity": one.name, f"before_{key}": before.value, f"after_{key}": after.value, **change}


def _open_findings(verdict: Verdict) -> Iterator[Finding]:
    for code, chosen in (
        ("error_rises", [one for one in verdict.outcomes if one.state == WORSE]),
        ("error_may_rise", [one for one in verdict.outcomes if one.is_possibly_worse]),
    ):
        if chosen:
            largest = max(chosen, key=lambda one: one.rise.value)
            more = len({one.quantity for one in chosen}) - 1
            yield Finding(code, largest.name, {**_error_change(verdict, largest), "more": more})
    result = {finding.code for finding in _result_findings(verdict)}
    for point in verdict.open_points:
        if point.code not in result:
            yield _with_errors(verdict, point) if point.code == "remains_unexplained" else point
    yield from (_rivals_in_part(effect) for effect in verdict.effects if effect.in_part)
    yield from (tie.finding for tie in verdict.value_ties if tie.is_as_simple)
    structure = verdict.structure
    if structure.kind != "none":
        values = {"channel": structure.channel, "freq_hz": structure.freq_hz, "share": structure.share}
        yield Finding("structure_found", structure.kind, values)


def _rivals_in_part(effect: NamedEffect) -> Finding:
    """Return the parameters of a named effect that others may replace, together; the notes have the numbers."""
    parts = {key: list(dict.fromkeys(getattr(one, key) for one in effect.in_part)) for key in ("parameter", "other")}
    return Finding("parameters_tied", effect.name, {"parameters": parts["parameter"], "others": parts["other"]})


def _next_steps(verdict: Verdict) -> Iterator[Finding]:
    """Yield the next steps: an experiment that decides what is open, then the robot file to use."""
    open_codes = {point.code for point in verdict.open_points}
    if open_codes & OF_PAIRS:
        return
    if verdict.verdict == "ambiguous":
        yield Finding("weigh_or_log") if verdict.manoeuvre is None else verdict.manoeuvre.finding
        return
    if "forces_not_judged" in open_codes:
        yield Finding("log_velocity")
    if verdict.verdict == "unexplained":
        kind, freq = verdict.structure.kind, verdict.structure.freq_hz
        yield Finding("inspect_rest") if kind == "none" else Finding("fly_structure", kind, {"freq_hz": freq})
        return
    if verdict.verdict == NOT_SHOWN and verdict.effects:
        yield Finding("test_like_train")
    elif verdict.corrects or verdict.joint_findings:
        yield _advice_on_robot_file(verdict)
    if "left_open" in open_codes:
        yield Finding("train_like_test", "", {"channels": list(verdict.not_shown)})
    if "floor_unknown" in open_codes:
        yield Finding("log_faster")
    if not (verdict.corrects or verdict.joint_findings or open_codes & {"left_open", "floor_unknown"}):
        yield Finding("keep_declared")
        if shows := [advice for advice in verdict.fly_next.values() if advice.fly is not None]:
            yield max(shows, key=lambda advice: advice.score).finding


def _advice_on_robot_file(verdict: Verdict) -> Finding:
    worse, better = (_errors_in_state(verdict.outcomes, state) for state in (WORSE, BETTER))
    if not worse:
        return Finding("load_robot_file")
    return Finding("keep_declared_where", "", {"errors": worse}) if better else Finding("keep_declared_for_harm")
