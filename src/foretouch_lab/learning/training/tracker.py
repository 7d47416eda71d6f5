# SPDX-License-Identifier: Apache-2.0
"""Fit the parameters of the tracker of a sensor's state to recordings with stamps, by maximum likelihood.

The readings are replayed in order of time, and the variances and time constants maximise the likelihood of the
innovations [Schweppe 1965], for each modality on its own: multiples of the calibration's B as variance of the slow
state, the fast state and the object, their time constants, the noise of tares where tares were recorded, and a multiple
of W, which also holds what drifts while an object is touched. Where TDC was recorded, the mean and the deviation of the
electrodes' slopes over it follow in a second step, with all others as found, so that readings without TDC are predicted as
without this step. The taxels of a finger are correlated and count as
5 values. Since a lab records few objects on few days, weak priors keep values that the recordings cannot determine in a
plausible range.

Where grasps are described by features, a last step finds how much touches say about similar places on the same object
(`models.similar_touches`): one length, and a ratio of variances for each modality, of a few, which make the readings that
the tracker predicts one after the other most likely. Without a gain the ratio is 0.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.optimize import nnls

from foretouch.models.calibration import CalibrationGroup
from foretouch.models.state_space import (
    FAST_TIME_S,
    KNOWN,
    NEW,
    SLOW_TIME_S,
    TARE_NOISE,
    StateFilter,
    TrackerParameters,
)
from foretouch.models.tracker import MISS_RATE, SensorTracker, innovation_statistics
from foretouch.types import Float64
from foretouch_lab.learning.prequential import TimedReadings, replay

_DAY_S, _HOUR_S = 86400.0, 3600.0
_EFFECTIVE_VALUES: Final = 5.0  # of the taxels of a finger
_ALARM_QUANTILE: Final = 0.99
_LEAST_ALARM: Final = (2.0, 0.5)  # of mean square and squared mean: below, nothing jumped
_STEP: Final = 1e-3  # of the finite differences
_ITERATIONS: Final = 25
_LENGTHS: Final = (0.35, 0.5, 1.0, 2.0)  # in deviations between grasps on one object, in each direction
_RATIOS: Final = (0.5, 1.0, 2.0, 4.0, 8.0)
_LEAST_SCALE: Final = 1e-4  # of a feature: metres, and numbers without a unit
_MOST_READINGS: Final = 800  # the newest ones, for the likelihood: seconds

# Mean of the electrodes' slopes over TDC, and logarithm of their deviation: mean and deviation of the prior, and limits.
_SLOPE_PRIOR: Final = np.array([[0.6, np.log(0.3)], [0.5, 1.0]])
_SLOPE_LIMITS: Final = np.array([[-1.0, 2.0], [np.log(0.01), np.log(2.0)]])

# Logarithms of the multiples of B, time constants, noise of tares and multiple of W: mean and deviation of the prior, and limits.
_PRIOR: Final = np.log(
    [[0.5, 0.2, 0.5, SLOW_TIME_S, FAST_TIME_S, TARE_NOISE, 1.0], [8.0, 8.0, 8.0, 2.7, 2.7, 2.7, 2.0]]
)
_LIMITS: Final = np.log(
    [*[[1e-3, 20.0]] * 3, [_DAY_S, 100.0 * _DAY_S], [0.1 * _HOUR_S, 12.0 * _HOUR_S], [1e-3, 10.0], [0.1, 2.0]]
)


def fit_tracker(recording: TimedReadings, new: CalibrationGroup, known: CalibrationGroup) -> TrackerParameters:
    """Return parameters of a tracker, from predictions of objects that were left out.

    B is used within modalities only, since its correlations across them gained nothing on the recorded objects.

    Args:
        recording: Of at least one object.
        new: Statistics of the same residuals.
        known: Of objects in the training data.
    """
    channels = new.channels
    modality = channels.modality_of_value
    own = modality[:, None] == modality
    parameters = TrackerParameters.from_calibration(
        channels,
        (np.where(own, new.between, 0.0), np.where(own, known.between, 0.0)),
        (new.within, known.within),
        (new.difference_shrinkage, known.difference_shrinkage),
        np.ones(len(channels.modalities)),
    )
    replayed = _Replay(recording.take(np.arange(len(recording.readings))[-_MOST_READINGS:]), parameters)
    solution = _least(replayed.losses, _PRIOR[0], _LIMITS, len(channels.modalities))
    slow, fast, lasting, slow_s, fast_s, tare, noise = np.exp(solution)[replayed.owner].T
    objects = parameters.object.copy()
    objects[NEW] = lasting * replayed.lasting
    states = {"slow": slow * replayed.lasting, "fast": fast * replayed.lasting, "object": objects}
    times = {"slow_time_s": slow_s, "fast_time_s": fast_s}
    fitted = replace(parameters, **states, **times, noise=parameters.noise * noise, tare_noise=tare)
    fitted = _with_intervals(fitted, recording)  # without slopes as yet, so that TDC changes no interval
    fitted = fitted if recording.tdc is None else replayed.with_slopes(fitted)
    return fitted if recording.where is None else fit_places(fitted, recording)


class _Replay:
    """Likelihood of a recording in the coordinates of a basis, each of which belongs to one modality.

    Attributes:
        owner: (D,) modality of each coordinate.
        lasting: (D,) variance of the lasting part that multiples are of.
    """

    def __init__(self, recording: TimedReadings, parameters: TrackerParameters) -> None:
        self._channels = parameters.channels
        fingers, modalities = len(self._channels.fingers), len(self._channels.modalities)
        inverse = np.linalg.inv(parameters.basis)
        self.owner = self._channels.modality_of_value[np.argmax(np.abs(parameters.basis), axis=0)]
        self.lasting = np.maximum(parameters.object[NEW], 1e-9)
        self._values = (recording.readings - recording.expected) @ inverse.T
        self._tares = None if recording.tares is None else recording.tares @ inverse.T
        self._gaps_s = np.diff(recording.stamps_ns, prepend=recording.stamps_ns[:1]) / 1e9
        self._begins = recording.begins()
        nowhere = np.full((len(recording.readings), fingers), np.nan)
        tdc = [nowhere if rows is None else rows for rows in (recording.tare_tdc, recording.tdc)]
        changes = _temperature(np.stack(tdc, axis=1).reshape(-1, fingers))
        self._temperatures = changes.reshape(-1, 2, fingers)  # (S, tare and touch, 2)
        sizes = np.bincount(self.owner, minlength=modalities)
        self._weights = np.eye(modalities)[self.owner] * np.minimum(1.0, _EFFECTIVE_VALUES / sizes)  # (D, M)

    def with_slopes(self, parameters: TrackerParameters) -> TrackerParameters:
        """Return the same parameters with the most likely slopes of the taxels of each finger."""
        fingers = len(self._channels.fingers)
        taxels = [k for k, channel in enumerate(self._channels.channel_of.values()) if channel.size > 1]
        unit = np.where(np.isin(self._channels.modality_of_value, taxels), 1.0, 0.0)
        inverse = np.linalg.inv(parameters.basis)
        mean_of, variance_of = inverse @ unit, inverse**2 @ unit
        finger = parameters.finger_of()

        def losses(tried: Float64) -> Float64:
            mean, deviation = tried[:, finger, 0] * mean_of, np.exp(tried[:, finger, 1])
            slope = np.array([mean.reshape(-1), (deviation**2 * variance_of).reshape(-1)])
            prior = np.array([parameters.slow, parameters.fast, parameters.object[NEW]])
            times = np.array([parameters.slow_time_s, parameters.fast_time_s])
            filtered = StateFilter(np.tile(prior, len(tried)), np.tile(times, len(tried)), slope)
            total = self._surprises(
                filtered, parameters.tare_noise, parameters.noise[NEW], self._temperatures[..., finger]
            )
            prior_loss = 0.5 * (((tried - _SLOPE_PRIOR[0]) / _SLOPE_PRIOR[1]) ** 2).sum(axis=2)
            return np.asarray(total[:, taxels].reshape(len(tried), -1, fingers).sum(axis=1) + prior_loss, np.float64)

        fitted = _least(losses, _SLOPE_PRIOR[0], _SLOPE_LIMITS, fingers)
        mean, deviation = fitted[self._channels.finger_of_value].T
        return replace(parameters, slope=unit * mean, slope_sd=unit * np.exp(deviation))

    def losses(self, logs: Float64) -> Float64:
        """Return (C, M) negative logarithm of the posterior of each modality, for (C, M, 7) candidates at once."""
        columns_of = np.exp(logs)[:, self.owner].reshape(-1, logs.shape[2]).T
        slow, fast, lasting, slow_s, fast_s, tare, noise = np.ascontiguousarray(columns_of)
        scale = np.tile(self.lasting, len(logs))
        filtered = StateFilter(np.array([slow, fast, lasting]) * scale, np.array([slow_s, fast_s]))
        prior = 0.5 * (((logs - _PRIOR[0]) / _PRIOR[1]) ** 2).sum(axis=2)
        return np.asarray(self._surprises(filtered, tare, noise, None) + prior, np.float64)

    def _surprises(self, filtered: StateFilter, tare: Float64, noise: Float64, temperatures: Float64 | None) -> Float64:
        """Return (C, M) negative log likelihood of each modality, for a filter of C candidates for each coordinate.

        `tare` and `noise` are variances, (C * D,) or (D,); `temperatures` are (S, 2, D) changes, at tare and touch.
        """
        count = filtered.mean.shape[1] // self._channels.size
        lasting = filtered.prior[2].copy()
        total = np.zeros(len(lasting))
        tare, noise = (np.resize(variance, len(lasting)) for variance in (tare, noise))
        for k, value in enumerate(self._values):
            x_tare, x = (None, None) if temperatures is None else np.tile(temperatures[k], count)
            filtered.advance(float(self._gaps_s[k]))
            if self._begins[k]:
                filtered.start_object(lasting)
            if self._tares is not None and np.isfinite(self._tares[k]).all():
                total += _surprise(filtered, np.tile(self._tares[k], count), tare, parts=1, x=x_tare)
            total += _surprise(filtered, np.tile(value, count), noise, parts=3, x=x)
        return np.asarray(total.reshape(count, -1) @ self._weights, np.float64)


def _temperature(tdc: Float64) -> Float64:
    """Return (S, 2) difference of TDC from its first value; the one before where none was read, 0 before the first."""
    filled = tdc.copy()
    for k in range(1, len(filled)):
        filled[k] = np.where(np.isnan(filled[k]), filled[k - 1], filled[k])
    first = [column[np.isfinite(column)][:1].sum() for column in filled.T]
    return np.asarray(np.nan_to_num(filled - first), np.float64)


def _least(losses: Callable[[Float64], Float64], start: Float64, limits: Float64, groups: int) -> Float64:
    """Return (G, P) parameters of independent groups with the least losses: (C, G) of (C, G, P) candidates.

    `start` is (P,) and `limits` (P, 2), of each group.
    """
    from scipy.optimize import minimize

    # The groups are independent: one step in the same parameter of all gives a derivative of each.
    steps = _STEP * np.eye(len(start))[:, None]

    def total(flat: Float64) -> tuple[float, Float64]:
        values = flat.reshape(groups, -1)
        all_losses = losses(np.concatenate([values[None], values + steps]))
        return float(all_losses[0].sum()), ((all_losses[1:] - all_losses[0]) / _STEP).T.reshape(-1)

    bounds, options = np.tile(limits, (groups, 1)), {"maxiter": _ITERATIONS}
    minimum = minimize(total, np.tile(start, groups), jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return np.asarray(minimum.x.reshape(groups, -1), np.float64)


def _surprise(filtered: StateFilter, value: Float64, noise: Float64, parts: int, x: Float64 | None) -> Float64:
    """Return (K,) negative log likelihood of an observation, which is then added."""
    mean, variance = filtered.predicted(parts, x)
    variance = variance + noise
    filtered.observe(value, noise, parts, x)
    return np.asarray(0.5 * ((value - mean) ** 2 / variance + np.log(variance)), np.float64)


def _with_intervals(parameters: TrackerParameters, recording: TimedReadings) -> TrackerParameters:
    """Return the factor of the intervals and the limits of the innovation test, from the recording replayed once."""
    patient = replace(parameters, alarm=np.full_like(parameters.alarm, 1e6))
    played = replay(SensorTracker(patient), recording)
    innovations = recording.readings - recording.expected - [level.offset for level in played.levels]
    scores = np.abs(recording.readings - played.counts) / played.deviation
    statistics = [innovation_statistics(row, parameters.channels) for row in innovations / played.deviation]
    _, index, counts = np.unique(recording.objects, return_inverse=True, return_counts=True)
    weights = np.broadcast_to(1.0 / counts[index][:, None], scores.shape)  # every object weighs the same
    factor = [
        np.quantile(scores[:, own], 1.0 - MISS_RATE, weights=weights[:, own], method="inverted_cdf")
        for own in parameters.channels.modality_columns.values()
    ]
    alarm = np.maximum(np.quantile(statistics, _ALARM_QUANTILE, axis=0), _LEAST_ALARM)
    return replace(parameters, factor=np.clip(factor, 0.1, 100.0), alarm=alarm)


def widen_unread(parameters: TrackerParameters, new: Float64, known: Float64) -> TrackerParameters:
    """Return the parameters with larger variances, so that intervals before any reading are about as wide as conformal ones.

    A recording in order of time says little about an error that stays with an object, or with a predictor that was given as it
    is, since the replay adapts to it. What intervals lack is added to the variance of objects, and not of the sensors: no tare
    measures it, and a tare is checked by what sensors do.

    Args:
        parameters: Fitted to a recording.
        new: (D,) conformal half widths of new objects [counts].
        known: (D,) of known ones [counts].
    """
    squared = parameters.basis**2
    factor = parameters.channels.by_modality(parameters.factor)
    objects = parameters.object.copy()
    for kind, half in ((NEW, new), (KNOWN, known)):
        states = parameters.slow + parameters.fast + objects[kind] + parameters.noise[kind]
        lacking = np.maximum((half / factor) ** 2 - squared @ states, 0.0)
        objects[kind] += nnls(squared, lacking)[0]
    return replace(parameters, object=objects)


def fit_places(parameters: TrackerParameters, recording: TimedReadings) -> TrackerParameters:
    """Return the same parameters with the most likely length and ratios of the features of grasps.

    Args:
        parameters: Of the tracker.
        recording: Of at least one object, with features of the grasps.
    """
    where, runs = np.asarray(recording.where), recording.runs()
    deviation = np.sqrt(np.mean([where[runs == run].var(axis=0) for run in np.unique(runs)], axis=0))
    unit = np.maximum(deviation, _LEAST_SCALE) * np.sqrt(len(deviation))
    recording = recording.take(np.arange(len(runs))[-_MOST_READINGS:])
    patient = replace(parameters, alarm=np.full_like(parameters.alarm, 1e6))
    count = np.array([min(own.size, _EFFECTIVE_VALUES) for own in parameters.channels.modality_columns.values()])
    none = np.zeros(len(count))
    nowhere = count * _likelihood(patient, recording)
    best, highest = parameters, -np.inf
    for length in _LENGTHS:
        tried = [replace(patient, where_scale=length * unit, where_ratio=none + ratio) for ratio in _RATIOS]
        likelihoods = np.array([nowhere, *(count * _likelihood(candidate, recording) for candidate in tried)])
        if (total := likelihoods.max(axis=0).sum()) > highest:
            ratio = np.array([0.0, *_RATIOS])[likelihoods.argmax(axis=0)]
            highest, best = total, replace(parameters, where_scale=length * unit, where_ratio=ratio)
    return best


def _likelihood(parameters: TrackerParameters, recording: TimedReadings) -> Float64:
    """Return (M,) log likelihood of a mean value of each modality, as the tracker predicts the readings one after the other."""
    played = replay(SensorTracker(parameters), recording)
    surprise = 0.5 * ((recording.readings - played.counts) / played.deviation) ** 2 + np.log(played.deviation)
    return np.asarray(-(parameters.channels.modality_means @ surprise.sum(axis=0)), np.float64)
