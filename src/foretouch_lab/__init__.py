# SPDX-License-Identifier: Apache-2.0
"""What a laboratory needs besides a robot: the simulator, training and evaluation of models, experiments and trade-offs.

Nothing in `foretouch` imports this package when it is loaded; `foretouch.laboratory` finds its parts by name where a
command or a node asks for them. Its dependencies are installed by `pip install 'foretouch[lab]'`.
"""
