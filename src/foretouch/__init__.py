# SPDX-License-Identifier: Apache-2.0
"""Plan two-finger grasps from a depth camera, and predict what tactile fingertips will read, before anything moves.

    import foretouch as ft
    scene = ft.segment(ft.Cloud.from_depth(depth, K))
    grasps = ft.plan(scene.objects[0])
    touch = ft.load_model().predict(scene.objects[0], grasps)
    ft.draw(scene, grasps, touch)

Names are loaded when they are first used; `__init__.pyi` lists them (SPEC 1). Lengths are in metres, in the optical
frame of the camera (x right, y down, z forward); readings are in the unit of their sensor.
"""

from typing import Any

import lazy_loader

__version__ = "0.4.0"

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]


def __getattr__(name: str) -> Any:
    """Load a name when it is first used; an unknown one is an `UnknownAttributeError`."""
    try:
        return _load(name)
    except AttributeError:
        from foretouch.errors import UnknownAttributeError, nearest

        instead = {"predict": "; write load_model().predict(object, grasps)", "train": "; write fit(samples)"}
        cure = instead.get(name) or nearest(name, __all__)
        raise UnknownAttributeError(f"foretouch: has no {name}{cure}; dir(foretouch) lists all names") from None
