"""The dashboard's scene: the table from above, drawn with rerun in its own process.

Entities:  world/...  the table, to scale in metres;  plot/...  scalars;  valve/...  on and off;
event  text;  banner  state of all vehicles. One timeline, `t`, the time of the run.

The scene at a time is a function of the log up to that time. Plots, jets and valves have the times
of their messages; everything else is drawn once per frame of flight time (`dashboard/frame.py`). So
a live flight and its replay look the same at the same time.
"""

from collections.abc import Sequence

import rerun as rr

from testbed.config.experiment import Experiment
from testbed.dashboard.columns import ColumnBuffer
from testbed.dashboard.frame import Frames
from testbed.dashboard.scene_plots import PlotScene
from testbed.dashboard.scene_table import TableScene
from testbed.dashboard.scene_wires import WireScene
from testbed.dashboard.static_scene import setting
from testbed.logs.feed import News


class Scene:
    """Draws the log of one run."""

    def __init__(self, scenario: Experiment, recording: rr.RecordingStream) -> None:
        setting(recording, scenario)
        self._columns, self._frames = ColumnBuffer(recording), Frames()
        self._plots = PlotScene(scenario, recording)
        self._wires = WireScene(scenario, recording)
        self._table = TableScene(scenario, self._columns)

    def draw(self, news: Sequence[News]) -> None:
        """Draw any number of new messages."""
        for frame in self._frames.cut(news):
            self._table.draw(frame)
        self._columns.send()  # the table first, because it is watched most
        self._plots.draw(news)
        self._wires.draw(news)

    def finish(self) -> None:
        """Draw the last frame, at the end of the log."""
        for frame in self._frames.rest():
            self._table.draw(frame)
        self._columns.send()
