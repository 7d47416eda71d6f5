# SPDX-License-Identifier: Apache-2.0
"""Imports samples into recorded datasets: from vision2tactile folders, training stores, bags with named topics, and tables by a map.

Samples that foretouch 0.2 recorded are converted to the present version. Ids of samples are kept. A new dataset appears as a whole or not at all; an existing one of the same hand and camera
is extended. From a bag without samples of foretouch, samples are assembled as the recorder does it (see
`foretouch.dataset.pairing`); clouds without a grasp that could be paired become samples without a touch.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final

from foretouch.dataset.bag import Recording, is_recording
from foretouch.dataset.files import new_folder
from foretouch.dataset.mapping import MappedSource
from foretouch.dataset.pairing.assembler import AssembledSample, AssemblerConfig, Role, SampleAssembler
from foretouch.dataset.pairing.buffers import SerializedCloud
from foretouch.dataset.pairing.cut import PairingConfig
from foretouch.dataset.pairing.matcher import RejectedGrasp
from foretouch.dataset.record import Identity, SampleRecord, readings
from foretouch.dataset.recording.sample_codec import SAMPLE_TYPES, StoredSample, decode_sample
from foretouch.dataset.recording.writer import RecordingConfig, RecordingWriter
from foretouch.dataset.samples import is_sample_set, open_samples
from foretouch.dataset.topics import CLOUD_TOPIC, EXECUTED_TOPIC, GRASPS_TOPIC, TACTILE_TOPIC, full_name
from foretouch.errors import DatasetError, FileError, TactileError
from foretouch.files import require_existing, system_errors
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor
from foretouch.tactile.messages.table import TACTILE_TYPES, TactileConfig, TactileReader, make_reader, stamp_ns

_PAIRING: Final = PairingConfig(kept_s=300.0)  # longer than live, where it costs memory of a robot
_UNKNOWN: Final = Identity(hand={"name": "unknown"}, camera={"name": "unknown"})


@dataclass(frozen=True, kw_only=True)
class BagTopics:
    """The topics of a bag that samples are assembled from, and how they are read."""

    clouds: str = full_name(CLOUD_TOPIC)  # `sensor_msgs/PointCloud2` of the objects alone (see `dataset.messages`)
    grasps: str = full_name(GRASPS_TOPIC)  # `foretouch_msgs/GraspArray`, each with the stamp of its cloud
    executed: str = full_name(EXECUTED_TOPIC)  # `foretouch_msgs/ExecutedGrasp`
    tactile: str = TACTILE_TOPIC  # tactile messages of a type in `TACTILE_TYPES`
    object: str = "unknown"  # label of the object on the table
    tactile_config: TactileConfig = TactileConfig()  # names of the fingers; its type is replaced by that of the topic

    def roles(self) -> dict[str, Role]:
        """Role by topic."""
        return {self.clouds: "cloud", self.grasps: "grasps", self.executed: "executed", self.tactile: "tactile"}


@dataclass(kw_only=True)
class ImportResult:
    """Counts of an import."""

    samples: int = 0  # samples that were imported
    labelled: int = 0  # those with a touch
    readings: int = 0  # those in their series, or a touch without one
    left_out: Counter[str] = field(default_factory=Counter)  # what was not imported, by reason
    notes: tuple[str, ...] = ()  # where the `metadata.yaml` of a bag states something else than is in its files


def import_samples(
    source: str | Path,
    out: str | Path,
    *,
    identity: Identity | None = None,
    topics: BagTopics | None = None,
    map_file: Path | None = None,
    progress: Callable[[], None] = lambda: None,
) -> ImportResult:
    """Import the samples at a path: vision2tactile folders, a store, a recorded dataset, or a bag.

    The dataset `out` is created, or extended where it is of the same hand and camera, which `identity` may give instead of
    the source; `topics` are for a bag without samples of foretouch, `map_file` for tables (see `foretouch.dataset.mapping`).

    Raises:
        FileError: If the source is damaged or holds nothing of the kind, or the dataset is of another kind.
        DatasetError: If an id is taken.
    """
    source, out = Path(source), Path(out)
    result = ImportResult()
    with ExitStack() as stack:
        if map_file is not None:
            mapped = MappedSource(require_existing(source), map_file)
            found, records, sensor = mapped.identity, mapped.records(result.left_out), mapped.sensor
        elif is_sample_set(source):
            samples = open_samples(source, convert=True)
            found, records, sensor = samples.identity, samples.records(discarded=True), samples.sensor
        elif is_recording(source):
            bag = stack.enter_context(Recording(source))
            result.notes = bag.notes
            holding = [topic.name for topic in bag.topics if topic.type in SAMPLE_TYPES]
            if holding:
                found, records, sensor = _own_samples(bag, holding)
            else:
                topics = topics or BagTopics()
                reader = _tactile_reader(bag, topics)
                found, records, sensor = _UNKNOWN, _assemble(bag, topics, reader, result), reader.sensor
        else:
            raise FileError(source, "holds no samples and is not a recording" if source.exists() else "does not exist")
        folder = out if out.exists() else stack.enter_context(new_folder(out))
        config = RecordingConfig(fsync_samples=0)  # synchronised once, at the end
        with system_errors(out), RecordingWriter(folder, identity or found, config, sensor=sensor) as writer:
            for record in records:
                writer.append(record)
                result.samples += 1
                result.labelled += record.sample.touch is not None
                result.readings += 0 if (series := readings(record)) is None else len(series.stamps_ns)
                progress()
    return result


def _own_samples(bag: Recording, topics: Sequence[str]) -> tuple[Identity, Iterator[SampleRecord], Sensor]:
    """Hand, camera and sensor of the first sample of foretouch on some topics of a bag, and all samples."""

    def _stored() -> Iterator[StoredSample]:
        for message in bag.messages(topics):
            try:
                yield decode_sample(message.data, convert=True)
            except DatasetError as err:
                raise FileError(bag.path, str(err), field=f"{message.topic}[{message.index}]") from err

    first = next(_stored(), None)
    identity, sensor = (Identity(), BIOTAC_SP) if first is None else first[1:]
    return identity, (one.record for one in _stored()), sensor


def _assemble(bag: Recording, topics: BagTopics, reader: TactileReader, result: ImportResult) -> Iterator[SampleRecord]:
    """Assemble samples as the recorder does, and a sample without a touch of every other cloud with grasps."""
    roles, live = topics.roles(), _is_live(bag, topics)
    assembler = SampleAssembler(
        AssemblerConfig(pairing=_PAIRING, object=topics.object, unlabelled_s=0.0, check_clock=live), reader
    )
    now_s = 0.0
    for message in bag.messages(roles):
        role = roles[message.topic]
        now_s = max(now_s, message.bag_time_ns * 1e-9) if live else 0.0  # otherwise grasps wait until the end
        cloud = role == "cloud"
        content = SerializedCloud(message.data, partial(bag.content, message)) if cloud else bag.content(message)
        try:
            assembler.add(role, content, received_ns=message.bag_time_ns, now_s=now_s)
        except (TactileError, DatasetError):
            result.left_out[f"unreadable {message.topic}"] += 1
        yield from _samples(assembler.poll(now_s), result)
    yield from _samples(assembler.poll(now_s, ending=True), result)
    result.left_out += assembler.rejected_clouds
    result.left_out += assembler.invalid
    result.left_out["cloud without grasps"] += assembler.clouds_without_grasps
    result.left_out["grasps without their cloud"] += len(assembler.matcher.plans)


def _samples(assembled: list[AssembledSample | RejectedGrasp], result: ImportResult) -> Iterator[SampleRecord]:
    for one in assembled:
        if isinstance(one, RejectedGrasp):
            result.left_out[one.reason] += 1
        else:
            yield one.record


def _tactile_reader(bag: Recording, topics: BagTopics) -> TactileReader:
    """The decoder of the bag's tactile messages; the default one where the bag has no such topic."""
    types = {topic.name: topic.type for topic in bag.topics}
    for name in (topics.clouds, topics.grasps):
        if name not in types:
            raise FileError(bag.path, f"no such topic; known: {', '.join(sorted(types)) or 'none'}", field=name)
    config = topics.tactile_config
    if topics.tactile in types:
        name = types[topics.tactile].replace("/msg/", "/")
        supported = [config.message_type] if config.sensor else [*TACTILE_TYPES]
        if name not in supported:
            rule = f"holds {name or 'mixed types'}; supported: {', '.join(supported)}"
            raise FileError(bag.path, rule, field=topics.tactile)
        config = config if config.sensor else config.replace(type=name)
    return make_reader(config)


def _is_live(bag: Recording, topics: BagTopics) -> bool:
    """Whether the bag was recorded live, so that its times show how far the clocks of robot and sensor differ.

    In one that was converted, or recorded from a replay or in simulated time, the robot's messages too are stamped far
    from their time of reception.
    """
    limit_ns = _PAIRING.clock_s * 1e9
    return any(
        abs(message.bag_time_ns - stamp_ns(bag.content(message).header.stamp)) <= limit_ns
        for message in bag.messages([topics.executed])
    )
