# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: I001  a name stands once, as what it is exported as
from .api import calibrate as calibrate, draw as draw, evaluate as evaluate, fit as fit, open as open, plan as plan  # noqa: A004
from .api import reading as reading, segment as segment
from .cloud.io.files import read_cloud as read_cloud, write_cloud as write_cloud
from .dataset.samples import SampleSet as SampleSet
from .dataset.writing import write as write
from .errors import ForetouchError as ForetouchError
from .models.predictor import Estimate as Estimate
from .models.registry import available_models as available_models, load_model as load_model
from .models.touch_model import History as History, TouchModel as TouchModel
from .pipeline import Pipeline as Pipeline, PipelineConfig as PipelineConfig
from .stream import Stream as Stream, StreamConfig as StreamConfig
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
