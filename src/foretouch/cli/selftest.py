# SPDX-License-Identifier: Apache-2.0
"""What `foretouch doctor --self-test` checks besides the installation: the shipped models and ROS on this machine.

`python -m foretouch.cli.selftest` stores the answers of the shipped models again, after a model was released.
"""

import json
import os
from pathlib import Path
from typing import Any, Final

import numpy as np

from foretouch.errors import ConfigError, ModelError
from foretouch.types import Cloud, Grasp

_ROS_PATIENCE_S: Final = 20.0  # of one step of the check of ROS
_EXPECTED: Final = Path(__file__).with_name("selftest_expected.json")
_TOLERANCE_COUNTS: Final = 0.5  # half of what a reading resolves; one bit in each coordinate moves an answer by 0.002


def exact_cloud() -> Cloud:
    """Return top and front of a tilted box of 68 x 71 x 95 mm: 1876 points, the same bits on every machine.

    Its size is one that the shipped models know, so that they do not answer with their mean.
    """
    tops, fronts = np.meshgrid(np.arange(28), np.arange(29)), np.meshgrid(np.arange(28), np.arange(1, 39))
    x = np.concatenate([face[0].ravel() for face in (tops, fronts)])
    y = np.concatenate([tops[1].ravel(), 0 * fronts[1].ravel()])
    z = np.concatenate([0 * tops[1].ravel(), fronts[1].ravel()])
    turned = np.stack([13 * x, 5 * y - 12 * z, 12 * y + 5 * z], axis=1) * 10 // 13  # in units of 1/4096 m
    return Cloud(((turned + np.array([0, 0, 4700])) / 4096.0).astype(np.float32))


def exact_grasp() -> Grasp:
    """Return a grasp of `exact_cloud` along x."""
    half, centre = np.array([288.0, 0.0, 0.0]) / 8192.0, np.array([140.0, -60.0, 4820.0]) / 4096.0
    return Grasp(centre + half, centre - half, np.eye(3)[:, [1, 2, 0]])


def check_models() -> None:
    """Compare the shipped models and their answers with those stored with this version; a `ModelError` names the first that differs."""
    from foretouch.base.files import read_json
    from foretouch.models import available_models

    expected = read_json(_EXPECTED)
    if missing := sorted(set(available_models()) ^ set(expected)):
        raise ModelError(f"model {missing[0]}: is not both installed and stored to compare with")
    for name, stored in expected.items():
        answers = _answers(name)
        if answers["sha256"] != stored["sha256"]:
            raise ModelError(f"model {name}: sha256: {answers['sha256']} is not {stored['sha256']} of this version")
        error = float(np.abs(np.subtract(answers["counts"], stored["counts"])).max())
        if not error <= _TOLERANCE_COUNTS:
            raise ModelError(f"model {name}: answers differ by {error:.3g} counts")


def _answers(name: str) -> dict[str, Any]:
    """Return the hash of a model, and its values and bounds for a grasp [counts]."""
    from foretouch.models import load_model

    model = load_model(name)
    prediction = model.predict(exact_cloud(), [exact_grasp()])[0]
    if not (prediction.ok and prediction.calibrated):
        raise ModelError(f"{name}: {prediction.reason or 'has no bounds'}")
    rows = [part.values.round(3).tolist() for part in (prediction.value, prediction.lower, prediction.upper)]
    return {"sha256": model.sha256, "counts": rows}


def check_ros() -> None:
    """Ask a running node over DDS for two grasps, one of them 1e160 m wide; a `ConfigError` names what fails.

    It talks on this machine only, in its own domain and namespace, so that a running robot is not disturbed.
    """
    from foretouch.ros.graph import Graph, call_service

    os.environ |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(60 + os.getpid() % 40)}
    namespace = f"/foretouch_self_test_{os.getpid()}"
    with Graph({"perception": {}}, namespace=namespace, monitor=None) as graph:
        graph.require_active()
        from foretouch.ros.messages.clouds import cloud_to_msg
        from foretouch.ros.messages.conversions import grasp_to_msg
        from foretouch_msgs.msg import Status
        from foretouch_msgs.srv import PredictTouch

        request = PredictTouch.Request(cloud=cloud_to_msg(exact_cloud()))
        request.grasps = [grasp_to_msg(exact_grasp()) for _ in range(2)]
        request.grasps[1].g1.x = 1e160
        answer = call_service(PredictTouch, f"{namespace}/predict_touch", request, _ROS_PATIENCE_S)
        statuses = [prediction.status for prediction in answer.touch.predictions]
        errors = graph.nodes["perception"].internal_errors.counts()
        if statuses != [Status.OK, Status.BAD_GRASP] or errors:
            raise ConfigError(f"predict_touch: statuses {statuses}, internal errors {dict(errors)}")


if __name__ == "__main__":
    from foretouch.base.files import write_text
    from foretouch.models import available_models

    lines = [f' "{name}": {json.dumps(_answers(name))}' for name in sorted(available_models())]
    write_text(_EXPECTED, "{\n" + ",\n".join(lines) + "\n}\n")
