# SPDX-License-Identifier: Apache-2.0
"""What knows nothing of robots: checked files, worker processes, signals, and a queue between threads."""
