"""The dashboard's plots of network and boards, for rigs that have them."""

from collections.abc import Sequence

import rerun as rr

from testbed.config.experiment import Experiment
from testbed.logs.feed import News, SeenPace, SeenValves
from testbed.logs.history import lost_share

VALVE_STATES = rr.StateConfiguration(
    values=["open", "shut"], labels=["", ""], colors=[0xFFD666FF, 0x1A2028FF]
)


class WireScene:
    """Draws network and board messages of one run."""

    def __init__(self, scenario: Experiment, recording: rr.RecordingStream) -> None:
        self._scenario, self._rec = scenario, recording
        self._open: dict[tuple[str, int], bool] = {}

    def draw(self, news: Sequence[News]) -> None:
        """Add new timing messages to the plots."""
        paces: dict[str, list[tuple[float, SeenPace]]] = {}
        edges: dict[str, list[SeenValves]] = {}
        for one in news:
            match one.message:
                case SeenPace() as pace:
                    paces.setdefault(one.who, []).append((one.t, pace))
                case SeenValves() as valves:
                    edges.setdefault(one.who, []).append(valves)
        for name, seen in paces.items():
            self._wires(name, seen)
        for name, driven in edges.items():
            if name in self._scenario.vehicles:
                self._driven(name, driven)

    def _wires(self, name: str, seen: list[tuple[float, SeenPace]]) -> None:
        """Draw loop lateness, delay and loss of a vehicle's setpoints."""
        self._column(f"plot/loop/{name}", [(t, 1e3 * p.late_s) for t, p in seen])
        delays = [(t, p) for t, p in seen if p.setpoint_delay_s is not None]
        if delays:
            ages = [(t, 1e3 * (p.setpoint_delay_s or 0.0)) for t, p in delays]
            self._column(f"plot/link/{name}_setpoints", ages)
            lost = [(t, 100.0 * lost_share(p)) for t, p in delays]
            self._column(f"plot/loss/{name}_setpoints", lost)

    def _driven(self, name: str, driven: list[SeenValves]) -> None:
        """Draw the opening and closing of each valve as reported by the board."""
        for jet in range(len(self._scenario.vehicles[name].model.jets)):
            path, times, states = f"valve/{name}/jet_{jet + 1}_board", [], []
            for one in driven:
                is_open = bool(one.mask >> jet & 1)
                if is_open != self._open.get((name, jet)):
                    if (name, jet) not in self._open:
                        self._rec.log(path, VALVE_STATES, static=True)
                    self._open[name, jet] = is_open
                    times.append(one.t)
                    states.append("open" if is_open else "shut")
            if times:
                self._rec.send_columns(
                    path,
                    [rr.TimeColumn("t", duration=times)],
                    rr.StateChange.columns(state=states),
                )

    def _column(self, path: str, rows: list[tuple[float, float]]) -> None:
        self._rec.send_columns(
            path,
            [rr.TimeColumn("t", duration=[t for t, _ in rows])],
            rr.Scalars.columns(scalars=[value for _, value in rows]),
        )
