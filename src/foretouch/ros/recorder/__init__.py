# SPDX-License-Identifier: Apache-2.0
"""The recorder behind its node: subscriptions with their queue, and the session with its status."""
