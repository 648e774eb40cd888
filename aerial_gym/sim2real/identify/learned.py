"""Learned residual: a small network for forces without a known effect, accepted only by left-out flights.

It predicts the remaining accelerations, times mass and inertia, from the felt motion; turned sensor axes are neglected.
Letters: T rows of all flights, B time blocks, C channels, D inputs, O outputs in the flights, H hidden units.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from scipy.optimize import minimize

from aerial_gym.config.learned_residual import LayerCfg, LearnedResidualCfg
from aerial_gym.errors import ConfigError
from aerial_gym.physics import build_model, vehicle_from_config
from aerial_gym.physics.effects import LearnedResidual
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.findings import Finding, finding_on_refusal
from aerial_gym.sim2real.identify.least_squares.moments import Weighting, block_length, time_blocks
from aerial_gym.sim2real.identify.selection.criteria import Criteria
from aerial_gym.sim2real.logs.recording import flight_numbers
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams, expand_effects
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.statistics import student_tail

OUTPUTS = tuple(f"{kind}.{axis}" for kind in ("specific_force", "angular_acceleration") for axis in "xyz")
"""Channels in the order of the network's outputs."""

HIDDEN = 16  # Units H of the one hidden layer
DECAYS = (1e-3, 3e-3, 1e-2, 3e-2, 1e-1)  # Tested weight decays, relative to a mean square of order one
STEPS = 200  # Largest number of L-BFGS iterations
LEAST_SHARE = 0.1  # Least explained share of an output's mean square on left-out flights; otherwise the output is zero
TAIL = 0.01  # Share of training rows outside each input limit, and outside the distance of full trust
RIDGE = 1e-2  # Added to the covariance of standardised inputs, so that nearly constant ones may vary by a tenth
DIGITS = 6  # Significant digits in the robot file; float32 has seven
QUARTERS = 4  # Number of folds of a single flight, and most folds that choose the weight decay


@dataclass(frozen=True, kw_only=True)
class Gain:
    """Gain of one model over another on flights left out."""

    p_value: float  # Probability of a gain this large by chance
    flights_better: float  # Share of the flights that are predicted better, among those in which anything changes
    falls: tuple[float, ...]  # Relative fall of the residual (rms) of each channel, over all flights
    harmed: tuple[float, ...]  # Share of the flights in which the residual of each channel rises
    worse: tuple[bool, ...]  # Whether the residual of each channel rises over all flights
    visible: tuple[bool, ...]  # Least fall of a residual (rms), as a share of that from tolerances


