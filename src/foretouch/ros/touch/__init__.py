# SPDX-License-Identifier: Apache-2.0
"""Touch prediction behind its node: predictor, grasp sampler, and online adaptation to tactile readings."""
