# SPDX-License-Identifier: Apache-2.0
"""The recorder behind its node: message queue, subscriptions, session and status."""
