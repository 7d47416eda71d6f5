# SPDX-License-Identifier: Apache-2.0
"""The layout for Foxglove of the default namespace: scene, predicted beside read pressures, diagnostics.

`python -m foretouch.ros.foxglove_layout > config/foxglove.json` writes the one that is released.
"""

import json
from typing import Any, Final

from foretouch.tactile.messages.biotac_all import FINGER_ORDER
from foretouch.topics import CLOUD_TOPIC, TACTILE_TOPIC, full_name

_FINGERS: Final = {"th": ("thumb", FINGER_ORDER.index("TH")), "mf": ("middle finger", FINGER_ORDER.index("MF"))}
_PREDICTED, _BOUND, _READ = "#e69600", "#aa8c5a", "#5a8cff"


def foxglove_layout() -> str:
    """The layout as JSON; needs the Foxglove SDK."""
    import foxglove.layouts as fl

    topics: dict[str, Any] = {
        full_name("points"): fl.BaseRendererPointCloudTopicSettings(visible=True, point_size=2),
        full_name(CLOUD_TOPIC): fl.BaseRendererPointCloudTopicSettings(visible=False),
        full_name("markers"): fl.BaseRendererRosMarkerTopicSettings(visible=True),
    }
    scene = fl.ThreeDeePanel(title="scene", config=fl.ThreeDeeConfig(topics=topics))
    plots = [fl.SplitItem(proportion=1, content=_pressure(fl, name)) for name in _FINGERS]
    lower = [
        fl.SplitItem(
            proportion=1, content=fl.RawMessagesPanel(config=fl.RawMessagesConfig(topic_path=full_name("touch")))
        ),
        fl.SplitItem(proportion=1, content=fl.DiagnosticsSummaryPanel()),
    ]
    left = fl.SplitContainer(
        direction="column",
        items=[
            fl.SplitItem(proportion=3, content=scene),
            fl.SplitItem(proportion=2, content=fl.SplitContainer(direction="row", items=lower)),
        ],
    )
    right = fl.SplitContainer(direction="column", items=plots)
    content = fl.SplitContainer(
        direction="row", items=[fl.SplitItem(proportion=3, content=left), fl.SplitItem(proportion=2, content=right)]
    )
    return str(fl.Layout(content=content).to_json())


def _pressure(fl: Any, name: str) -> Any:
    finger, index = _FINGERS[name]
    predicted = f"{full_name('touch')}.predictions[0].pdc_{name}"
    lines = {
        f"{predicted}.value": ("predicted", _PREDICTED),
        f"{predicted}.lower": ("90 % interval", _BOUND),
        f"{predicted}.upper": ("90 % interval", _BOUND),
        f"{TACTILE_TOPIC}.tactiles[{index}].pdc": ("read", _READ),
    }
    paths = [
        fl.PlotSeries(value=value, label=label, color=colour, enabled=True, timestamp_method="receiveTime")
        for value, (label, colour) in lines.items()
    ]
    return fl.PlotPanel(title=f"{finger}: pressure PDC [counts]", config=fl.PlotConfig(paths=paths))


if __name__ == "__main__":
    print(json.dumps(json.loads(foxglove_layout()), indent=1))  # noqa: T201
