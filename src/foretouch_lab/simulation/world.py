# SPDX-License-Identifier: Apache-2.0
"""What all samples of a scene share (camera, fingers, the course of a campaign), and the random streams of each sample.

Each effect of each sample draws from its own random stream, so that adding an effect, or drawing more in one,
changes the numbers of no other effect, and a sample can be generated again alone on any worker.

A campaign states when each grasp is executed, which sensors are mounted, and how they drift. All of it is a function of the
scene, its seed and time alone: the paths are made once, over the whole campaign, and each grasp reads them at its own time.
So neither the number of workers nor the order in which samples are made changes a value.
"""

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from operator import attrgetter
from typing import Final, Self

import numpy as np

from foretouch.errors import SimulationError
from foretouch.tactile import ELECTRODES, FULL_SCALE
from foretouch.tactile.channels import BIOTAC
from foretouch.types import Float64, Plane
from foretouch.types.channels import Channels
from foretouch_lab.simulation.depth_scene import CameraView
from foretouch_lab.simulation.fingertip import Finger, draw_finger, ou_noise
from foretouch_lab.simulation.scene import SceneConfig
from foretouch_lab.simulation.scene import campaign as calendar
from foretouch_lab.simulation.scene.ranges import draw
from foretouch_lab.simulation.taxels import TaxelArray, TaxelConfig

CAMERA_FRAME = "camera_depth_optical_frame"


@dataclass(frozen=True)
class SampleKey:
    """Which sample: with the scene it decides every number."""

    seed: int  # of the scene
    slot: int  # place of the sample in the data set, from 0
    attempt: int = 0  # how many tries at this place have failed before, from 0
    repeat: int = 0  # how often the same grasp of the same object was executed before, from 0

    def stream(self, name: str, *, again: bool = False) -> np.random.Generator:
        """Return the stream of one effect in this sample.

        Args:
            name: Of the effect.
            again: Whether a repeat of the grasp draws other numbers.
        """
        words = (self.seed, *_words(name), self.slot, self.attempt)
        if again and self.repeat:
            words = (*words, self.repeat)
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence(words)))


@lru_cache(maxsize=256)
def _words(name: str) -> tuple[int, ...]:
    digest = hashlib.sha256(name.encode()).digest()
    return tuple(int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4))


_FINGERS: Final = ("thumb", "middle")
_CHANNELS: Final = 1 + ELECTRODES
_START_NS: Final = 1_767_603_600_000_000_000  # when the sensors are switched on for the first time, since 1970
_KNOTS: Final = 50  # a memory; the path is linear in between, where its variance is at most 1 % lower


@dataclass(frozen=True)
class CampaignTime:
    """When and at which point of the campaign a grasp is executed."""

    stamp_ns: int  # since 1970 [ns]
    time_s: float  # since the first power-on [s]
    powered_s: float  # since the last power-on [s]
    session: int  # from 0
    visit: int = 0  # how many objects were grasped before, in the whole campaign
    grasp: int = 0  # how many grasps of this object came before in succession
    speed: float = 1.0  # how much of the campaign's time passes in one second of a message's time [s/s]


