"""The dashboard's picture: the table from above, drawn with rerun in its own process.

Entities:  world/...  the table, to scale in metres;  plot/...  scalars;  valve/...  on and off;
event  text;  banner  what state everybody is in. One timeline, `t`, the time of the run.

What is shown at a time is a function of the log up to there. Plots, jets and valves have the times
of their messages; everything else is drawn once a frame of flight time (`dashboard/frame.py`). So
a flight that is followed and the same one replayed show the same at the same time.
"""

from collections.abc import Sequence

import rerun as rr

from testbed.dashboard.columns import Columns
from testbed.dashboard.frame import Frames
from testbed.dashboard.scene_plots import PlotScene
from testbed.dashboard.scene_table import TableScene
from testbed.dashboard.scene_wires import WireScene
from testbed.dashboard.static_scene import setting
from testbed.logs.feed import News
from testbed.report.scenario import Scenario


class Scene:
    """What has been drawn so far of one run."""

    def __init__(self, scenario: Scenario, recording: rr.RecordingStream) -> None:
        setting(recording, scenario)
        self._columns, self._frames = Columns(recording), Frames()
        self._plots = PlotScene(scenario, recording)
        self._wires = WireScene(scenario, recording)
        self._table = TableScene(scenario, self._columns)

    def draw(self, news: Sequence[News]) -> None:
        """Take in what has come, however much it is."""
        for frame in self._frames.cut(news):
            self._table.draw(frame)
        self._columns.send()  # first what is looked at first
        self._plots.draw(news)
        self._wires.draw(news)

    def finish(self) -> None:
        """The log has come to its end."""
        for frame in self._frames.rest():
            self._table.draw(frame)
        self._columns.send()