@dataclass(frozen=True, kw_only=True)
class CrossValidation:
    """Cross-validation that leaves out one flight after the other."""

    count: Array  # Rows of each block of time, (B,)
    flight: Indices  # Number of the flight of each block, (B,)
    quarter: Indices  # Quarter of its log in which each block lies, (B,)
    weights: Weighting
    criteria: Criteria
    channels: tuple[Channel, ...]
    tolerated: Array  # Residual (rms) that the tolerances of the vehicle cause in each channel, (C,)

    @property
    def fold_of_blocks(self) -> Indices:
        """Return the fold of each block: its flight, or a quarter of a single flight, (B,)."""
        if self.flight.max() > 0:
            return self.flight
        return self.quarter

    def gain(self, less: Array, more: Array) -> Gain:
        """Return the gain of the larger model, by left-out squares (B, C) of the smaller (``less``) and larger (``more``) one.

        The score is ``sum n_c / 2 log(MS_less / MS_more)`` with n independent samples; the p-value is of a t-test on its
        blocks.
        """
        count, effective = self.count, self.weights.effective
        folds = [self.fold_of_blocks == part for part in np.unique(self.fold_of_blocks)]
        blocks = (0.5 * count[:, None] * effective * _log_ratio(less, more)).sum(axis=1)
        spread = blocks.std(ddof=1) / np.sqrt(blocks.size) if blocks.size > 1 else np.inf
        concerned = [part for part in folds if self._has_changed(less[part], more[part])]
        judged = concerned if len(concerned) > 1 else folds
        totals = [self._log_likelihood_gain(less[part], more[part], count[part]) for part in judged]
        rises = [self._has_harmful_rise(less[part], more[part], count[part]) for part in folds]
        fallen = (less - more).sum(axis=0) / count.sum()
        return Gain(
            p_value=student_tail(blocks.mean() / max(spread, 1e-300), max(blocks.size - 1, 1)),
            flights_better=float(np.mean([total > 0.0 for total in totals])),
            falls=tuple((1.0 - np.exp(-0.5 * _log_ratio(less.sum(axis=0), more.sum(axis=0)))).tolist()),
            harmed=tuple(np.mean(rises, axis=0).tolist()),
            worse=tuple(self._has_harmful_rise(less, more, count).tolist()),
            visible=tuple((fallen > (self.criteria.visible * self.tolerated) ** 2).tolist()),
        )

    def objections(self, gain: Gain) -> list[Finding]:
        """Return the reasons why a gain on flights left out does not count."""
        rules, gains = self.criteria, []
        if gain.p_value > rules.left_out_significance:
            gains.append(Finding("gain_by_chance", "", {"p_value": gain.p_value}))
        if gain.flights_better < rules.flights_better:
            gains.append(Finding("few_flights_better", "", {"share": gain.flights_better}))
        if max(fall * seen for fall, seen in zip(gain.falls, gain.visible, strict=True)) < rules.material:
            gains.append(Finding("gain_small", "", {"share": max(*gain.falls, 0.0)}))
        return [*gains, *self.findings_on_harm(gain)]

    def findings_on_harm(self, gain: Gain) -> list[Finding]:
        """Return the channel that is harmed most, over all flights or in too many of them; empty if none is."""
        if any(gain.worse):
            place = int(np.argmin(np.where(gain.worse, gain.falls, np.inf)))
            return [Finding("channel_worse", self.channels[place].name, {"share": -gain.falls[place]})]
        if max(gain.harmed) > 1.0 - self.criteria.flights_better:
            place = int(np.argmax(gain.harmed))
            return [Finding("channel_worse_in_flights", self.channels[place].name, {"share": gain.harmed[place]})]
        return []

    def _log_likelihood_gain(self, less: Array, more: Array, count: Array) -> float:
        samples = count.sum() * self.weights.effective
        return float((0.5 * samples * _log_ratio(less.sum(axis=0), more.sum(axis=0))).sum())

    def _has_changed(self, less: Array, more: Array) -> bool:
        """Return whether squares (B, C) differ in any channel by more than ``harmless``; hover, for example, shows no drag."""
        ratio = np.abs(_log_ratio(less.sum(axis=0), more.sum(axis=0)))
        return bool(np.any(ratio > 2.0 * np.log1p(self.criteria.harmless)))

    def _has_harmful_rise(self, less: Array, more: Array, count: Array) -> Flags:
        """Return whether the sum of squares (B, C) of each channel rises harmfully, (C,).

        Such a rise exceeds a small share of the residual, that of the tolerances, and a small share of the total gain: the
        fit of a large effect may harm a small channel as long as the model lacks others.
        """
        less, more, rows, rules = less.sum(axis=0), more.sum(axis=0), count.sum(), self.criteria
        gains = 0.5 * rows * self.weights.effective * _log_ratio(less, more)
        beyond_share = more > (1.0 + rules.harmless) ** 2 * less
        beyond_tolerances = more - less > np.maximum(rows, 1.0) * self.tolerated**2
        return beyond_share & beyond_tolerances & (-gains > rules.forgiven * np.maximum(gains.sum(), 0.0))


