# SPDX-License-Identifier: Apache-2.0
"""Import samples into recorded datasets: from vision2tactile folders, training stores, and bags with named topics.

Tables of others are written by `foretouch.write` (see `examples/import_*.py`). Ids of samples are kept. A new dataset appears as a whole or not at all; an existing one of the same hand and camera
is extended. From a bag without samples of foretouch, samples are assembled as the recorder does it (see
`foretouch.dataset.labelling`); clouds without a grasp that could be paired become samples without a touch.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final

from foretouch.cloud.messages import decode_objects
from foretouch.cloud.segmentation.segment import segment
from foretouch.dataset.formats import is_sample_set, open_samples
from foretouch.dataset.identity import Identity
from foretouch.dataset.labelling.assembler import AssemblerConfig, Role, SampleAssembler
from foretouch.dataset.labelling.buffers import SeenObjects
from foretouch.dataset.labelling.cut import PairingConfig
from foretouch.dataset.labelling.matcher import RejectedGrasp
from foretouch.dataset.recordings.bag import Message, Recording, is_recording
from foretouch.dataset.recordings.sample_codec import SAMPLE_TYPES, StoredSample, decode_sample
from foretouch.dataset.writing import WriteResult, write_records
from foretouch.errors import CloudError, DatasetError, FileError, TactileError
from foretouch.tactile.channels import BIOTAC_SP
from foretouch.tactile.description import Sensor
from foretouch.tactile.messages.readers import make_reader
from foretouch.tactile.messages.table import TACTILE_TYPES, TactileConfig, TactileReader
from foretouch.topics import CLOUD_TOPIC, EXECUTED_TOPIC, GRASPS_TOPIC, TABLE_TOPIC, TACTILE_TOPIC, full_name
from foretouch.types import Cloud, Sample, stamp_ns
from foretouch.types.scene import Object

_PAIRING: Final = PairingConfig(kept_s=300.0)  # longer than live, where it costs memory of a robot
_UNKNOWN: Final = Identity(hand={"name": "unknown"}, camera={"name": "unknown"})


@dataclass(frozen=True, kw_only=True)
class BagTopics:
    """The topics of a bag that samples are assembled from, and how they are read."""

    # `sensor_msgs/PointCloud2` of the objects alone (see `dataset.messages`); or depth images, which are segmented. Where the
    # default is absent, the only topic of depth images
    clouds: str = full_name(CLOUD_TOPIC)
    table: str = full_name(TABLE_TOPIC)  # `foretouch_msgs/TablePlane` of the clouds of objects, if there is one
    grasps: str = full_name(GRASPS_TOPIC)  # `foretouch_msgs/GraspArray`, each with the stamp of its cloud
    executed: str = full_name(EXECUTED_TOPIC)  # `foretouch_msgs/ExecutedGrasp`
    tactile: str = TACTILE_TOPIC  # tactile messages of a type in `TACTILE_TYPES`
    object: str = "unknown"  # label of the object on the table
    tactile_config: TactileConfig = TactileConfig()  # names of the fingers; its type is replaced by the topic's type

    def roles(self) -> dict[str, Role]:
        """Return the role of each topic."""
        return {
            self.clouds: "cloud",
            self.table: "table",
            self.grasps: "grasps",
            self.executed: "executed",
            self.tactile: "tactile",
        }


def import_samples(
    source: str | Path,
    out: str | Path,
    *,
    identity: Identity | None = None,
    topics: BagTopics | None = None,
    progress: Callable[[], None] = lambda: None,
) -> WriteResult:
    """Import the samples at a path: vision2tactile folders, a store, a recorded dataset, or a bag.

    Args:
        source: What is imported.
        out: The dataset, which is created, or extended where it is of the same hand and camera.
        identity: Hand and camera, instead of what the source states.
        topics: Of a bag without samples of foretouch; refused for other sources.
        progress: Called once a sample.

    Raises:
        FileError: If the source is damaged or holds nothing of the kind, or the dataset is of another kind.
        DatasetError: If an id is taken.
    """
    source, out = Path(source), Path(out)
    result = WriteResult()
    with ExitStack() as stack:
        if is_sample_set(source):
            _require_none(source, topics)
            samples = open_samples(source)
            stated = samples.identity
            records = samples.with_discarded()
            sensor = samples.sensor
        elif is_recording(source):
            bag = stack.enter_context(Recording(source))
            result.notes = tuple(bag.notes)
            holding = [topic.name for topic in bag.topics if topic.type in SAMPLE_TYPES]
            if holding:
                _require_none(source, topics)
                stated, records, sensor = _own_samples(bag, holding)
            else:
                topics = _with_clouds(bag, topics or BagTopics())
                reader = _tactile_reader(bag, topics)
                stated = _UNKNOWN
                records = _assemble(bag, topics, reader, result)
                sensor = reader.sensor
        else:
            raise FileError(source, _not_imported(source))
        write_records(out, records, identity or stated, sensor, result, progress)
    return result


def _require_none(source: Path, topics: BagTopics | None) -> None:
    """Refuse names of topics and fingers for a source that states its own."""
    if topics is not None:
        rule = "holds samples: topics, sensor, fingers and object are for bags without (--topic, --sensor, --thumb, --middle, --object)"
        raise FileError(source, rule)


def _not_imported(source: Path) -> str:
    """Return why a source is none, and what reads it instead."""
    if not source.exists():
        return "does not exist"
    if (source / "meta" / "info.json").is_file():
        return (
            "is a LeRobot dataset of other features: write it with foretouch.write, as examples/import_lerobot.py does"
        )
    tables = (".csv", ".parquet", ".npz", ".h5", ".hdf5")
    if any(file.suffix.lower() in tables for file in ([source] if source.is_file() else source.rglob("*"))):
        return "holds tables: read them with pandas or h5py and write them with foretouch.write, as examples/import_*.py do"
    return "holds no samples and is not a recording"


def _own_samples(bag: Recording, topics: Sequence[str]) -> tuple[Identity, Iterator[Sample], Sensor]:
    """Read hand, camera and sensor of the first sample of foretouch on some topics of a bag, and all samples."""

    def _stored() -> Iterator[StoredSample]:
        for message in bag.messages(topics):
            try:
                yield decode_sample(message.data)
            except DatasetError as err:
                raise FileError(bag.path, str(err), field=f"{message.topic}[{message.index}]") from err

    first = next(_stored(), None)
    identity, sensor = (Identity(), BIOTAC_SP) if first is None else first[1:]
    return identity, (stored.sample for stored in _stored()), sensor


def _assemble(bag: Recording, topics: BagTopics, reader: TactileReader, result: WriteResult) -> Iterator[Sample]:
    """Assemble samples as the recorder does, and a sample without a touch of every other cloud with grasps."""
    roles, live = topics.roles(), _is_live(bag, topics)
    assembler = SampleAssembler(
        AssemblerConfig(pairing=_PAIRING, object=topics.object, unlabelled_s=0.0, check_clock=live), reader
    )
    now_s = 0.0
    beside = bag.info_topic(topics.clouds)
    for message, decode in bag.clouds(topics.clouds, roles):
        role = roles[message.topic]
        now_s = max(now_s, message.bag_time_ns * 1e-9) if live else 0.0  # otherwise grasps wait until the end
        objects = partial(_objects_in, bag, message, decode if beside else None)
        content = None if role == "cloud" else decode()
        try:
            content = content or SeenObjects.of_message(message.data, objects, by_place=bool(beside))
            assembler.add(role, content, received_ns=message.bag_time_ns, now_s=now_s)
        except (TactileError, DatasetError, CloudError):
            result.left_out[f"unreadable {message.topic}"] += 1
        yield from _samples(assembler.poll(now_s), result)
    yield from _samples(assembler.poll(now_s, ending=True), result)
    result.left_out += assembler.rejected_clouds
    result.left_out += assembler.invalid
    result.notes = (*result.notes, *bag.remarks(topics.clouds))
    result.left_out["cloud without grasps"] += assembler.clouds_without_grasps
    result.left_out["grasps without their cloud"] += len(assembler.matcher.plans)


def _with_clouds(bag: Recording, topics: BagTopics) -> BagTopics:
    """Return the topics, with the topic of the depth images of a bag without object clouds."""
    if topics.clouds != BagTopics().clouds or any(topic.name == topics.clouds for topic in bag.topics):
        return topics
    with suppress(FileError):
        topic = bag.cloud_topic()
        return replace(topics, clouds=topic) if bag.info_topic(topic) else topics
    return topics


def _objects_in(bag: Recording, message: Message, depth: Callable[[], Cloud] | None) -> tuple[Object, ...]:
    """Return the objects of an `object_cloud`; of a depth image, which is decoded by `depth`, those found in it, numbered by their distance from the camera."""
    return decode_objects(bag.content(message)) if depth is None else segment(depth()).objects


def _samples(assembled: list[Sample | RejectedGrasp], result: WriteResult) -> Iterator[Sample]:
    for made in assembled:
        if isinstance(made, RejectedGrasp):
            result.left_out[made.reason] += 1
        else:
            yield made


def _tactile_reader(bag: Recording, topics: BagTopics) -> TactileReader:
    """Return the decoder of the bag's tactile messages; the default one where the bag has no such topic."""
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
    """Return whether the bag was recorded live, so that its times show how far the clocks of robot and sensor differ.

    In one that was converted, or recorded from a replay or in simulated time, the robot's messages too are stamped far
    from their time of reception.
    """
    limit_ns = _PAIRING.clock_s * 1e9
    return any(
        abs(message.bag_time_ns - stamp_ns(bag.content(message).header.stamp)) <= limit_ns
        for message in bag.messages([topics.executed])
    )
