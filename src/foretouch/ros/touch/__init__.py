# SPDX-License-Identifier: Apache-2.0
"""Touch prediction behind its node: predictor, actions, and online adaptation to tactile readings."""
