# SPDX-License-Identifier: Apache-2.0
"""Contact of a fingertip's pad with an object: pressure and displacement at three levels of fidelity.

The bed of springs and the elastic layer share one problem and one solution; `grip` closes two fingers.
"""
