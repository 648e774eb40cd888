"""What became of the test flights: which channels and rollouts the correction makes better, which worse, and how surely.

Letters: T rows, C channels, W windows, H horizons.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.sim2real.identify.least_squares.moments import flight_of_rows, time_groups
from aerial_gym.sim2real.judge.evaluation import Evaluation, rollout_rises
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.statistics import Rise, rise_with_interval

BETTER, SAME, WORSE, NOT_SHOWN = "better", "same", "worse", "not shown"

ROLLOUTS = {"free": "rollout", "given_attitude": "rollout with given attitude"}
"""Variants of rollouts, in words."""

MOST_SAID = 5
"""Quantities that a sentence names; the others are counted."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One quantity of the test flights under the declared and the corrected model."""

    name: str
    """Of the channel, or of variant and quantity of a rollout and its horizon [s]; unique."""

    about: str
    """In words; the same for all horizons of a rollout."""

    where: str
    """The horizon, in words; empty for a channel."""

    rise: Rise
    """Of its rms, corrected over declared, with the 95 % interval over flights."""

    least: float
    """Share from which on a change is material."""

    @property
    def state(self) -> str:
        """Return what became of it.

        Same: the interval holds no material change; better or worse: it lies on one side of zero; else it is not shown.
        """
        if -self.least < self.rise.low and self.rise.high < self.least:
            return SAME
        if self.rise.high < 0.0:
            return BETTER
        return WORSE if self.rise.low > 0.0 else NOT_SHOWN

    @property
    def suspect(self) -> bool:
        """Return whether it rises by a material share, although that may be chance."""
        return self.state == NOT_SHOWN and self.rise.value >= self.least

    @property
    def text(self) -> str:
        """Return what it is and by how much it changes."""
        low, high = (f"{100.0 * end:+.0f}" for end in (self.rise.low, self.rise.high))
        return f"{self.about}{self.where} by {100.0 * self.rise.value:.0f} % [{low}, {high}]"

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        return {"state": self.state, **self.rise.as_mapping()}


def outcomes(
    predictor: Predictor,
    models: tuple[ModelParams, ModelParams],
    evaluations: tuple[Evaluation, Evaluation],
    *,
    least: float,
) -> tuple[Outcome, ...]:
    """Return what became of every channel and every rollout.

    Args:
        predictor: Test flights.
        models: The declared and the corrected one.
        evaluations: Of both on these flights.
        least: Share from which on a change is material.
    """
    return (*_channels(predictor, models, least), *_rollouts(evaluations, least))


def _channels(predictor: Predictor, models: tuple[ModelParams, ModelParams], least: float) -> Iterator[Outcome]:
    before, after = (np.concatenate(predictor.residuals(model)) for model in models)
    rises = rise_with_interval(after, before, time_groups(predictor.times), flight_of_rows(predictor.times))
    for channel, rise in zip(predictor.channels, rises, strict=True):
        yield channel_outcome(channel, rise, least)


def _rollouts(evaluations: tuple[Evaluation, Evaluation], least: float) -> Iterator[Outcome]:
    before, after = (evaluation.rollouts for evaluation in evaluations)
    for variant, errors in after.items():
        for quantity, horizon, rise in rollout_rises(errors, before[variant]):
            yield rollout_outcome(variant, quantity, horizon, rise, least)


def channel_outcome(channel: Channel, rise: Rise, least: float) -> Outcome:
    """Return what became of a channel."""
    return Outcome(name=channel.name, about=channel.words, where="", rise=rise, least=least)


def rollout_outcome(variant: str, quantity: str, horizon: float, rise: Rise, least: float) -> Outcome:
    """Return what became of one quantity of a rollout at a horizon [s]."""
    return Outcome(
        name=f"{variant}.{quantity}.{horizon:g}",
        about=f"{quantity} of the {ROLLOUTS[variant]}",
        where=f" after {horizon:g} s",
        rise=rise,
        least=least,
    )


def said_first(found: Sequence[Outcome]) -> str:
    """Return in one sentence what gets worse on the test flights, the largest first; empty if nothing does."""
    parts = []
    for start, chosen in (
        ("worse on the test flights", [one for one in found if one.state == WORSE]),
        ("perhaps worse, these flights cannot tell", [one for one in found if one.suspect]),
    ):
        if chosen:
            parts.append(f"{start}: {_listed(chosen)}")
    return "; ".join(parts)


def _listed(chosen: Sequence[Outcome]) -> str:
    """Return the quantities in words, each rollout at the horizon at which it rises most."""
    largest: dict[str, Outcome] = {}
    for one in sorted(chosen, key=lambda one: -one.rise.value):
        largest.setdefault(one.about, one)
    texts = [one.text for one in largest.values()]
    more = len(texts) - MOST_SAID
    return ", ".join(texts[:MOST_SAID]) + (f" and {more} more" if more > 0 else "")


TRUSTED = {
    "explained": "The corrected vehicle makes the flights within noise and tolerances",
    "none": "The declared vehicle makes the flights within noise and tolerances; nothing is to be corrected",
    NOT_SHOWN: (
        "The declared vehicle makes the flights as far as the training flights show it; what more test flights hold is open: "
        "train on flights that move as they do"
    ),
    "unexplained": (
        "The flights hold more than the vehicle makes, of a kind that no registered effect has: do not trust the simulator in "
        "the channels named here"
    ),
    "ambiguous": "What remains on the test flights may be an effect that the training flights do not show; fly what shows it",
}
"""What each verdict tells its reader of the model."""

NOTHING_NAMED = ("none", NOT_SHOWN)
"""Verdicts that give no name; beside one, of gusts, a failure or a joint, all is explained that training flights show."""


def doubted(ties: Mapping[str, Sequence[str]]) -> str:
    """Return which named effect may as well be another one, and which are not touched by that; empty if none may.

    Args:
        ties: Effects that would do equally well in the place of each named one.
    """
    parts = [f"{name} may as well be {' or '.join(others)}" for name, others in ties.items() if others]
    if not parts:
        return ""
    sure = [name for name, others in ties.items() if not others]
    return f"{', '.join(parts)}: fly what tells" + (f". Not touched by this doubt: {', '.join(sure)}" if sure else "")


def meaning(kind: str, found: Sequence[Outcome], ties: Mapping[str, Sequence[str]] | None = None) -> str:
    """Return what the correction makes worse on the test flights, what a verdict tells its reader, and what it helps.

    Args:
        kind: The verdict.
        found: What became of the test flights; empty where nothing is corrected.
        ties: Effects that would do equally well in the place of each named one.
    """
    told = f"{doubted(ties or {}) or TRUSTED[kind]}."
    if not found:
        return told
    worse, better = ({one.about for one in found if one.state == state} for state in (WORSE, BETTER))

    def named(state: str) -> str:
        """Return each quantity of a state; what another horizon contradicts, with its horizon."""
        texts = (one.about + one.where * (one.about in worse & better) for one in found if one.state == state)
        return ", ".join(dict.fromkeys(texts))

    harms = (
        f"The correction makes {named(WORSE)} worse: keep the declared vehicle where these matter. " if worse else ""
    )
    helps = (
        f"The correction helps in {named(BETTER)}" if better else "The correction is not seen to help in any channel"
    )
    return f"{harms}{told} {helps}."
