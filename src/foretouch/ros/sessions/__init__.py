# SPDX-License-Identifier: Apache-2.0
"""Sessions behind their nodes: what the recorder receives, does for its operator and checks, and what the replay plays."""
