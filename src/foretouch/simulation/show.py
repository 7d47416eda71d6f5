# SPDX-License-Identifier: Apache-2.0
"""A scene on show: which of its samples lies on the table at a given time.

Camera and hand are nodes of their own, perhaps in processes of their own; a stamp is all that both know of a cloud.
So the sample is a function of the stamp, and the hand touches the very object that the camera saw.
"""

from __future__ import annotations

from dataclasses import dataclass

from foretouch.config import Settings, setting
from foretouch.errors import ConfigError
from foretouch.simulation.scene import SceneConfig, load_scene

__all__ = ["ShowConfig"]

_MS_NS = 1_000_000


@dataclass(frozen=True, kw_only=True)
class ShowConfig(Settings):
    """A scene whose samples follow each other in time; camera and hand are given the same."""

    path: str = setting("", "Scene file (YAML)", read_only=True)
    dwell_s: float = setting(
        3.0, "How long each sample lies on the table", unit="s", minimum=0.05, maximum=86400.0, read_only=True
    )
    samples: int = setting(1000, "Samples that are shown before the first comes again", minimum=1, read_only=True)
    origin_ns: int = setting(
        0, "When the first sample is laid on the table, since 1970", unit="ns", minimum=0, read_only=True
    )

    def load(self) -> SceneConfig:
        """The scene.

        Raises:
            ConfigError: If there is no path, or what the file says breaks a rule.
        """
        if not self.path:
            raise ConfigError("path: is empty; name a scene file")
        return load_scene(self.path)

    def slot(self, stamp_ns: int) -> int:
        """The sample on the table at a time; before the first, the first.

        Args:
            stamp_ns: Such as a cloud's stamp [ns].
        """
        dwell_ns = round(self.dwell_s * 1e3) * _MS_NS
        return max(0, stamp_ns - self.origin_ns) // dwell_ns % self.samples