def object_index(scene: SceneConfig, slot: int) -> int:
    """Return which object a slot shows: objects take turns, in a campaign visit by visit and in an order that changes.

    Args:
        scene: The scene.
        slot: Number of the sample.
    """
    count = len(scene.objects)
    if scene.campaign is None:
        return slot % count
    turn, place = divmod(slot // scene.campaign.grasps, count)
    return int(SampleKey(scene.seed, turn).stream("order of the objects").permutation(count)[place])


@dataclass(eq=False)
class Campaign:
    """One campaign."""

    config: calendar.CampaignConfig  # its settings
    scene: SceneConfig  # the scene
    first: tuple[Finger, Finger]  # thumb and middle finger as they are mounted at first

    def time_of(self, slot: int) -> CampaignTime:
        """Return when the grasp of a slot is executed; a `SimulationError` if it is beyond the last session."""
        config = self.config
        visit, grasp = divmod(slot, config.grasps)
        session, place = divmod(visit, config.objects)
        if session >= len(config.days):
            raise SimulationError(f"slot {slot}: the campaign has {config.size} grasps", "calendar")
        return self._time(session, float(self._powered_s[session][place, grasp]), visit, grasp)

    def live(self, elapsed_s: float) -> CampaignTime:
        """Return the time of a live hand that was switched on some time ago [s], and stays on until the next session."""
        time_s = self.config.live_speed * max(0.0, elapsed_s)
        starts = np.asarray(self.config.days) * calendar.DAY_S
        session = max(0, int(np.searchsorted(starts, time_s, side="right")) - 1)
        return replace(self._time(session, time_s - float(starts[session])), speed=self.config.live_speed)

    def fingers(self, session: int) -> tuple[Finger, Finger]:
        """Return thumb and middle finger as they are mounted in a session."""
        thumb, middle = (self._sensors[k][self._exchanges_before(k, session)] for k in range(2))
        return thumb, middle

    def kelvin(self, session: int, visit: int) -> tuple[Float64, float]:
        """Return (2,) temperature of both fingers at power-on, and the temperature of a visit's object minus theirs [K].

        Args:
            session: From 0.
            visit: How many objects were grasped before, in the whole campaign.
        """
        shared, *own = SampleKey(self.scene.seed, session).stream("temperature of a session").standard_normal(3)
        rng = SampleKey(self.scene.seed, visit).stream("temperature of an object")
        start = calendar.SESSION_KELVIN * shared + calendar.FINGER_KELVIN * np.array(own)
        return start, draw(rng, calendar.OBJECT_KELVIN)

    def slopes(self, session: int) -> Float64:
        """Return (2, 24) float64: counts of the electrodes that are mounted in a session per count of TDC."""
        drawn = []
        for finger, (name, mean) in enumerate(zip(_FINGERS, (calendar.SLOPE_TH, calendar.SLOPE_MF), strict=True)):
            rng = SampleKey(self.scene.seed, self._exchanges_before(finger, session)).stream(f"slopes of the {name}")
            drawn.append(mean + calendar.SLOPE_SPREAD * rng.standard_normal(ELECTRODES))
        return np.array(drawn)

    def drift(self, now: CampaignTime, times_s: Float64, load: Float64) -> Float64:
        """Return (T, 2, 25) float64 [counts]: how far PDC and electrodes of both fingers have drifted.

        Args:
            now: Of the grasp.
            times_s: (T,) float64, of the messages after that time [s].
            load: (T,) float64, 0 without contact and 1 in full contact.
        """
        at_s = now.time_s + now.speed * times_s
        total = np.zeros((len(at_s), 2, _CHANNELS))
        for (hand, sensors), term in zip(self._paths, self.config.drift, strict=True):
            share = load if term.in_contact else np.ones(len(load))
            total[..., 1:] += (share[:, None] * term.hand_counts * _interpolated(hand, term, at_s))[:, None]
            for k in range(2):
                pdc, shared, *single = _interpolated(sensors[k][self._exchanges_before(k, now.session)], term, at_s).T
                total[:, k, 0] += share * term.pdc_counts * pdc
                electrodes = term.finger_counts * shared + term.electrode_counts * np.array(single)
                total[:, k, 1:] += (share * electrodes).T
        return total

    def _time(self, session: int, powered_s: float, visit: int = 0, grasp: int = 0) -> CampaignTime:
        time_s = self.config.days[session] * calendar.DAY_S + powered_s
        return CampaignTime(_START_NS + round(time_s * 1e9), time_s, powered_s, session, visit, grasp)

    def _exchanges(self, finger: int) -> list[calendar.ExchangeConfig]:
        """Return the exchanges of one finger, in order of time."""
        return sorted((e for e in self.config.exchanges if e.finger == _FINGERS[finger]), key=attrgetter("session"))

    def _exchanges_before(self, finger: int, session: int) -> int:
        return sum(each.session <= session for each in self._exchanges(finger))

    @cached_property
    def _powered_s(self) -> list[Float64]:
        """Of each session (objects, grasps) float64: when each grasp is executed, since power-on [s]."""
        config, sessions = self.config, []
        for session in range(len(config.days)):
            rng = SampleKey(self.scene.seed, session).stream("times of a session")
            pauses = rng.uniform(*calendar.GRASP_S, (config.objects, config.grasps))
            pauses[:, 0] += rng.uniform(*calendar.CHANGE_S, config.objects)
            pauses[0, 0] = calendar.POWER_ON_S
            sessions.append(np.cumsum(pauses).reshape(pauses.shape))
        return sessions

    @cached_property
    def _sensors(self) -> tuple[list[Finger], list[Finger]]:
        """Of both fingers the fingertips that are mounted one after the other."""
        fingers = self.scene.fingers
        thumbs, middles = ([finger] for finger in self.first)
        for finger, (mounted, kind) in enumerate(((thumbs, fingers.thumb), (middles, fingers.middle))):
            for exchange in self._exchanges(finger):
                stream = SampleKey(self.scene.seed, exchange.session).stream(f"new sensor of the {exchange.finger}")
                old = mounted[-1]
                new = draw_finger(kind, stream)
                electrodes = new.electrode_rest - new.electrode_rest.mean() + old.electrode_rest.mean()
                electrodes = np.clip(electrodes + exchange.electrode_counts, 1.0, FULL_SCALE - 1.0)
                mounted.append(replace(new, pdc_rest=old.pdc_rest + exchange.pdc_counts, electrode_rest=electrodes))
        return thumbs, middles

    @cached_property
    def _paths(self) -> list[tuple[Float64, list[list[Float64]]]]:
        """Of each term the path of the hand, and those of each finger's sensors, at unit variance and equal steps."""
        paths, mounted = [], [range(1 + len(self._exchanges(finger))) for finger in range(2)]
        for number, term in enumerate(self.config.drift):
            sensors = [
                [self._path(term, number, f"drift of the {name}", _CHANNELS + 1, sensor) for sensor in own]
                for name, own in zip(_FINGERS, mounted, strict=True)
            ]
            paths.append((self._path(term, number, "drift of the hand", 1), sensors))
        return paths

    def _path(self, term: calendar.DriftTermConfig, number: int, name: str, channels: int, sensor: int = 0) -> Float64:
        end_s = self.config.days[-1] * calendar.DAY_S + self.config.longest_session_s
        knots = int(np.ceil(end_s / _distance_s(term))) + 1
        rng = SampleKey(self.scene.seed, number, sensor).stream(name)
        return ou_noise(knots, channels, 1.0, 1.0, _KNOTS, rng)


@dataclass(frozen=True, eq=False)
class World:
    """The parts of a scene that never move."""

    view: CameraView  # the camera
    rays: Float64  # (H, W, 3) float64, ray of each pixel in the world, one metre deep along the optical axis
    plane: Plane  # the table top in the camera frame, its normal towards the camera
    fingers: tuple[Finger, Finger]  # thumb and middle finger of the scene's hand, whatever its seed
    array: TaxelArray | None  # of the same hand, in their place; None for the BioTac SP
    campaign: Campaign | None  # the course of the campaign, if the scene is one

    @classmethod
    def of(cls, scene: SceneConfig) -> Self:
        """Make the world of a scene."""
        view = scene.camera.view()
        plane = Plane.from_coefficients(view.table_plane())
        hand = SampleKey(scene.fingers.hand, 0).stream("fingers of the scene")
        fingers = draw_finger(scene.fingers.thumb, hand), draw_finger(scene.fingers.middle, hand)
        sensor, stream = scene.fingers.taxel_sensor(), SampleKey(scene.fingers.hand, 0).stream("taxels of the scene")
        taxels, pad = scene.fingers.taxels or TaxelConfig(), scene.fingers.pad
        array = None if sensor is None else TaxelArray.of(sensor, taxels, pad, stream)
        campaign = Campaign(scene.campaign, scene, fingers) if scene.campaign else None
        return cls(view, view.directions(), plane, fingers, array, campaign)

    def channels(self) -> Channels:
        """Return what the values of a touch are."""
        return BIOTAC if self.array is None else self.array.sensor.channels


def _distance_s(term: calendar.DriftTermConfig) -> float:
    return term.memory_days * calendar.DAY_S / _KNOTS


def _interpolated(path: Float64, term: calendar.DriftTermConfig, at_s: Float64) -> Float64:
    """Return (T, C) of a path (K, C); the first and the last value beyond its ends."""
    place = np.clip(at_s / _distance_s(term), 0.0, len(path) - 1)
    low = np.minimum(place.astype(np.int64), len(path) - 2)
    share = (place - low)[:, None]
    return np.asarray((1.0 - share) * path[low] + share * path[low + 1])
