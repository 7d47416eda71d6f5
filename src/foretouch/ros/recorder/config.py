# SPDX-License-Identifier: Apache-2.0
"""Settings of the recorder."""

from dataclasses import dataclass, field

from foretouch.config import Settings, setting
from foretouch.dataset.pairing import PairingConfig
from foretouch.dataset.recording import Identity, RecordingConfig
from foretouch.ros.messages.tactile import TactileInput
from foretouch.ros.runtime.lifecycle_node import NodeConfig
from foretouch.tactile.contact_detector import ContactConfig


@dataclass(frozen=True, kw_only=True)
class IdentityConfig(Settings):
    """Which hand and which camera: a dataset holds recordings of one of each."""

    hand: str = setting("shadow_hand", "Model of the hand", read_only=True)
    hand_serial: str = setting("", "Serial number of the hand", read_only=True)
    camera: str = setting("realsense", "Model of the camera", read_only=True)
    camera_serial: str = setting("", "Serial number of the camera", read_only=True)


@dataclass(frozen=True, kw_only=True)
class RecorderConfig(NodeConfig, TactileInput):
    """Settings of the recorder."""

    folder: str = setting(".", "Folder of datasets with a relative path, or without a path", read_only=True)
    fallback_folder: str = setting(
        "", "Folder for a copy of the session if its dataset is removed meanwhile; if empty, the session is then lost",
        read_only=True,
    )  # fmt: skip
    record: str = setting("", "Dataset to record from the start; empty waits for start_recording", read_only=True)
    object: str = setting("", "Label of the object on the table, for `record`", read_only=True)
    points: bool = setting(False, "Whether to record the camera's whole clouds too", read_only=True)
    unlabelled: bool = setting(True, "Whether clouds without an executed grasp become samples without a touch")
    unlabelled_s: float = setting(
        1.0, "Minimum time between two samples without a touch", unit="s", minimum=0.0, maximum=3600.0
    )
    assume_grasps: bool = setting(
        False, "Whether a contact without a report is assigned to the best grasp of the last cloud before it"
    )
    queue_mb: int = setting(
        500, "Memory for messages that wait for the disk", unit="MB", minimum=10, maximum=100_000, read_only=True
    )
    identity: IdentityConfig = field(default_factory=IdentityConfig)
    pairing: PairingConfig = field(default_factory=PairingConfig)
    contact: ContactConfig = field(default_factory=ContactConfig)
    writing: RecordingConfig = field(default_factory=RecordingConfig)

    def dataset_identity(self) -> Identity:
        """Hand and camera, with all settings that make recordings of one incompatible with those of another."""
        thumb, middle = self.tactile.fingers
        hand = {"model": self.identity.hand, "serial": self.identity.hand_serial, "tactile": self.tactile.type}
        camera = {"model": self.identity.camera, "serial": self.identity.camera_serial}
        return Identity(hand={**hand, "thumb": thumb, "middle_finger": middle}, camera=camera)
