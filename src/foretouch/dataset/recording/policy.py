# SPDX-License-Identifier: Apache-2.0
# Alias until merge.
from foretouch.dataset.recording.session_file import RecordingConfig

__all__ = ["RecordingConfig"]