def leave_out_flights(
    predictor: Predictor, weights: Weighting, criteria: Criteria, tolerated: Array
) -> CrossValidation:
    """Return the cross-validation over the flights of a predictor; ``tolerated``: residual (rms) from tolerances, (C,)."""
    blocks = time_blocks(predictor.times, block_length(predictor.times))
    count, log = np.array([float(rows.size) for _, rows in blocks]), np.array([index for index, _ in blocks])
    sizes = np.bincount(log)
    quarter = np.concatenate([np.arange(size) * min(QUARTERS, size) // size for size in sizes])
    flight = flight_numbers(predictor.flights)[log]
    judged = {"weights": weights, "criteria": criteria, "channels": predictor.channels, "tolerated": tolerated}
    return CrossValidation(count=count, flight=flight, quarter=quarter, **judged)


def _log_ratio(less: Array, more: Array) -> Array:
    return np.log(np.maximum(less, 1e-300) / np.maximum(more, 1e-300))


@dataclass(frozen=True, kw_only=True)
class ResidualFit:
    """Result of the training of a learned residual."""

    cfg: LearnedResidualCfg | None  # Network for the robot file; None if rejected
    objections: tuple[Finding, ...]  # Reasons for the rejection; empty if accepted
    gain: Gain | None = None  # Improvement over the named effects on left-out training flights
    gaps: dict[str, float | None] = field(
        default_factory=dict
    )  # Share of the gap above the noise floor on test flights
    named_gaps: dict[str, float | None] = field(default_factory=dict)  # Share of the same gap that named effects close
    rows: int = 0  # Number of compared rows of the test flights
    rows_outside: int = 0  # Number of these rows outside the training data

    @property
    def effect(self) -> LearnedResidual | None:
        """Return the effect for the simulator; None if rejected."""
        return None if self.cfg is None else LearnedResidual(self.cfg)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Return the findings on acceptance with shares, or on rejection with reasons."""
        if self.cfg is None:
            return (finding_on_refusal("learned_refused", LearnedResidual.name, self.objections),)
        rows = {"rows": self.rows, "rows_outside": self.rows_outside}
        own, named = (
            {name: share for name, share in gaps.items() if share is not None} for gaps in (self.gaps, self.named_gaps)
        )
        shares = {"shares": own, "named_shares": named}
        return Finding("learned_added", LearnedResidual.name, rows), Finding("learned_share", "", shares)

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON, as an effect without parameters."""
        return {
            "name": LearnedResidual.name,
            "params": {},
            "std": {},
            "interval": {},
            "noise_std": {},
            "frozen": [],
            "confidence": 0.0 if self.gain is None else 1.0 - self.gain.p_value,
            "material": True,
            "share_of_gap": self.gaps,
            "share_of_gap_by_named_effects": self.named_gaps,
            "rows": self.rows,
            "rows_outside": self.rows_outside,
        }


def train_residual(
    predictor: Predictor, params: ModelParams, left_out: CrossValidation, *, seed: int = 0
) -> ResidualFit:
    """Return a network for the training flights' residual, or its rejection; raise ``ConfigError`` if there is one."""
    if params.learned is not None:
        raise ConfigError(
            "the robot file already has a learned_residual, but named effects come first. Remove it to train a new one"
        )
    if any(flight.lin_vel is None for flight in predictor.flights):
        return ResidualFit(cfg=None, objections=(Finding("no_velocity"),))
    if not {channel.name for channel in predictor.channels} & set(OUTPUTS):
        return ResidualFit(cfg=None, objections=(Finding("no_force"),))
    trainer = _Trainer(predictor, params, left_out, seed)
    decay, errors = trainer.best_decay()
    if not (errors < 1.0 - LEAST_SHARE).all():
        trainer.keep_outputs(errors < 1.0 - LEAST_SHARE)
        if not trainer.outputs:
            most = max(0.0, 1.0 - float(errors.min()))
            return ResidualFit(cfg=None, objections=(Finding("share_small", "", {"share": most}),))
    gain = trainer.gain(decay)
    if objections := left_out.objections(gain):
        return ResidualFit(cfg=None, objections=tuple(objections), gain=gain)
    return ResidualFit(cfg=trainer.network_config(trainer.train(decay)), objections=(), gain=gain)


def add_test_shares(
    learned: ResidualFit, predictor: Predictor, models: tuple[ModelParams, ModelParams], floor: Array | None
) -> ResidualFit:
    """Return the result with the shares of the test flights' excess error that the learned residual and named effects remove.

    ``models``: declared and named model; the excess is that of the declared one over the noise ``floor`` (C,).
    """
    if learned.effect is None:
        return learned
    params = models[1]
    steps = (*models, replace(params, learned=learned.effect))
    first, less, more = (np.mean(np.square(np.concatenate(predictor.residuals(one))), axis=0) for one in steps)
    gap = first - (0.0 if floor is None else np.square(floor))
    places = [c for c, channel in enumerate(predictor.channels) if channel.name in OUTPUTS]
    names = [predictor.channels[c].name for c in places]
    gaps, named_gaps = (
        {name: float(fall[c] / gap[c]) if gap[c] > 0.0 else None for name, c in zip(names, places, strict=True)}
        for fall in (less - more, first - less)
    )
    felt = torch.from_numpy(np.concatenate(predictor.residual_inputs(params)))
    outside = int((learned.effect.distance(felt) > 1.0).sum())
    return replace(learned, gaps=gaps, named_gaps=named_gaps, rows=felt.shape[0], rows_outside=outside)


@dataclass(frozen=True)
class _Layers:
    """A network from standardised inputs to standardised outputs; columns of rows, because they are faster here."""

    weights: Array  # (H, D)
    bias: Array  # (H,)
    output: Array  # (O, H)
    offset: Array  # (O,)

    def __call__(self, inputs: Array) -> Array:
        """Return the outputs (O, T) for inputs (D, T)."""
        return self.output @ self._activations(inputs) + self.offset[:, None]

    def _activations(self, inputs: Array) -> Array:
        return np.tanh(self.weights @ inputs + self.bias[:, None])

    def as_vector(self) -> Array:
        """Return all numbers as a vector."""
        return np.concatenate([part.ravel() for part in vars(self).values()])

    def from_vector(self, numbers: Array) -> "_Layers":
        """Return layers of the same shapes from a vector."""
        parts = list(vars(self).values())
        cuts = np.split(numbers, np.cumsum([part.size for part in parts])[:-1])
        return _Layers(*(cut.reshape(part.shape) for cut, part in zip(cuts, parts, strict=True)))

    def loss_and_gradient(self, inputs: Array, targets: Array, decay: float) -> tuple[float, Array]:
        """Return the mean square error plus ``decay`` times the squared weights, and its gradient by ``as_vector``."""
        hidden = self._activations(inputs)
        error = self.output @ hidden + self.offset[:, None] - targets
        squares = np.square(self.weights).sum() + np.square(self.output).sum()
        value = np.square(error).mean() + decay * squares
        error *= 2.0 / error.size
        back = (self.output.T @ error) * (1.0 - np.square(hidden))
        weights, output = (
            sums + 2.0 * decay * part
            for sums, part in ((back @ inputs.T, self.weights), (error @ hidden.T, self.output))
        )
        return float(value), _Layers(weights, back.sum(axis=1), output, error.sum(axis=1)).as_vector()


class _Trainer:
    """Standardised rows of the training flights, and fits on them."""

    def __init__(self, predictor: Predictor, params: ModelParams, left_out: CrossValidation, seed: int) -> None:
        self._predictor, self._point, self._left_out, self._seed = predictor, params, left_out, seed
        self._felt = np.concatenate(predictor.residual_inputs(params))
        self._residual = np.concatenate(predictor.residuals(params))
        names = [channel.name for channel in predictor.channels]
        self.outputs = [k for k, name in enumerate(OUTPUTS) if name in names]
        target = self._residual[:, [names.index(OUTPUTS[k]) for k in self.outputs]]
        self._size = np.maximum(np.sqrt(np.mean(target**2, axis=0)), 1e-12)
        self._low, self._high = np.quantile(self._felt, (TAIL, 1.0 - TAIL), axis=0)
        self._centre, self._scale = self._felt.mean(axis=0), np.maximum(self._felt.std(axis=0), 1e-6)
        self._inputs = ((np.clip(self._felt, self._low, self._high) - self._centre) / self._scale).T.copy()
        self._targets = (target / self._size).T.copy()
        self._count = left_out.count.astype(int)
        self._fold = np.repeat(left_out.fold_of_blocks, self._count)

    def keep_outputs(self, chosen: Flags) -> None:
        """Restrict the network to the chosen outputs; others stay zero."""
        self.outputs = [k for k, kept in zip(self.outputs, chosen, strict=True) if kept]
        self._size, self._targets = self._size[chosen], self._targets[chosen]

    def train(self, decay: float, leave: Flags | None = None) -> _Layers:
        """Return the layers of least loss on all rows, or without some rows (T,)."""
        inputs, targets = self._inputs, self._targets
        if leave is not None:
            inputs, targets = inputs[:, ~leave], targets[:, ~leave]
        width, outputs = len(inputs), len(targets)
        rng = np.random.default_rng(self._seed)
        start = _Layers(
            rng.normal(size=(HIDDEN, width)) / width**0.5,
            np.zeros(HIDDEN),
            rng.normal(size=(outputs, HIDDEN)) / HIDDEN,
            np.zeros(outputs),
        )

        def loss(numbers: Array) -> tuple[float, Array]:
            return start.from_vector(numbers).loss_and_gradient(inputs, targets, decay / outputs)

        optimum = minimize(loss, start.as_vector(), jac=True, method="L-BFGS-B", options={"maxiter": STEPS})
        return start.from_vector(optimum.x)

    def best_decay(self) -> tuple[float, Array]:
        """Return the decay with the least error on left-out flights, and the relative mean squares there, (O,)."""
        errors = {decay: self._left_out_errors(decay) for decay in DECAYS}
        best = min(DECAYS, key=lambda decay: np.minimum(errors[decay], 1.0).sum())
        return best, errors[best]

    def _left_out_errors(self, decay: float) -> Array:
        squares = np.zeros(len(self.outputs))
        for leave in np.arange(min(QUARTERS, self._fold.max() + 1)):
            rows = self._fold % QUARTERS == leave  # flights in turn, so that flights of one kind are in different folds
            optimum = self.train(decay, rows)(self._inputs[:, rows])
            squares += np.square(optimum - self._targets[:, rows]).sum(axis=1)
        return squares / np.square(self._targets).sum(axis=1)

    def gain(self, decay: float) -> Gain:
        """Return the gain on left-out folds, from the simulator's prediction with networks not trained on them."""
        optimum = self._residual.copy()
        for leave in np.unique(self._fold):
            rows = self._fold == leave
            effect = LearnedResidual(self.network_config(self.train(decay, rows)))
            optimum[rows] = np.concatenate(self._predictor.residuals(replace(self._point, learned=effect)))[rows]
        return self._left_out.gain(self._block_squares(self._residual), self._block_squares(optimum))

    def _block_squares(self, residual: Array) -> Array:
        """Return the sums of squares of each block, (B, C)."""
        return np.add.reduceat(residual**2, np.concatenate(([0], np.cumsum(self._count)[:-1])), axis=0)

    def network_config(self, layers: _Layers) -> LearnedResidualCfg:
        """Return the network for force and torque, with its limits, from layers for standardised accelerations."""
        model = build_model(
            vehicle_from_config(self._predictor.robot, num_envs=1, dtype=torch.float64), expand_effects(self._point, 1)
        )
        to_wrench = np.zeros((6, 6))
        to_wrench[:3, :3] = model.vehicle.mass.item() * np.eye(3)
        to_wrench[3:, 3:] = model.vehicle.inertia[0].numpy()
        to_wrench = to_wrench[:, self.outputs] * self._size
        physical = replace(layers, output=to_wrench @ layers.output, offset=to_wrench @ layers.offset)
        return LearnedResidualCfg(
            low=_round_numbers(self._low),
            high=_round_numbers(self._high),
            centre=_round_numbers(self._centre),
            scale=_round_numbers(self._scale),
            whitening=_round_rows(self._whitening()),
            hidden=(LayerCfg(weights=_round_rows(layers.weights), bias=_round_numbers(layers.bias)),),
            output=LayerCfg(weights=_round_rows(physical.output), bias=_round_numbers(physical.offset)),
            limit=_round_numbers(np.abs(physical(self._inputs)).max(axis=1)),
            source=f"aerial-gym close-loop on the flights {', '.join(flight.name for flight in self._predictor.flights)}",
        )

    def _whitening(self) -> Array:
        """Return the whitening matrix (D, D) for which the share ``TAIL`` of the rows has a norm above 1."""
        standard = (self._felt - self._centre) / self._scale
        covariance = standard.T @ standard / len(standard) + RIDGE * np.eye(standard.shape[1])
        white = np.linalg.inv(np.linalg.cholesky(covariance))
        return white / np.quantile(np.linalg.norm(standard @ white.T, axis=1), 1.0 - TAIL)


def _round_numbers(values: Array | Sequence[float]) -> tuple[float, ...]:
    return tuple(float(f"{value:.{DIGITS}g}") for value in values)


def _round_rows(rows: Array) -> tuple[tuple[float, ...], ...]:
    return tuple(_round_numbers(row) for row in rows)
