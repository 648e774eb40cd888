"""Selection of the report's figures and their data."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch

from aerial_gym.physics import vehicle_from_config
from aerial_gym.sim2real.identify.candidates.library import neutral_params
from aerial_gym.sim2real.identify.candidates.structure import rotate_forces_to_world
from aerial_gym.sim2real.identify.evidence.fitting import EffectSetFit
from aerial_gym.sim2real.identify.selection.select import SelectionResult
from aerial_gym.sim2real.judge.analysis import LoopResult
from aerial_gym.sim2real.judge.evaluation import ModelEvaluation
from aerial_gym.sim2real.judge.outcome import SAME
from aerial_gym.sim2real.predict.channels import KINEMATIC, Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.rows.dataset import rows_at_times
from aerial_gym.sim2real.report import plots
from aerial_gym.sim2real.report.evidence import ParameterEvidence, evidence_figure, parameter_evidence
from aerial_gym.sim2real.report.profiles import ResidualProfile, profile_quantities

MOST_REJECTED = 2  # Number of rejected effects whose evidence is plotted if none is accepted
MOST_REMAINING = 3  # Number of channels whose final residual is plotted

VARIANTS = {
    "free": "Everything simulated from the measured state at the start of a window",
    "given_attitude": "Attitude and angular velocity given by the log, position and velocity simulated",
}


def report_models(judged: LoopResult) -> dict[str, ModelParams]:
    """Return the declared model and, if it differs, the corrected one."""
    models = {"declared": judged.declared.params}
    return models | {"corrected": judged.params} if judged.verdict.corrects else models


def evidence_of_effects(judged: LoopResult) -> dict[str, list[ParameterEvidence]]:
    """Return the training flights' information about the accepted effects; without any, about the closest candidates.

    Models include the jointly fitted deviations, so that the fitted line matches the residual.
    """
    declared, selection = judged.declared, judged.selection
    models = dict.fromkeys(selection.effect_names, judged.within)
    for fitted in () if models else most_probable_single_effects(selection):
        models.setdefault(fitted.effects[0], fitted.model_with_deviations)
    untold = {effect.name: effect.frozen for effect in judged.verdict.effects}
    weight, results = selection.weights.weight, {}
    for name, params in models.items():
        neutral = neutral_params(name, declared.params, declared.stated)
        results[name] = parameter_evidence(declared.train, params, name, neutral, weight, untold.get(name, ()))
    return results


def report_figures(
    judged: LoopResult, told: Mapping[str, list[ParameterEvidence]], profiles_list: Sequence[ResidualProfile]
) -> dict[str, list[str]]:
    """Return the figures of the page by section, as HTML."""
    verdict, test = judged.verdict, judged.declared.test
    before, after = verdict.before, verdict.after if verdict.corrects else None
    models, kinds, named = report_models(judged), kinds_to_plot(judged), judged.selection.effect_names
    clouds = [
        evidence_figure(own, f"Evidence for {name}{'' if name in named else ', which is not accepted'}")
        for name, own in told.items()
    ]
    return {
        "traces": [plots.trace_figure(test, models, kind) for kind in kinds],
        "profiles": [plots.profile_figure(profiles_list, test.channels, kind) for kind in kinds],
        "evidence": clouds,
        "bars": figures_of_errors(before, after),
        "rest": [plots.residual_figure(parts, channel) for channel, parts in residuals_to_plot(judged)],
    }


def figures_of_errors(before: ModelEvaluation, after: ModelEvaluation | None) -> list[str]:
    """Return the figures of residuals and rollout errors of one or two models, as HTML."""
    variants = [
        plots.rollout_bars(before, after, name, title) for name, title in VARIANTS.items() if name in before.rollout
    ]
    return [plots.residual_bars(before, after), *variants]


def kinds_to_plot(judged: LoopResult) -> list[str]:
    """Return the plotted kinds of channels: those with dynamics, and kinematic ones that the correction changes."""
    changed = {one.name for one in judged.verdict.outcomes if one.state != SAME}
    drawn = [c.kind for c in judged.declared.channels if c.kind not in KINEMATIC or c.name in changed]
    return list(dict.fromkeys(drawn))


def residuals_to_plot(judged: LoopResult) -> list[tuple[Channel, list[plots.FlightResidual]]]:
    """Return the corrected model's residual in the unexplained channels, or in the one farthest above its noise floor."""
    channels, after, results = judged.declared.channels, judged.verdict.after, []
    dynamic = [place for place, channel in enumerate(channels) if channel.kind not in KINEMATIC]
    named = [place for place in dynamic if channels[place].name in judged.verdict.unexplained]
    floor = after.floor or (1.0,) * len(channels)
    above = {place: after.residual[place].value / max(floor[place], 1e-300) for place in named or dynamic}
    order = sorted(above, key=lambda place: -above[place])
    left = [
        (predictor, predictor.residuals(judged.params)) for predictor in (judged.declared.train, judged.declared.test)
    ]
    vehicle = vehicle_from_config(judged.declared.robot, num_envs=1, dtype=torch.float64)
    for place in order[: MOST_REMAINING if named else 1]:
        parts = []
        for predictor, residuals in left:
            for flight, time, residual in zip(predictor.flights, predictor.times, residuals, strict=True):
                turned = rotate_forces_to_world(flight, time, residual, channels)
                against = {"time [s]": time, **profile_quantities(flight, time, vehicle, judged.declared.bandwidth)}
                if flight.position is not None:
                    x, y, _ = flight.position[rows_at_times(flight, time)].T
                    against |= {"x [m]": x, "y [m]": y}
                parts.append(plots.FlightResidual(time, residual[:, place], turned[:, place], against))
        results.append((channels[place], parts))
    return results


def most_probable_single_effects(selection: SelectionResult) -> list[EffectSetFit]:
    """Return the most probable fitted sets with a single effect, for a report without accepted effects."""
    fits = [one for one in selection.fits if len(one.effects) == 1 and not one.structures]
    return [one for one in fits if np.isfinite(one.log_posterior)][:MOST_REJECTED]
