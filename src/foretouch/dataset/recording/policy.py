# SPDX-License-Identifier: Apache-2.0
from foretouch.dataset.recording.session_file import RecordingConfig as RecordingConfig
