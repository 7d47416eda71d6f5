# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: I001  a name stands once, as what it is exported as
from .api import draw as draw, fit as fit, open as open, plan as plan, reading as reading, segment as segment  # noqa: A004
from .cloud.io.files import read_cloud as read_cloud, write_cloud as write_cloud
from .dataset.samples import SampleSet as SampleSet
from .dataset.writing import write as write
from .errors import ForetouchError as ForetouchError
from .models.registry import available_models as available_models, load_model as load_model
from .models.touch_model import History as History, TouchModel as TouchModel
from .pipeline import Pipeline as Pipeline, PipelineConfig as PipelineConfig
from .types import (
    CameraModel as CameraModel,
    Cloud as Cloud,
    Grasp as Grasp,
    Grasps as Grasps,
    Plane as Plane,
    Predicted as Predicted,
    Prediction as Prediction,
    Predictions as Predictions,
    Sample as Sample,
    Touch as Touch,
)
from .types.scene import Object as Object, Scene as Scene

__version__: str
