# SPDX-License-Identifier: Apache-2.0
"""Predict the touch of three grasps on the first object of a scene, as README shows it."""

import foretouch as ft

scene = ft.segment(ft.read_cloud("examples/data/table.npz"))
grasps = ft.plan(scene.objects[0], count=3)
touch = ft.load_model().predict(scene.objects[0], grasps)
print(touch["PDC"].value.round(), touch.flags)  # (grasps, fingers) [counts]
