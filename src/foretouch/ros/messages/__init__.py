# SPDX-License-Identifier: Apache-2.0
"""Messages to the core's types and back, RViz markers and tactile adapters: pure functions without a node."""
