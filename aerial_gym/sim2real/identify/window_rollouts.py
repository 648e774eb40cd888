"""Rollouts of many models about one, side by side: the sums that a fit by output error needs.

Every window of the training flights is flown from its measured state; velocity and attitude are compared along the way. What a
window was released with is not known exactly: an error of velocity, attitude and rate at its start is fitted to each and
eliminated. The derivatives are differences of rollouts in one batch: by every parameter, by every deviation within the
tolerances, and by the start. All are about one model: by derivatives about two, an offset of the centre of mass is told apart
from what a tolerance does alike.
Letters: W windows, S samples along a window, K parameters (those of effects in units of their scale, then N tolerances).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.math.quaternion import quat_conjugate, quat_exp, quat_log, quat_multiply
from aerial_gym.physics import EFFECTS, BodyState, vehicle_from_config
from aerial_gym.sim2real.identify.least_squares.derivatives import STEP
from aerial_gym.sim2real.identify.least_squares.gauss_newton import (
    FARTHEST_DEVIATION,
    Fit,
    Frozen,
    best_step,
    prior_precision,
)
from aerial_gym.sim2real.identify.least_squares.moments import Moments
from aerial_gym.sim2real.identify.least_squares.parameters import bounds_of, is_number, params_of, scales, with_params
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.model_params import ModelParams, key_of
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.replay.rotor_commands import is_commanded, what_moves_commands, with_arriving_commands
from aerial_gym.sim2real.predict.rollout import Batch
from aerial_gym.sim2real.predict.tolerances import Deviated, deviated
from aerial_gym.sim2real.predict.windows import Windows, same_rate

Array = NDArray[np.float64]

WINDOW_S = 1.0
"""Length of a rollout [s]: the middle of the horizons at which models are judged."""

SAMPLE_S = 0.1
"""Between two comparisons [s]."""

START_STD = (0.05, 0.05, 0.05, 0.02, 0.02, 0.02, 0.05, 0.05, 0.05)
"""Errors of a start: velocity [m/s], attitude [rad], rate [rad/s]."""

NUDGE = 1e-4
"""Difference step of a start in units of its error."""


@dataclass(frozen=True, kw_only=True)
class Linear:
    """Rollouts about a model."""

    fit: Fit
    """With the sums of each window, its start eliminated; one channel."""

    weight: Array
    """What correlated samples count, (1,)."""

    raw: Moments
    """Of each window as it was released: velocity and attitude, each in units of what is left of it."""


class Rollouts:
    """Flies the windows of the training flights."""

    def __init__(self, predictor: Predictor, windows: Windows) -> None:
        self._predictor, self._windows = predictor, windows
        self._declared = vehicle_from_config(predictor.robot, num_envs=1, dtype=torch.float64)
        self._commanded = is_commanded(predictor.flights)

    def linearise(self, effects: tuple[str, ...], params: ModelParams, frozen: Frozen) -> Linear:
        """Return rollouts about a point."""
        predictor, scale = self._predictor, scales(effects)
        here, (lowest, highest) = params_of(params, effects), bounds_of(predictor.robot, effects)
        owners = [(name, place) for name in effects for place in range(len(EFFECTS.get(name).parameters))]
        points, steps = [params], []
        for k, owner in enumerate(owners):
            step = STEP if here[k] + STEP * scale[k] <= highest[k] else -STEP
            there = here.copy()
            there[k] += step * scale[k] * is_number(*owner)
            points.append(with_params(predictor.robot, params, effects, there))
            steps.append(step)
        for k in range(predictor.num_tolerances):
            deviation = np.zeros(predictor.num_tolerances) if params.deviation is None else params.deviation.copy()
            deviation[k] += STEP
            points.append(replace(params, deviation=deviation))
            steps.append(STEP)
        missed = self._fly(points)  # (1 + K + 9, W, S, 6)
        residual, count = missed[0], len(points)
        jacobian = (residual - missed[1:count]) / np.array(steps)[:, None, None, None]
        start = (residual - missed[count:]) / NUDGE
        weight = 1.0 / np.maximum((residual**2).mean(axis=0), 1e-18)
        for _ in range(3):
            sums = eliminated(residual, jacobian, start, weight)
            fit = Fit(
                effects=effects,
                params=params,
                moments=sums,
                low=np.concatenate(((lowest - here) / scale, np.full(predictor.num_tolerances, -FARTHEST_DEVIATION))),
                high=np.concatenate(((highest - here) / scale, np.full(predictor.num_tolerances, FARTHEST_DEVIATION))),
                num_effect_params=here.size,
                frozen=frozen,
            )
            counts = np.ones(1)
            for _ in range(3):
                counts = _what_it_counts(fit, counts)
            left = residual - np.einsum("kwsi,k->wsi", jacobian, best_step(fit, counts, fit.free_all))
            weight = 1.0 / np.maximum((left**2).mean(axis=0), 1e-18)
        raw = _sums(residual * np.sqrt(weight), jacobian * np.sqrt(weight))
        return Linear(fit=replace(fit, moments=self._of_flights(sums)), weight=counts, raw=self._of_flights(raw))

    def _of_flights(self, moments: Moments) -> Moments:
        return replace(moments, flight=self._windows.flight)

    def _fly(self, points: Sequence[ModelParams]) -> Array:
        """Return what is missed, of each model, and of the first one from each nudged start, (models + 9, W, S, 6).

        Measured minus flown velocity [m/s], world, and the turn from the flown to the measured attitude [rad], body.
        """
        predictor, windows = self._predictor, self._windows
        off = [deviated(self._declared, predictor.tolerances, params.deviation) for params in points]
        keys = [_moves_alike(one, params) for one, params in zip(off, points, strict=True)]
        first = [keys.index(key) for key in keys]  # what is off in sensors alone flies as the first one does
        flown = sorted(set(first))
        points, off = [points[k] for k in flown], [off[k] for k in flown]
        flights, variant = self._flights_under(points, off)
        num_models, each, num_windows = len(points), len(predictor.flights), windows.row.size
        num_samples = round(WINDOW_S / SAMPLE_S)
        of = np.concatenate((np.arange(num_models), np.zeros(len(START_STD), dtype=int)))
        nudges = np.concatenate((np.zeros((num_models, len(START_STD))), NUDGE * np.diag(START_STD)))
        vehicles, settled = [one.vehicle for one in off], [one.joint_start for one in off]
        missed = np.zeros((of.size, num_windows, num_samples, 6))
        for members in same_rate(predictor.flights, windows):
            model_of = np.repeat(of, members.size)
            flight = np.tile(windows.flight[members], of.size) + each * variant[model_of]
            row = np.tile(windows.row[members], of.size)
            run = Batch(vehicles, points, model_of, flights, flight, row, settled=settled)
            at = {run.steps(SAMPLE_S * (place + 1)): place for place in range(num_samples)}
            nudge = torch.from_numpy(nudges).repeat_interleave(members.size, dim=0)
            for step, state, truth in run.fly(_nudged(run.measured(0), nudge), at):
                turn = quat_log(quat_multiply(quat_conjugate(state.attitude), truth.attitude))
                both = torch.cat((truth.lin_vel - state.lin_vel, turn), dim=1).numpy()
                missed[:, members, at[step]] = both.reshape(of.size, members.size, 6)
        return np.concatenate((missed[[flown.index(k) for k in first]], missed[num_models:]))

    def _flights_under(
        self, points: Sequence[ModelParams], off: Sequence[Deviated]
    ) -> tuple[list[Flight], NDArray[np.int64]]:
        """Return the flights under what each model does to commands, and which of these variants each model has."""
        flights = list(self._predictor.flights)
        variants: dict[bytes, int] = {}
        found: list[Flight] = []
        which = np.zeros(len(points), dtype=np.int64)
        for place, (params, one) in enumerate(zip(points, off, strict=True)):
            key = what_moves_commands(one, params) if self._commanded else b""
            if key not in variants:
                variants[key] = len(variants)
                found += with_arriving_commands(one, flights, params) if self._commanded else flights
            which[place] = variants[key]
        return found, which


def _moves_alike(off: Deviated, params: ModelParams) -> tuple[object, ...]:
    """Return what tells rollouts of a model from those of others."""
    numbers = [rows.numpy().tobytes() for rows in off.vehicle.rows().values()]
    return (*numbers, off.command_shift, off.joint_start, key_of(replace(params, deviation=None)))


def _nudged(state: BodyState, nudge: Tensor) -> BodyState:
    """Return states with another velocity, attitude and rate: ``nudge`` is (E, 9)."""
    velocity, turn, rate = nudge.split(3, dim=1)
    return replace(
        state,
        lin_vel=state.lin_vel + velocity,
        attitude=quat_multiply(state.attitude, quat_exp(turn)),
        ang_vel=state.ang_vel + rate,
    )


def eliminated(residual: Array, jacobian: Array, start: Array, weight: Array) -> Moments:
    """Return the sums of each window (one channel) with the best error of its start in every model.

    ``M = W - W G (G^T W G + 1)^-1 G^T W`` for derivatives G by the start in units of its error.
    """
    windows = residual.shape[0]
    root = np.sqrt(weight)
    r = (residual * root).reshape(windows, -1)
    j = np.moveaxis(jacobian * root, 0, -1).reshape(windows, r.shape[1], -1)
    g = np.moveaxis(start * root, 0, -1).reshape(windows, r.shape[1], -1)
    inner = np.linalg.inv(g.transpose(0, 2, 1) @ g + np.eye(g.shape[2]))
    gr, gj = np.einsum("wna,wn->wa", g, r), g.transpose(0, 2, 1) @ j
    return Moments(
        count=np.full(windows, float(r.shape[1])),
        square=((r**2).sum(axis=1) - np.einsum("wa,wab,wb->w", gr, inner, gr))[:, None],
        gradient=(np.einsum("wnk,wn->wk", j, r) - np.einsum("wak,wab,wb->wk", gj, inner, gr))[:, None],
        product=(j.transpose(0, 2, 1) @ j - gj.transpose(0, 2, 1) @ inner @ gj)[:, None],
        flight=np.zeros(windows, dtype=np.int64),
    )


def _sums(residual: Array, jacobian: Array) -> Moments:
    """Return the sums of each window for velocity and attitude, (W, 2, ...)."""
    windows = residual.shape[0]
    r = np.stack([residual[..., :3], residual[..., 3:]], axis=1).reshape(windows, 2, -1)
    j = np.stack([jacobian[..., :3], jacobian[..., 3:]], axis=2)
    j = np.moveaxis(j.reshape(len(jacobian), windows, 2, -1), 0, -1)
    return Moments(
        count=np.full(windows, float(r.shape[2])),
        square=(r**2).sum(axis=2),
        gradient=np.einsum("wcnk,wcn->wck", j, r),
        product=j.transpose(0, 1, 3, 2) @ j,
        flight=np.zeros(windows, dtype=np.int64),
    )


def _what_it_counts(fit: Fit, weight: Array) -> Array:
    """Return the weight (1,) at which the scatter of the windows' scores is what their information says."""
    free = fit.free_effects
    if free.size == 0:
        return weight
    step = best_step(fit, weight, fit.free_all)
    scores = (fit.moments.gradient - np.einsum("wckl,l->wck", fit.moments.product, step))[:, 0, free]
    information = fit.moments.product.sum(axis=(0, 1))[np.ix_(free, free)]
    ridge = np.diag(prior_precision(fit)[free])
    return np.array([free.size / max(float(np.trace(np.linalg.solve(information + ridge, scores.T @ scores))), 1e-12)])
